"""Models with uncertain parameters: those of Ploix 2006 and of the golden values, and an exact plant that
knows no line of jaxbound.

Golden states sizes, ranks and relations of its systems, not their matrices; these were found from its
relations and give all of its sizes.
"""

from fractions import Fraction

from oracles import fractions, times

import jaxbound as jb


def entry(shape, *places):
    """Return a matrix of zeros but for (row, column, value)."""
    out = [[0] * shape[1] for _ in range(shape[0])]
    for i, j, x in places:
        out[i][j] = x
    return out


THREE = dict(A=[[0.7, 0.2, 0], [-0.1, 0.6, 0.3], [0, 0.1, 0.5]], B=[[0], [1], [0.5]])
TWO_OUTPUTS, ONE_OUTPUT = [[1, 0, 0], [0, 0, 1]], [[1, 0, 0]]
A2 = dict(name="a", A=entry((3, 3), (0, 0, 0.1)))
A3 = dict(name="a", A=entry((3, 3), (0, 1, 0.1)))
B1 = dict(name="b", A=entry((3, 3), (1, 2, 0.1)))
B3 = dict(name="b", A=entry((3, 3), (1, 2, 0.1), (2, 1, 0.05)))
C3 = dict(name="c", C=entry((2, 3), (0, 0, 0.05)))
EXAMPLE = dict(A=[[0.8, 1], [0, 0.2]], B=[[0], [1]], C=[[1, 0]])
THETA = dict(name="th", A=[[0.1, 0], [0, 0]])
VT = dict(name="vt", C=[[0.1, 0]], varying=False)


def _constant(*parameters):
    return [dict(p, varying=False) for p in parameters]


SYSTEMS = {  # name in golden: (matrices, parameters, samples in a window)
    "n2p1_paper_h3": (EXAMPLE, [THETA, VT], 3),
    "n2p1_Btwo_h3": (
        dict(EXAMPLE, B=[[0.5], [1]]),
        [THETA, VT, dict(name="b", B=[[0.1], [0]], varying=False)],
        3,
    ),
    "n3p2_var2_h2": (dict(THREE, C=TWO_OUTPUTS), [A2, C3], 2),
    "n3p2_inv2_h2": (dict(THREE, C=TWO_OUTPUTS), _constant(A2, C3), 2),
    "n3p2_var2_h3": (dict(THREE, C=TWO_OUTPUTS), [A2, C3], 3),
    "n3p2_inv2_h3": (dict(THREE, C=TWO_OUTPUTS), _constant(A2, C3), 3),
    "n3p2_inv3_h2": (dict(THREE, C=TWO_OUTPUTS), _constant(A3, B3, C3), 2),
    "n3p2_inv3_h3": (dict(THREE, C=TWO_OUTPUTS), _constant(A3, B3, C3), 3),
    "n3p2_var3_h2": (dict(THREE, C=TWO_OUTPUTS), [A3, B3, C3], 2),
    "n3p2_mixed3_h3": (dict(THREE, C=TWO_OUTPUTS), [B3, *_constant(A3, C3)], 3),
    "n3p2_var3_h3": (dict(THREE, C=TWO_OUTPUTS), [A3, B3, C3], 3),
    "n3p1_inv2_h4": (dict(THREE, C=ONE_OUTPUT), _constant(A3, B1), 4),
    "n3p1_var2_h4": (dict(THREE, C=ONE_OUTPUT), [A3, B1], 4),
}

# not golden's: the smallest with more than one relation and errors of every kind, compiled in seconds
TWO = "two relations"
ERRORS = dict(noise=[0.02], tolerance=[0.01], disturbance=([[0.1], [0]], [[-0.05, 0.1]]))
ALL = SYSTEMS | {TWO: (EXAMPLE | ERRORS, _constant(THETA, VT), 4)}


def model(name, **changes):
    """Return one of the systems as a LinearSystem."""
    matrices, parameters, _ = ALL[name]
    return jb.LinearSystem(**matrices | changes, uncertainties=[jb.Uncertainty(**p) for p in parameters])


def relations(name, **changes):
    """Return the relations of one of the systems over its windows."""
    return jb.parity_relations(model(name, **changes), horizon=ALL[name][2] - 1)


def trajectory(matrices, parameters, values, x, u, w=(), G=None, v=(), F=None, D_v=None):
    """Return the exact true outputs of a plant whose parameters have the values[(name, sample or None)], in
    user's units.
    """

    def now(letter, k):
        out = [list(row) for row in fractions(matrices[letter])]
        for p in parameters:
            size = values[p["name"], k if p.get("varying", True) else None]
            for i, row in enumerate(fractions(p.get(letter) or [])):
                out[i] = [a + size * d for a, d in zip(out[i], row, strict=True)]
        return out

    column = lambda a, b: [row[0] for row in times(a, [[z] for z in b])] if b else [Fraction(0)] * len(a)
    add = lambda *parts: [sum(z) for z in zip(*parts, strict=True)]
    y = []
    for k in range(len(u)):
        nothing = [Fraction(0)] * len(matrices["C"])
        direct = column(now("D", k), u[k]) if "D" in matrices else nothing
        unknown = column(fractions(D_v), v[k]) if D_v else nothing
        y += add(column(now("C", k), x), direct, unknown)
        parts = [column(now("A", k), x), column(now("B", k), u[k])]
        parts += [column(fractions(G), w[k])] if G else []
        parts += [column(fractions(F), v[k])] if F else []
        x = add(*parts)
    return y

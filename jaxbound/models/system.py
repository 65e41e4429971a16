"""The linear model and its bounds: what an engineer knows of a plant, kept as exact decimals."""

from fractions import Fraction

import numpy as np

from jaxbound.exact import linalg
from jaxbound.models.uncertainty import centred, influences
from jaxbound.models.unknown import decoupled, unbounded_inputs, without_descriptor
from jaxbound.recordings.expressions import expression, is_expression
from jaxbound.recordings.naming import listed

__all__ = ["LinearSystem"]


class LinearSystem:
    """A discrete-time linear model with imperfect sensors.

        x+ = A x + B u + G w + F v,    y = (1 + theta) (C x + D u + D_v v) + noise + rounding of the recording
        lo_j <= w_j <= hi_j,  |theta_i| <= tolerance_i,  |noise_i| <= noise_i,  |rounding_i| <= resolution_i,  v any number,
        all drawn anew each sample

    Every number is kept exactly: a float means its shortest decimal; Fraction, Decimal, int and str ("1/3") are taken as they are.

    Args:
        A, B, C, D: matrices (n, n), (n, m), (p, n), (p, m); B None: no inputs; D None: zero; A, B, C None: no states, y = D u.
        dt: sampling period in seconds.
        tolerance: relative sensor tolerance in [0, 1), one number or one per output.
        constant_tolerance: True if each theta keeps one value over a window (the gain error of a sensor), False if it is drawn anew.
        noise: absolute noise bound >= 0, in the unit of the output, one number or one per output.
        resolution: what the recording itself rounds away (half a step of a quantised sensor), in the unit of the output, one number or one
            per output. On top of it, every sample is taken to be known to 4 u (largest |y_i| in the window + noise_i), u the unit
            roundoff of the recording's float type: a sum, a product and a final rounding of a perfect plant are within 3 u of this.
        disturbance: (G, bound): G (n, g) says how unmeasured, bounded inputs w act on the states; bound (g,) or one number means
            |w| <= bound, bound (g, 2) means lo <= w <= hi (a leak is [0, w]). Kept as .G and .disturbance, g pairs (lo, hi).
        unknown_inputs: F (n, d), or a pair (F, D_v (p, d)): how inputs that nobody knows, not even a bound, act on the states and outputs.
            Kept as .F and .D_v.
        inputs, outputs, states: names; default u1.., y1.., x1...
        units: {name: unit}, for reports.
        offset: {"u": (m,), "y": (p,)}: operating point; the model speaks of u - offset and y - offset (the tolerance too).
        columns: {name: column} where a recording calls a signal otherwise, or "= an expression" over its columns, like
            "= `Supply Temp` - `Mixed Temp`"; "time": the column of its time stamps; "where": a condition, like "fan > 0": samples for
            which it does not hold are no part of the recording, and windows with them are MISSING.
        provenance: {"noise": "datasheet" | "fitted" | "assumed", ...}: where a bound comes from, for reports.
        name: of the plant, for reports.
        horizon: of the windows for which the bounds were found (`jb.fit`): `parity_relations` takes it where none is asked for.
        uncertainties: a sequence of `Uncertainty`: bounded parameters that change A, B, C, D. The given matrices are those at the value
            0 of every parameter; .A, .B, .C, .D are kept at the middle of their bounds.
        decouple: names of uncertainties whose bounds are not to be trusted: they become unknown inputs.
        E: (r, n) of a descriptor system E x+ = A x + B u + ..., A, B, G, F (r, .) then. The model keeps the states that E determines; what
            no equation drives becomes unknown inputs. Not together with uncertainties.

    Raises:
        ValueError: shapes that do not fit, a number that is not finite, a negative bound, a tolerance >= 1, a name used twice.

    Source: Adrot, Maquin, Ragot 2000, (1)-(2).

    Example:
        >>> m = LinearSystem([[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]], tolerance=[0.02, 0.1], noise=[0.1, 0.01])
        >>> m.n, m.m, m.p, m.outputs
        (2, 1, 2, ('y1', 'y2'))
    """

    def __init__(self, A, B, C, D=None, dt=1.0, *, tolerance=0.0, noise=0.0, constant_tolerance=False, resolution=None, E=None,
                 unknown_inputs=None, disturbance=None, uncertainties=(), decouple=(), inputs=None, outputs=None, states=None,
                 units=None, offset=None, columns=None, provenance=None, name="model", horizon=None):  # fmt: skip
        if E is not None:
            if np.size(np.asarray(uncertainties, object)):
                raise ValueError("E and uncertainties do not go together: solve the equations for x+ first, or decouple the parameters")
            given = E, A, B, C, D, disturbance, unknown_inputs, states
            A, B, C, D, disturbance, unknown_inputs, states = without_descriptor(*given)
        self.A = _matrix("A", A) if A is not None and len(A) else ()
        n = len(self.A)
        if n and len(self.A[0]) != n:
            raise ValueError(f"A must be square, one row per state: its shape is ({n}, {len(self.A[0])})")
        static = n == 0 and D is not None and np.size(D) > 0  # y = D u: D says how many outputs there are
        if not n and not static:
            raise ValueError("A must be square, one row per state; a model without states needs D (y = D u)")
        self.C = _matrix("C", C) if C is not None and len(C) else tuple(() for _ in (_matrix("D", D) if static else ()))
        p = len(self.C)
        if p == 0:
            raise ValueError("the model has no output: C needs at least one row")
        self.B = _matrix("B", B) if B is not None and np.size(B) else tuple(() for _ in range(n))
        m = len(self.B[0]) if n else len(_matrix("D", D)[0])
        self.D = _matrix("D", D) if D is not None and np.size(D) else tuple((Fraction(0),) * m for _ in range(p))
        for label, a, shape in (("B", self.B, (n, m)), ("C", self.C, (p, n)), ("D", self.D, (p, m))):
            if a and (len(a), len(a[0])) != shape:
                raise ValueError(f"{label} must have shape {shape} to fit A, B and C: its shape is {(len(a), len(a[0]))}")
        self.uncertainties = influences(uncertainties, {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)})
        for letter in "ABCD":
            setattr(self, letter, centred(getattr(self, letter), self.uncertainties, letter))
        self.n, self.m, self.p = n, m, p
        self.G, self.disturbance = _disturbance(disturbance, n)
        self.g = len(self.disturbance)
        self.F, self.D_v = unbounded_inputs(unknown_inputs, n, p)
        self.uncertainties, self.F, self.D_v = decoupled(self.uncertainties, decouple, self.F, self.D_v)
        self.d = len(self.D_v[0])
        self.dt = float(_number("dt", dt))
        if self.dt <= 0:
            raise ValueError(f"dt must be a positive number of seconds, not {dt}")
        self.inputs = _names("inputs", inputs, m, "u")
        self.outputs = _names("outputs", outputs, p, "y")
        self.states = _names("states", states, n, "x")
        everyone = self.inputs + self.outputs
        twice = sorted({x for x in everyone if everyone.count(x) > 1})
        if twice:
            raise ValueError(f"a signal name may stand for one signal only: {listed(twice)} is used twice")
        self.tolerance = self._bound("tolerance", tolerance)
        if not isinstance(constant_tolerance, (bool, np.bool_)):
            raise ValueError(f"constant_tolerance must be True or False, not {constant_tolerance!r}")
        self.constant_tolerance = bool(constant_tolerance)
        self.noise = self._bound("noise", noise)
        self.resolution = self._bound("resolution", 0 if resolution is None else resolution)
        offset = dict(offset or {})
        unknown = set(offset) - {"u", "y"}
        if unknown:
            raise ValueError(f"offset has the fields 'u' and 'y', not {sorted(unknown)}")
        self.offset = {
            "u": _vector("offset u", offset.get("u", 0), self.inputs),
            "y": _vector("offset y", offset.get("y", 0), self.outputs),
        }
        self.units = self._about("units", units, everyone + self.states)
        self.columns = self._about("columns", columns, (*everyone, "time", "where"))
        for of, column in self.columns.items():
            if of == "where" or (of != "time" and is_expression(column)):
                expression(column)
        self.provenance = self._about("provenance", provenance, ("tolerance", "noise", "resolution", "disturbance", "model"))
        self.name = str(name)
        if horizon is not None and (isinstance(horizon, bool) or not isinstance(horizon, (int, np.integer)) or horizon < 0):
            raise ValueError(f"horizon must be a whole number >= 0, not {horizon!r}")
        self.horizon = None if horizon is None else int(horizon)

    def _bound(self, field, value):
        bounds = _vector(field, value, self.outputs)
        for output, b in zip(self.outputs, bounds, strict=True):
            if b < 0:
                raise ValueError(f"{field} must be >= 0: output {output!r} has {float(b):g}")
            if field == "tolerance" and b >= 1:
                raise ValueError(f"tolerance is relative and must be below 1 (2 % is 0.02): output {output!r} has {float(b):g}")
        return bounds

    @staticmethod
    def _about(field, table, known):
        table = {str(k): str(v) for k, v in dict(table or {}).items()}
        unknown = sorted(set(table) - set(known))
        if unknown:
            raise ValueError(f"{field} speaks of {listed(unknown)}, but the model knows only {listed(known)}")
        return table

    @property
    def has_feedthrough(self):
        """True if D is not zero: the newest input of a window then matters."""
        return any(x for D in (self.D, *(u.D or () for u in self.uncertainties)) for row in D for x in row)

    @property
    def has_direct_unknown(self):
        """True if D_v is not zero: the newest unknown input of a window then matters."""
        return any(x for row in self.D_v for x in row)

    def column(self, signal):
        """Return the column of a recording that holds a signal."""
        return self.columns.get(signal, signal)

    def unit(self, signal):
        """Return the unit of a signal, or an empty string."""
        return self.units.get(signal, "")

    def __repr__(self):
        horizon = "" if self.horizon is None else f", horizon {self.horizon}"
        signals = f"inputs {list(self.inputs)}, outputs {list(self.outputs)}"
        return f"LinearSystem({self.name!r}: {self.n} states, {signals}, dt={self.dt:g} s{horizon})"


def _number(field, x):
    try:
        return linalg.rational(x)
    except ValueError as e:
        raise ValueError(f"{field}: {e}") from None


def _matrix(field, a):
    try:
        return linalg.matrix(a)
    except (ValueError, TypeError) as e:
        raise ValueError(f"{field}: {e}") from None


def _vector(field, value, names):
    if isinstance(value, (str, Fraction)) or np.ndim(value) == 0:
        return (_number(field, value),) * len(names)
    values = list(value)
    if len(values) != len(names):
        raise ValueError(f"{field} needs one number, or one for each of {listed(names, str)}: {len(values)} given")
    return tuple(_number(f"{field} of {s!r}", x) for s, x in zip(names, values, strict=True))


def _disturbance(given, n):
    """Return G (n, g) and g pairs (lo, hi)."""
    if given is None:
        return tuple(() for _ in range(n)), ()
    try:
        G, bound = given
    except (TypeError, ValueError):
        raise ValueError("disturbance needs a pair (G, bound): how it acts on the states, and how large it can be") from None
    G = _matrix("G of the disturbance", G)
    if len(G) != n:
        raise ValueError(f"G of the disturbance needs one row per state ({n}): it has {len(G)}")
    g = len(G[0])
    if isinstance(bound, str) or not np.iterable(bound):
        bound = [bound] * g
    if len(bound) != g:
        raise ValueError(
            f"the bound of the disturbance needs one number, or one (or a pair [lo, hi]) for each of {g} columns of G, not {len(bound)}"
        )
    pairs = []
    for j, b in enumerate(bound):
        where = f"disturbance {j + 1}"
        if not isinstance(b, str) and np.iterable(b):
            if len(b) != 2:
                raise ValueError(f"{where}: a bound is one number or a pair [lo, hi], not {len(b)} numbers")
            lo, hi = (_number(where, x) for x in b)
            if lo > hi:
                raise ValueError(f"{where}: lo must be <= hi, not [{float(lo):g}, {float(hi):g}]")
        else:
            hi = _number(where, b)
            lo = -hi
            if hi < 0:
                raise ValueError(f"{where}: the bound must be >= 0, not {float(hi):g}")
        pairs.append((lo, hi))
    return G, tuple(pairs)


def _names(field, given, count, letter):
    if given is None:
        return tuple(f"{letter}{i + 1}" for i in range(count))
    names = (given,) if isinstance(given, str) else tuple(map(str, given))
    if len(names) != count:
        raise ValueError(f"{field} needs {count} names, one for each: {len(names)} given")
    if len(set(names)) < count:
        raise ValueError(f"{field} must have different names: {listed(names)}")
    return names

"""Both answers of a paving are proofs: against the exact solutions of Fig. 1 of Adrot 2000, and exact images
of points.
"""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import Counted

import jaxbound as jb
from jaxbound import sets
from jaxbound.sets import Status, interval

LO, HI = (-1, 1), (2, 3)


def figure(z):
    """The map of Adrot 2000, figure 1, as any user would write it."""
    return jnp.stack([2 * z[0] ** 2 + z[1], z[0] - z[1]])


def box(dtype=np.float64):
    return interval(np.array(LO, dtype), np.array(HI, dtype))


class Root:
    """(-1 + sign sqrt(D)) / 4, a root of 2 z1^2 + z1 = a + b, compared with rationals exactly."""

    def __init__(self, sign, D):
        self.sign, self.D = sign, D

    def at_least(self, c):
        """Return True if root >= c: sign sqrt(D) >= 4 c + 1."""
        edge = 4 * c + 1
        return (edge <= 0 or self.D >= edge**2) if self.sign > 0 else (edge <= 0 and self.D <= edge**2)

    def at_most(self, c):
        edge = 4 * c + 1
        return (edge >= 0 and self.D <= edge**2) if self.sign > 0 else (edge >= 0 or self.D >= edge**2)


def solutions(target):
    """Return (root, b) of all z = (root, root - b) of the box with figure(z) = target, by exact
    arithmetic.
    """
    a, b = (Fraction(float(x)) for x in target)
    D = 1 + 8 * (a + b)
    roots = [] if D < 0 else [Root(1, D)] if D == 0 else [Root(-1, D), Root(1, D)]
    return [
        (r, b)
        for r in roots
        if all(r.at_least(c) for c in (LO[0], LO[1] + b)) and all(r.at_most(c) for c in (HI[0], HI[1] + b))
    ]


def holds(lo, hi, solution):
    """True if the box [lo, hi] holds the solution, exactly."""
    root, b = solution
    lo, hi = ([Fraction(float(x)) for x in end] for end in (lo, hi))
    return (
        root.at_least(lo[0]) and root.at_most(hi[0]) and root.at_least(lo[1] + b) and root.at_most(hi[1] + b)
    )


def witnesses(found, k=0):
    """Return the boxes (lo, hi) proved for one target."""
    mine = found.witness_owner == k if found.witness is not None else np.zeros(0, bool)
    return (
        list(zip(np.asarray(found.witness.lo)[mine], np.asarray(found.witness.hi)[mine], strict=True))
        if mine.any()
        else []
    )


@pytest.mark.compiled
def test_both_solutions_of_the_figure_are_proved_in_fewer_boxes_than_the_paper_needs_to_suspect_them():
    found = jb.pave(figure, box(), [2.0, -2.0])
    print(f"{found.evaluated} boxes, {found.levels} levels, widths {np.asarray(found.witness.wid).max():.1e}")
    assert found.status == Status.CONSISTENT and found.evaluated < 261 and len(found.boxes) == 0
    boxes = sorted((lo.tolist(), hi.tolist()) for lo, hi in witnesses(found))
    assert len(boxes) == 2
    for (lo, hi), solution in zip(boxes, ([-0.5, 1.5], [0.0, 2.0]), strict=True):
        assert all(a <= x <= b and b - a < 1e-12 for a, x, b in zip(lo, solution, hi, strict=True))


@pytest.mark.compiled
@pytest.mark.parametrize(
    "cut", ["smear", *(pytest.param(c, marks=pytest.mark.long) for c in ("alternate", "widest"))]
)
def test_a_thousand_random_targets_get_the_answer_of_the_exact_solver(rng, cut):
    count = 1000 if cut == "smear" else 200
    z = rng.uniform(LO, HI, (count // 2, 2))
    images = np.stack([2 * z[:, 0] ** 2 + z[:, 1], z[:, 0] - z[:, 1]], 1)
    targets = np.vstack([images, rng.uniform([0, -5], [12, 2], (count - count // 2, 2))])
    found = jb.pave(figure, box(), targets, cut=cut)
    exact = [solutions(t) for t in targets]
    want = np.array([Status.CONSISTENT if s else Status.FAULT for s in exact])
    agree = (found.status == want).sum()
    print(
        f"{agree} of {count} agree, {(want == Status.FAULT).sum()} faults; {found.evaluated.mean():.2f} "
        f"boxes each"
    )
    assert not ((found.status != want) & (found.status != Status.UNDECIDED)).any() and agree == count
    for k, known in enumerate(exact):
        proved = witnesses(found, k)
        assert len(proved) == len(known) and all(sum(holds(*w, s) for w in proved) == 1 for s in known)


@pytest.mark.compiled
@pytest.mark.parametrize("distance", [1e-3, 1e-6])
def test_targets_just_outside_the_set_are_faults(rng, distance):
    z2 = rng.uniform(1.1, 2.7, 40)
    fold = np.stack([1 / 8 + z2, -1 / 4 - z2], 1) - distance / np.sqrt(
        2
    )  # the set lies on one side of p1 + p2 = -1/8
    p2 = rng.uniform(-3.9, 0.9, 40)
    low, high = (
        np.maximum(-1, 1 + p2),
        np.minimum(2, 3 + p2),
    )  # of z1, where p1 = 2 z1^2 + z1 - p2 with its vertex at -1/4
    far, near = np.where(high + 0.25 > -0.25 - low, high, low), np.clip(-0.25, low, high)
    ends, outward = np.concatenate([far, near]), np.repeat([distance, -distance], 40)
    edges = np.stack([2 * ends**2 + ends - np.tile(p2, 2) + outward, np.tile(p2, 2)], 1)
    targets = np.vstack([fold, edges])
    assert not any(solutions(t) for t in targets)
    found = jb.pave(figure, box(), targets)
    print(f"{found.evaluated.mean():.1f} boxes each, at most {found.evaluated.max()}")
    assert (found.status == Status.FAULT).all()


@pytest.mark.compiled
def test_a_double_root_is_left_undecided_at_a_bounded_cost():
    found = jb.pave(figure, box(), [1.875, -2.0])
    assert found.status == Status.UNDECIDED and found.evaluated < 5000 and found.levels == 40
    near = np.asarray(found.boxes.mid)
    assert len(near) and (abs(near - [-0.25, 1.75]) < 1e-3).all()


def test_uniform_pavings_converge_to_the_true_area():
    excess = [jb.pave(figure, box(), subdivision="uniform", q=q).area() - 21.375 for q in (10, 20, 40)]
    print("excess", [round(e, 4) for e in excess])
    assert all(1.8 < a / b < 2.2 for a, b in zip(excess, excess[1:], strict=False)) and 0 < excess[-1] < 1.2


# other shapes of system


def quadratic(z, c, A, B):
    """c + A z + B (z z): m equations in n unknowns."""
    return c + A @ z + jnp.einsum("mij,i,j->m", B, z, z)


@pytest.mark.parametrize(
    ("m", "n", "dtype", "count"),
    [
        (1, 2, np.float32, 8),
        *(
            pytest.param(m, n, dtype, 60, marks=(pytest.mark.long, pytest.mark.compiled))
            for m, n, dtype in (
                (1, 2, np.float32),
                (1, 2, np.float64),
                (2, 2, np.float64),
                (2, 3, np.float64),
            )
        ),
    ],
)
def test_what_a_point_of_the_box_gives_is_never_a_fault_and_mostly_proved(rng, m, n, dtype, count):
    c, A, B = (rng.integers(-8, 9, (count, *shape)).astype(dtype) / 4 for shape in ((m,), (m, n), (m, n, n)))
    z = (
        rng.integers(-8, 9, (count, n)).astype(dtype) / 8
    )  # dyadic: the images are floats, some on the boundary
    targets = np.array(
        [np.asarray(quadratic(*map(jnp.asarray, one))) for one in zip(z, c, A, B, strict=True)]
    )
    edge = np.ones(n, dtype)
    found = jb.pave(quadratic, interval(-edge, edge), targets, args=(c, A, B), max_boxes=200_000)
    print(np.bincount(found.status, minlength=4))
    assert not (found.status == Status.FAULT).any() and (found.status == Status.CONSISTENT).mean() > 0.5


def test_a_surplus_variable_leaves_a_witness_over_which_the_equation_changes_sign(rng):
    f = lambda z: z[0] * z[1] + z[2] ** 2
    targets = np.r_[rng.uniform(-0.9, 1.8, 40), [2.01, 3.0, -1.01]][:, None]
    found = jb.pave(f, interval(-np.ones(3), np.ones(3)), targets)
    assert (found.status[:40] == Status.CONSISTENT).all() and (found.status[40:] == Status.FAULT).all()
    for (lo, hi), k in zip(
        zip(*map(np.asarray, (found.witness.lo, found.witness.hi)), strict=True),
        found.witness_owner,
        strict=True,
    ):
        ends = [[Fraction(float(x)) for x in end] for end in (lo, hi)]
        corners = [f([ends[i >> j & 1][j] for j in range(3)]) for i in range(8)]
        assert (
            min(corners) <= Fraction(targets[k, 0]) <= max(corners)
            and (abs(lo) <= 1).all()
            and (abs(hi) <= 1).all()
        )


def test_a_jump_that_skips_the_target_proves_nothing():
    f = lambda z: jnp.where(z[0] > 0.1, z[0] + 1, z[0] - 1)
    found = jb.pave(f, interval([-1.0], [1.0]), [[0.1], [-1.5], [1.5], [3.0]])
    assert found.status.tolist() == [Status.UNDECIDED, Status.CONSISTENT, Status.CONSISTENT, Status.FAULT]


def test_where_the_function_has_no_value_there_is_no_solution():
    f = lambda z: [jnp.sqrt(z[0]) * z[1]]
    found = jb.pave(f, interval([-1.0, -1.0], [0.25, 1.0]), [[0.125], [-0.1], [0.6]])
    assert found.status.tolist() == [Status.CONSISTENT, Status.CONSISTENT, Status.FAULT]


def test_more_equations_than_unknowns_are_only_excluded():
    found = jb.pave(lambda z: [z[0], z[0] ** 2], interval([0.0], [1.0]), [[0.5, 0.25], [0.5, 0.26]])
    assert found.status.tolist() == [Status.UNDECIDED, Status.FAULT]


# regions


@pytest.mark.compiled
def test_a_region_is_reached_by_a_witness_that_lies_in_it(rng):
    mid = np.vstack([rng.uniform([1.5, -3.5], [10, 0.5], (60, 2)), [[0.5, -1], [11.4, 0.0]]])
    wide = interval(mid - 0.05, mid + 0.05)
    found = jb.pave(figure, box(), wide)
    assert (found.status[-2:] == Status.FAULT).all() and (found.status == Status.CONSISTENT).sum() > 20
    for lo, hi, k in zip(
        np.asarray(found.witness.lo), np.asarray(found.witness.hi), found.witness_owner, strict=True
    ):
        a, b = (Fraction(float(x)) for x in (lo + hi) / 2)
        image = 2 * a**2 + b, a - b
        ends = [[Fraction(float(x)) for x in np.asarray(end)[k]] for end in (wide.lo, wide.hi)]
        assert all(low <= x <= high for low, x, high in zip(ends[0], image, ends[1], strict=True))


def test_all_of_a_region_is_covered_between_an_inner_and_an_outer_area(rng):
    region = interval([2.0, -3.0], [4.0, -1.0])
    z = rng.uniform(LO, HI, (200_000, 2))
    inside = ((2 * z[:, 0] ** 2 + z[:, 1] - 3).__abs__() <= 1) & (abs(z[:, 0] - z[:, 1] + 2) <= 1)
    true, volume = 6 * inside.mean(), lambda b: float(np.prod(np.asarray(b.hi) - np.asarray(b.lo), 1).sum())
    found = jb.pave(figure, box(), region, solutions="all", max_depth=14)
    inner, outer = volume(found.witness), volume(found.witness) + volume(found.boxes)
    print(f"{inner:.4f} .. {outer:.4f}, sampled {true:.4f}")
    assert found.status == Status.CONSISTENT and inner - 0.03 < true < outer + 0.03 and outer < 1.2 * inner
    lo, hi = np.asarray(found.witness.lo), np.asarray(found.witness.hi)
    points = rng.uniform(lo, hi)
    for a, b in points[rng.choice(len(points), 200)].tolist():
        a, b = Fraction(a), Fraction(b)
        assert 2 <= 2 * a**2 + b <= 4 and -3 <= a - b <= -1


# budgets, interruption, compilation


@pytest.mark.compiled
def test_a_budget_that_runs_out_says_what_was_spent():
    found = jb.pave(figure, box(), [2.0, -2.0], max_boxes=5)
    assert (
        found.status == Status.UNDECIDED
        and 0 < found.evaluated <= 5
        and found.levels > 0
        and len(found.boxes)
    )


@pytest.mark.compiled
def test_one_solution_is_enough_if_asked_for():
    every, one = (jb.pave(figure, box(), [[2.0, -2.0], [2.0, 2.0]], solutions=s) for s in ("all", "one"))
    assert one.status.tolist() == every.status.tolist() == [Status.CONSISTENT, Status.FAULT]
    assert len(one.witness) == 1 and len(every.witness) == 2 and one.evaluated[0] < every.evaluated[0]


@pytest.mark.compiled
def test_an_interrupted_paving_leaves_nothing_behind():
    def interrupt(share):
        raise KeyboardInterrupt

    whole = jb.pave(figure, box(), [2.0, -2.0])
    with pytest.raises(KeyboardInterrupt):
        jb.pave(figure, box(), [2.0, -2.0], progress=interrupt)
    again = jb.pave(figure, box(), [2.0, -2.0])
    assert (
        again.evaluated == whole.evaluated
        and (np.asarray(again.witness.lo) == np.asarray(whole.witness.lo)).all()
    )


@pytest.mark.compiled
def test_other_boxes_and_targets_do_not_trace_again():
    counted = Counted(figure)
    jb.pave(counted, box(), [2.0, -2.0])
    traced = counted.count
    jb.pave(counted, interval([-1.0, 0.5], [1.5, 3.0]), [3.0, -2.5])
    assert counted.count == traced


@pytest.mark.compiled
def test_a_batch_equals_its_targets_one_by_one(rng):
    targets = rng.uniform([0, -5], [12, 2], (12, 2))
    found = jb.pave(figure, box(), targets)
    for k, target in enumerate(targets):
        alone = jb.pave(figure, box(), target)
        assert (alone.status, alone.evaluated) == (found.status[k], found.evaluated[k])
        assert [w[0].tolist() for w in witnesses(alone)] == [w[0].tolist() for w in witnesses(found, k)]


def only_intervals(z):
    return [sets.sqr(z[0]), z[1] * 1.0]


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (dict(target=[2.0]), ValueError, "the target has 1 components, f has 2"),
        (dict(target=[2.0, -2.0, 1.0]), ValueError, "the target has 3 components, f has 2"),
        (dict(target=[np.nan, -2.0]), ValueError, "not NaN"),
        (dict(max_boxes=0), ValueError, "max_boxes must be a whole number >= 1, not 0"),
        (
            dict(box=interval([-np.inf, 1.0], [2.0, 3.0])),
            ValueError,
            "box must be a bounded, non-empty Interval",
        ),
        (dict(solutions="some"), ValueError, "solutions must be one of none, one, all, not 'some'"),
        (
            dict(f=only_intervals, solutions="one"),
            ValueError,
            "give f as a function of numbers, not of Intervals",
        ),
        (
            dict(f=only_intervals, cut="smear"),
            ValueError,
            "give f as a function of numbers, not of Intervals",
        ),
        (dict(f=lambda z: jax.lax.lgamma(z)), NotImplementedError, "lgamma"),
        (dict(f=lambda z: z @ jnp.ones(3)), TypeError, "dot_general|matmul|contract"),
    ],
)
def test_what_cannot_be_paved_is_refused(change, error, message):
    with pytest.raises(error, match=message):
        jb.pave(**{**dict(f=figure, box=box(), target=[2.0, -2.0]), **change})


def test_lo_above_hi_is_refused():
    with pytest.raises(ValueError, match="lo must be <= hi: 1 of 2 entries violate it"):
        jb.pave(figure, interval([2.0, 1.0], [-1.0, 3.0]), [2.0, -2.0])


def test_an_interval_function_that_fails_on_intervals_too_says_why():
    def broken(z):
        raise RuntimeError("no such table")

    with pytest.raises(RuntimeError, match="no such table"):
        jb.pave(broken, box(), [2.0, -2.0])

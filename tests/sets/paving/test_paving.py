"""Paving against the published counts, an independent first-in-first-out list in exact arithmetic, and points
known to be images.
"""

from collections import deque
from fractions import Fraction

import jax.numpy as jnp
import numpy as np
import pytest
from corners import Counted

from jaxbound import sets
from jaxbound.sets import Status, interval
from jaxbound.sets.intervals.interval import Interval

LO, HI = (-1, 1), (2, 3)  # the box of Adrot 2000, figure 1


def figure(z):
    """Enclose (2 z1^2 + z2, z1 - z2). Source: Adrot 2000, figure 1."""
    return [2 * z[0] ** 2 + z[1], z[0] - z[1]]


def swapped(z):
    """Enclose the same with its variables in the other order."""
    return figure([z[1], z[0]])


def as_product(z):
    """Enclose the same with z1^2 as a product."""
    return [2 * (z[0] * z[0]) + z[1], z[0] - z[1]]


def box(dtype=np.float64, lo=LO, hi=HI):
    return interval(np.array(lo, dtype), np.array(hi, dtype))


# an independent list, in exact arithmetic


def exact_figure(lo, hi):
    """Return exact ends of the two components over a box."""
    squares = [lo[0] ** 2, hi[0] ** 2]
    least = 0 if lo[0] <= 0 <= hi[0] else min(squares)
    return (2 * least + lo[1], 2 * max(squares) + hi[1]), (lo[0] - hi[1], hi[0] - lo[1])


def sequential(f, lo, hi, target, q, widest=False, slack=0):
    """Return (evaluated, boxes left) of the paper's list: take the oldest box, drop it if its image misses
    the target, else cut it in two.

    r starts at 1 and grows when all boxes of the list are of order 2^r (2 r cuts in the plane); stop at r > q
    - 1 or on an empty list.
    """
    queue, evaluated, r = deque([(tuple(map(Fraction, lo)), tuple(map(Fraction, hi)), 0)]), 0, 1
    while queue:
        a, b, depth = queue.popleft()
        evaluated += 1
        if all(low - slack <= t <= high + slack for (low, high), t in zip(f(a, b), target, strict=True)):
            i = depth % len(a) if not widest else max(range(len(a)), key=lambda i: (b[i] - a[i], -i))
            middle = (a[i] + b[i]) / 2
            queue.append((a, (*b[:i], middle, *b[i + 1 :]), depth + 1))
            queue.append(((*a[:i], middle, *a[i + 1 :]), b, depth + 1))
        if queue and min(queue[0][2], queue[-1][2]) >= len(lo) * r:
            r += 1
            if r > q - 1:
                break
    return evaluated, [(a, b) for a, b, _ in queue]


def boxes_of(paving, k):
    """Return the boxes left for one target of a batch, in order."""
    mine = np.asarray(paving.owner) == k
    lo, hi = np.asarray(paving.boxes.lo)[mine].tolist(), np.asarray(paving.boxes.hi)[mine].tolist()
    return [(tuple(map(Fraction, a)), tuple(map(Fraction, b))) for a, b in zip(lo, hi, strict=True)]


# published counts


@pytest.mark.parametrize("rstop", range(1, 13))
def test_the_figure_takes_the_golden_number_of_boxes(golden, rstop):
    want = golden["p0"]["fig1_fifo"]["evaluated_by_rstop"][str(rstop)]
    assert sets.pave(figure, box(), [2.0, -2.0], q=rstop + 1).evaluated == want


def test_the_figure_leaves_twenty_boxes_around_its_two_solutions(golden):
    want = golden["p0"]["fig1_fifo"]
    found = sets.pave(figure, box(), [2.0, -2.0], q=10)
    near = [
        abs(np.asarray(found.boxes.mid) - solution).max(1) < 0.2 for solution in ([-0.5, 1.5], [0.0, 2.0])
    ]
    assert len(found.boxes) == want["left_in_list"] == 20
    assert (
        near[0].sum() == want["left_near_(-0.5,1.5)"] == 14 and near[1].sum() == want["left_near_(0,2)"] == 6
    )
    assert found.status == Status.UNDECIDED


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_both_precisions_evaluate_as_many_boxes(golden, dtype):
    found = sets.pave(figure, box(dtype), [2.0, -2.0], q=10)
    assert found.evaluated == golden["p0"]["fig1_fifo"][np.dtype(dtype).name] and found.boxes.dtype == dtype


def test_cutting_the_second_variable_first_takes_303_boxes(golden):
    want = [
        r
        for r in golden["p0"]["fig1_fifo"]["readings"]
        if r["rule"] == "z2first" and r["ext"] == "square" and r["closed"] and r["rstop"] == 9
    ]
    found = sets.pave(swapped, box(lo=LO[::-1], hi=HI[::-1]), [2.0, -2.0], q=10)
    assert found.evaluated == 303 and all(r["evaluated"] == 303 for r in want if r["p"] == [2, -2])


def test_the_point_as_printed_is_rejected_after_one_box(golden):
    found = sets.pave(figure, box(), [2.0, 2.0], q=10)
    assert found.evaluated == golden["p0"]["fig1_fifo"]["evaluated_at_printed_point_(2,2)"] == 1
    assert found.status == Status.FAULT and len(found.boxes) == 0 and found.area() == 0


@pytest.mark.parametrize(("name", "f"), [("square", figure), ("product", as_product)])
@pytest.mark.parametrize("q", [1, 2, 5, 10, 20])
def test_uniform_pavings_have_the_golden_areas_and_boxes(golden, name, f, q):
    want = golden["p0"]["fig1_union"]["value"][f"{name}_q{q}"]
    found = sets.pave(f, box(), subdivision="uniform", q=q)
    lo, hi = np.asarray(found.images.lo), np.asarray(found.images.hi)
    assert len(found.boxes) == want["n_boxes"] == found.evaluated and found.status is None
    assert abs(found.area() - want["area"]) < 1e-9
    assert abs(np.array([lo.min(0), hi.max(0)]).T - want["bbox"]).max() < 1e-9


@pytest.mark.parametrize("q", [1, 2, 5, 10, 20])
def test_uniform_pavings_hold_the_target_in_the_golden_number_of_boxes(golden, q):
    want = golden["p0"]["fig1_union"]["value"][f"square_q{q}"]["n_boxes_containing_2_m2"]
    found = sets.pave(figure, box(), [2.0, -2.0], subdivision="uniform", q=q)
    assert len(found.boxes) == want and found.evaluated == q * q and found.status == Status.UNDECIDED


# agreement with the independent list, box for box


@pytest.mark.parametrize(("cut", "q"), [("alternate", 6), ("widest", 5), ("alternate", 1), ("alternate", 2)])
def test_a_batch_equals_the_sequential_list_box_for_box(rng, cut, q):
    z = np.stack(
        [rng.integers(-16, 33, 25) / 16, rng.integers(16, 49, 25) / 16], 1
    )  # dyadic points: their images are floats
    images = np.stack([2 * z[:, 0] ** 2 + z[:, 1], z[:, 0] - z[:, 1]], 1)
    targets = np.vstack([rng.uniform([0, -5], [12, 2], (30, 2)), images, [[2, -2], [2, 2], [1, -4]]])
    found = sets.pave(figure, box(), targets, q=q, cut=cut)
    for k, target in enumerate(targets.tolist()):
        evaluated, left = (
            sequential(exact_figure, LO, HI, list(map(Fraction, target)), q, cut == "widest")
            if q > 1
            else (0, None)
        )
        assert found.status[k] == (Status.UNDECIDED if left or q == 1 else Status.FAULT)
        assert q == 1 or (found.evaluated[k] == evaluated and boxes_of(found, k) == left)
    assert q < 5 or 5 < (found.status == Status.FAULT).sum() < len(targets) - 25


def test_a_batch_equals_its_targets_one_by_one(rng):
    targets = rng.uniform([0, -5], [12, 2], (6, 2))
    found = sets.pave(figure, box(), targets, q=7)
    for k, target in enumerate(targets):
        alone = sets.pave(figure, box(), target, q=7)
        assert (alone.status, alone.evaluated) == (found.status[k], found.evaluated[k]) and boxes_of(
            alone, 0
        ) == boxes_of(found, k)


def test_the_widest_edge_is_cut_and_the_first_of_equal_ones():
    found = sets.pave(
        lambda z: [z[0] + z[1]], box(lo=(0, 0), hi=(1, 4)), [1.0], cut="widest", max_depth=3, solutions="none"
    )
    assert len(found.boxes)
    sizes = np.asarray(found.boxes.hi) - np.asarray(found.boxes.lo)
    assert (sizes == [0.5, 1]).all()  # 1 x 4 -> 1 x 2 -> 1 x 1 -> 1/2 x 1


def test_boxes_of_many_targets_span_several_blocks(rng):
    targets = rng.uniform([1, -4], [11, 1], (3000, 2))
    found = sets.pave(figure, box(), targets, q=4)
    for k in rng.choice(3000, 10):
        evaluated, left = sequential(exact_figure, LO, HI, list(map(Fraction, targets[k].tolist())), 4)
        assert found.evaluated[k] == evaluated and boxes_of(found, k) == left
    assert found.images.shape == (len(found.boxes), 2)


# proof: what is an image is never called a fault


def folded(z):
    """Enclose a map of R^3 to R^2 with overestimation, divisions and cancellations."""
    return [z[0] * z[1] - z[0] / (z[2] + 3), (z[0] - z[2]) * (z[0] + z[2]) + z[1] ** 3]


def exact_folded(z):
    return z[0] * z[1] - z[0] / (z[2] + 3), (z[0] - z[2]) * (z[0] + z[2]) + z[1] ** 3


def image_points(rng, dtype, count):
    """Draw points of a box, half of them with coordinates at its ends, and return the floats around their
    exact images.
    """
    lo, hi = np.array([-1, 0.1, -2], dtype), np.array([1, 0.7, 2], dtype)
    z = rng.uniform(lo, hi, (count, 3)).astype(dtype)
    z = np.clip(
        np.where(rng.random(z.shape) < 0.4, rng.choice([0, 1], z.shape) * (hi - lo) + lo, z), lo, hi
    ).astype(dtype)
    exact = [exact_folded([Fraction(float(v)) for v in row]) for row in z]
    down, up = (np.array([[f(v) for v in row] for row in exact]) for f in (below, above))
    return Interval(jnp.asarray(lo), jnp.asarray(hi)), Interval(jnp.asarray(down), jnp.asarray(up))


def below(v):
    f = float(v)
    return f if Fraction(f) <= v else np.nextafter(f, -np.inf)


def above(v):
    f = float(v)
    return f if Fraction(f) >= v else np.nextafter(f, np.inf)


@pytest.mark.compiled
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    "options", [dict(q=5), dict(q=4, cut="widest"), dict(subdivision="uniform", q=3)], ids=str
)
def test_the_image_of_a_point_of_the_box_is_never_a_fault(rng, options, dtype):
    domain, targets = image_points(rng, dtype, 100)
    found = sets.pave(folded, domain, targets, **options)
    assert (found.status == Status.UNDECIDED).all()


@pytest.mark.compiled
@pytest.mark.parametrize("options", [dict(q=8), dict(subdivision="uniform", q=7)], ids=str)
def test_exactly_representable_images_on_the_boundary_are_never_a_fault(rng, options):
    z = np.stack(
        [rng.integers(-8, 17, 200) / 8, rng.integers(8, 25, 200) / 8], 1
    )  # dyadic: their images are floats
    z[::2, 0], z[1::4, 1] = rng.choice([-1, 2], 100), 3
    targets = np.stack([2 * z[:, 0] ** 2 + z[:, 1], z[:, 0] - z[:, 1]], 1)
    assert (sets.pave(figure, box(), targets, **options).status == Status.UNDECIDED).all()


def test_points_outside_the_true_image_are_faults_once_fine_enough():
    targets = np.array([[0.9, -1.0], [11.1, 0.0], [6.0, 1.1], [1.5, -4.0]])
    assert (sets.pave(figure, box(), targets, q=8).status == Status.FAULT).all()


@pytest.mark.parametrize("target", [0.1, 1 / 3, 1e-310, -1e-310])
def test_a_target_that_the_dtype_cannot_hold_is_never_a_fault(target):
    near = np.float32(target)
    ends = interval(
        np.minimum(near, np.nextafter(near, np.float32(-1)))[None],
        np.maximum(near, np.nextafter(near, np.float32(1)))[None],
    )
    assert sets.pave(lambda z: [z[0]], ends, [target], q=5).status == Status.UNDECIDED


def test_the_uniform_pieces_of_the_widest_box_cover_it():
    wide = interval([-1.5e308], [1.5e308])
    targets = np.array([[-1.5e308], [-1.0], [0.0], [1e-308], [1.5e308], [1.4e308]])
    found = sets.pave(lambda z: [z[0] * 1.0], wide, targets, subdivision="uniform", q=3)
    assert (found.status == Status.UNDECIDED).all()


@pytest.mark.parametrize("q", [3, 7, 49])
def test_uniform_pieces_join_without_gaps_and_end_at_the_box(rng, q):
    lo = rng.normal(size=1)
    hi = lo + 10.0 ** rng.uniform(-15, 3)
    boxes = sets.pave(lambda z: [z[0]], interval(lo, hi), subdivision="uniform", q=q).boxes
    left, right = np.asarray(boxes.lo)[:, 0], np.asarray(boxes.hi)[:, 0]
    assert left[0] == lo and right[-1] == hi and (left[1:] == right[:-1]).all() and (left <= right).all()


def test_a_bound_that_is_no_number_excludes_nothing():
    nan = lambda z: [Interval(z[0].lo * jnp.nan, z[0].hi * jnp.nan)]
    assert sets.pave(nan, interval([0.0], [1.0]), [5.0], q=3).status == Status.UNDECIDED
    assert (
        sets.pave(nan, interval([0.0], [1.0]), [5.0], subdivision="uniform", q=3).status == Status.UNDECIDED
    )


def test_a_function_undefined_all_over_the_box_has_no_image():
    assert (
        sets.pave(lambda z: [jnp.sqrt(0 * z[0] - 1)], interval([1.0], [2.0]), [5.0], q=3).status
        == Status.FAULT
    )


def test_a_pole_all_over_the_box_is_no_fault_because_a_program_goes_on_with_its_infinity():
    assert (
        sets.pave(lambda z: [jnp.exp(-1 / (0 * z[0]))], interval([1.0], [2.0]), [0.0], q=3).status
        != Status.FAULT
    )


def test_an_interval_target_is_a_fault_only_if_all_of_it_is_outside():
    target = interval([[0.5, -1.0], [0.5, -1.0]], [[0.9, -1.0], [2.5, -1.0]])
    assert sets.pave(figure, box(), target, q=8).status.tolist() == [Status.FAULT, Status.UNDECIDED]


# options


def test_max_boxes_stops_before_the_level_that_would_exceed_it():
    whole = sets.pave(figure, box(), [2.0, -2.0], q=10)
    stopped = sets.pave(figure, box(), [2.0, -2.0], q=10, max_boxes=100)
    assert (
        stopped.evaluated <= 100 < whole.evaluated
        and stopped.status == Status.UNDECIDED
        and len(stopped.boxes) > 0
    )
    assert sets.pave(figure, box(), [2.0, -2.0], q=10, max_boxes=261).evaluated == 261
    assert (
        sets.pave(figure, box(), [[2.0, -2.0]] * 3, q=10, max_boxes=2).status.tolist()
        == [Status.UNDECIDED] * 3
    )


@pytest.mark.parametrize("depth", [0, 1, 5])
def test_max_depth_stops_as_undecided(depth):
    found = sets.pave(figure, box(), [2.0, -2.0], max_depth=depth, solutions="none")
    assert found.status == Status.UNDECIDED and found.levels == depth
    volume = np.prod(np.asarray(found.boxes.hi) - np.asarray(found.boxes.lo), 1)
    assert (volume == 6 / 2**depth).all()


def shifted(z, shift, scale):
    return [z[0] * scale[0] + shift, z[1] * scale[1]]


@pytest.mark.parametrize("options", [dict(q=6), dict(subdivision="uniform", q=5)], ids=str)
def test_every_target_has_its_own_args(options):
    shift, scale = np.array([0.0, 10.0, 0.0]), np.array([[1.0, 1.0], [1.0, 1.0], [3.0, 0.1]])
    found = sets.pave(shifted, box(lo=(0, 0), hi=(1, 1)), [[0.4, 0.6]] * 3, args=(shift, scale), **options)
    assert found.status.tolist() == [Status.UNDECIDED, Status.FAULT, Status.FAULT]
    assert found.images.shape == (len(found.boxes), 2) and (np.asarray(found.images.hi)[:, 0] >= 0.4).all()


def test_one_target_takes_args_of_one_entry():
    found = sets.pave(
        shifted, box(lo=(0, 0), hi=(1, 1)), [0.4, 0.6], args=(np.array([5.0]), np.ones((1, 2))), q=2
    )
    assert found.status == Status.FAULT and found.evaluated == 1


def test_a_function_may_return_an_interval():
    twice = lambda z: z * 2
    assert sets.pave(twice, box(), [0.0, 4.0], q=4).status == Status.UNDECIDED
    assert sets.pave(twice, box(), [5.0, 4.0], q=4).status == Status.FAULT


def test_progress_ends_at_one():
    for options in (dict(q=4), dict(subdivision="uniform", q=4)):
        seen = []
        sets.pave(figure, box(), [2.0, -2.0], progress=seen.append, **options)
        assert seen == sorted(seen) and seen[-1] == 1


def test_the_area_of_a_plane_union_counts_overlaps_once():
    overlap = lambda z: [z[0] * 0.5, z[1] * 1.0]
    found = sets.pave(overlap, box(lo=(0, 0), hi=(2, 3)), subdivision="uniform", q=4)
    assert abs(found.area() - 3) < 1e-12
    assert (
        abs(
            sets.pave(
                lambda z: [0 * z[0] + z[1], z[1]], box(lo=(0, 0), hi=(2, 3)), subdivision="uniform", q=3
            ).area()
            - 3
        )
        < 1e-9
    )


def test_the_area_of_other_dimensions_is_refused():
    with pytest.raises(ValueError, match="these have 1 dimensions"):
        sets.pave(lambda z: [z[0]], box(), subdivision="uniform", q=2).area()


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (dict(box=interval([-np.inf, 0.0], [1.0, 1.0])), ValueError, "bounded, non-empty"),
        (dict(box=interval([np.inf, 0.0], [-np.inf, 1.0])), ValueError, "bounded, non-empty"),
        (dict(box=interval(0.0, 1.0)), ValueError, r"of shape \(n,\)"),
        (dict(q=0), ValueError, "q must be a whole number >= 1, not 0"),
        (dict(q=2.0), ValueError, "q must be a whole number"),
        (dict(q=True), ValueError, "q must be a whole number"),
        (dict(target=[2.0]), ValueError, "the target has 1 components, f has 2"),
        (dict(target=[2.0, -2.0, 0.0]), ValueError, "the target has 3 components, f has 2"),
        (dict(target=[2.0], subdivision="uniform"), ValueError, "the target has 1 components, f has 2"),
        (dict(target=2.0), ValueError, r"target must have shape \(m,\) or \(B, m\): its shape is \(\)"),
        (dict(target=np.zeros((1, 1, 2))), ValueError, "target must have shape"),
        (dict(target=[np.nan, 1.0]), ValueError, "not NaN"),
        (dict(target=None), ValueError, "adaptive subdivision needs a target"),
        (dict(max_boxes=0), ValueError, "max_boxes must be a whole number >= 1, not 0"),
        (dict(max_depth=-1), ValueError, "max_depth must be a whole number >= 0, not -1"),
        (dict(cut="longest"), ValueError, "cut must be one of alternate, widest, smear, not 'longest'"),
        (dict(subdivision="both"), ValueError, "subdivision must be"),
        (dict(args=(np.zeros(2),)), ValueError, "one entry for each of the 1 targets"),
        (
            dict(subdivision="uniform", q=100, max_boxes=9999),
            ValueError,
            "10000 boxes, more than max_boxes = 9999",
        ),
        (dict(subdivision="uniform", max_depth=3), ValueError, "max_depth belongs to"),
    ],
    ids=str,
)
def test_what_cannot_be_paved_is_refused(change, error, message):
    with pytest.raises(error, match=message):
        sets.pave(figure, **{**dict(box=box(), target=[2.0, -2.0]), **change})


@pytest.mark.parametrize("options", [dict(q=5), dict(subdivision="uniform", q=5)], ids=str)
def test_a_second_call_does_not_trace(options):
    counted = Counted(figure)
    sets.pave(counted, box(), [2.0, -2.0], **options)
    traced = counted.count
    sets.pave(counted, box(lo=(-1, 0)), [3.0, -2.5], **options)
    assert counted.count == traced


def test_images_of_no_box_have_the_type_of_the_others():
    box = sets.interval(np.zeros(1, np.float32), np.ones(1, np.float32))
    paving = sets.pave(lambda z: z * 2, box, target=[9.0])
    assert paving.images.lo.shape == (0, 1) and paving.images.lo.dtype == np.float32

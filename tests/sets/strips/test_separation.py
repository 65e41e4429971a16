"""The exchange search and its two proofs: every verdict is checked in exact rationals, whatever direction and
point it was given.
"""

from fractions import Fraction

import jax
import numpy as np
import pytest
from oracles import Program

from jaxbound.exact import frames
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.strips import separation
from jaxbound.sets.strips.separation import frame_of, separation_margin

ROWS, UNKNOWNS, KNOWN, N = 8, 3, 1, 64  # one shape, because each compiles
image, search, verdict, margin = map(
    kernel,
    (
        separation.separation_image,
        lambda frame, seen, one, steps: separation.exchange_search(
            frame.R, seen.z, seen.radius, seen.present, one, steps
        ),
        separation.separation_verdict,
        separation_margin,
    ),
)
DTYPES = (np.float64, np.float32)


class Case:
    """A random frame and N windows with few binary digits, so that every number is a float of either type,
    exactly.

    Errors are (1 + push) times their bounds, plus a share `jitter` of them; middles are then rounded to the
    dtype.
    """

    def __init__(self, rng, push=0.0, spread=3, gone=0, jitter=0.0, dtype=np.float64):
        draw = lambda top, bits, *shape: [
            [Fraction(int(v), 2**bits) for v in row] for row in rng.integers(-top, top + 1, shape)
        ]
        sizes = [Fraction(2) ** int(v) for v in rng.integers(-spread, spread + 1, ROWS)]
        E = [[size * x for x in row] for size, row in zip(sizes, draw(15, 3, ROWS, UNKNOWNS), strict=True)]
        K = [[size * x for x in row] for size, row in zip(sizes, draw(15, 3, ROWS, KNOWN), strict=True)]
        self.frame = frames.frame(tuple(map(tuple, E)), tuple(map(tuple, K)))
        x, self.known = draw(31, 2, N, UNKNOWNS), draw(31, 2, N, KNOWN)
        dot = lambda a, b: sum((p * q for p, q in zip(a, b, strict=True)), Fraction(0))
        self.true = [
            [dot(e, x[w]) + dot(k, self.known[w]) for e, k in zip(E, K, strict=True)] for w in range(N)
        ]
        self.rad = [
            [size * Fraction(int(v), 8) for size, v in zip(sizes, rng.integers(1, 9, ROWS), strict=True)]
            for _ in range(N)
        ]
        self.signs = [self.worst(rng) for _ in range(N)]
        push = np.broadcast_to(push, N)
        error = 1 + np.broadcast_to(push, N)[:, None] + jitter * rng.normal(size=(N, ROWS))
        self.mid = [
            [Fraction(float(dtype(t + s * r * Fraction(float(e))))) for t, s, r, e in zip(*four, strict=True)]
            for four in zip(self.true, self.signs, self.rad, error, strict=True)
        ]
        self.absent = [set(rng.permutation(ROWS)[:gone].tolist()) for _ in range(N)]

    def worst(self, rng):
        """Return errors at their bounds that stretch one relation to its limit: the window lies on the
        boundary, exactly.
        """
        j = int(rng.integers(len(self.frame.outer)))
        h = self.whole([Fraction(int(i == j)) for i in range(len(self.frame.outer))])
        return [int(np.sign(x)) or int(rng.choice([-1, 1])) for x in h]

    def whole(self, h):
        """Return the coefficients on all rows of the combination h of relations."""
        out = [Fraction(0)] * ROWS
        for j, x, row in zip(self.frame.outer, h, self.frame.R, strict=True):
            out[j] += x
            for i, r in zip(self.frame.inner, row, strict=True):
                out[i] -= x * r
        return out

    def floats(self, dtype):
        """Return (frame, mid, rad, scale, known, known_scale) for the kernels."""
        per_row = lambda values: np.array([[float(v) for v in row] for row in values], dtype).T
        mid, rad, known = per_row(self.mid), per_row(self.rad), per_row(self.known)
        gone = np.array([[i in absent for absent in self.absent] for i in range(ROWS)])
        mid[gone] = np.nan
        return frame_of(self.frame, dtype), mid, rad, abs(mid) + rad, known, abs(known)

    def residual(self, w, h):
        """Return (value, width) of a combination of relations at window w, exactly."""
        action = [
            sum((x * row[b] for x, row in zip(h, self.frame.K, strict=True)), Fraction(0))
            for b in range(KNOWN)
        ]
        used = [(x, self.mid[w][i], self.rad[w][i]) for i, x in enumerate(self.whole(h)) if x]
        value = sum((x * m for x, m, _ in used), Fraction(0)) - sum(
            (a * v for a, v in zip(action, self.known[w], strict=True)), Fraction(0)
        )
        return value, sum((abs(x) * r for x, _, r in used), Fraction(0))

    def explained(self, w, d):
        """Say whether the point d (errors of the inner rows) explains window w, exactly."""
        true = {i: self.mid[w][i] + x for i, x in zip(self.frame.inner, d, strict=True)}
        if any(abs(x) > self.rad[w][i] for i, x in zip(self.frame.inner, d, strict=True)):
            return False
        for j, row, k in zip(self.frame.outer, self.frame.R, self.frame.K, strict=True):
            y = sum((r * true[i] for r, i in zip(row, self.frame.inner, strict=True)), Fraction(0))
            y += sum((a * v for a, v in zip(k, self.known[w], strict=True)), Fraction(0))
            if j not in self.absent[w] and abs(y - self.mid[w][j]) > self.rad[w][j]:
                return False
        return True

    def check(self, out, h, d):
        """Check every claim of a verdict; return how many FAULTs and CONSISTENTs there were."""
        exactly, faults, explained = lambda column: [Fraction(float(v)) for v in column], 0, 0
        for w, m in enumerate(np.asarray(out)):
            if m < 0:
                value, width = self.residual(w, exactly(np.asarray(h)[:, w]))
                assert abs(value) > width
                faults += 1
            elif m > 0:
                assert self.explained(w, exactly(np.asarray(d)[:, w]))
                explained += 1
        return faults, explained


def run(case, dtype, steps=60, change=None):
    frame, mid, rad, scale, known, known_scale = case.floats(dtype)
    one = np.ones(N, dtype)
    seen = image(frame, mid, rad, scale, known, known_scale, dtype(1), one)
    h, d, done = search(frame, seen, one, steps)
    h, d = change(np.asarray(h), np.asarray(d)) if change else (h, d)
    out, settled = verdict(frame, seen, one, h, d, done)
    return np.asarray(out), np.asarray(settled), h, d


@pytest.mark.compiled
@pytest.mark.parametrize("dtype", [DTYPES[0], pytest.param(DTYPES[1], marks=pytest.mark.long)])
def test_windows_exactly_on_the_boundary_are_never_fault(dtype, rng):
    for _ in range(4):
        case = Case(rng, dtype=dtype)
        assert all(
            case.explained(w, [case.true[w][i] - case.mid[w][i] for i in case.frame.inner]) for w in range(N)
        )
        out, _, h, d = run(case, dtype)
        case.check(out, h, d)
        assert not (out < 0).any()


@pytest.mark.parametrize(
    "dtype, push",
    [(np.float64, 1e-9), pytest.param(np.float32, 1e-2, marks=(pytest.mark.long, pytest.mark.compiled))],
)
def test_every_verdict_near_the_boundary_is_proved_and_sharp(dtype, push, rng):
    faults = explained = 0
    for _ in range(6):
        side = rng.choice([-1, 1], N)
        case = Case(rng, push * side, dtype=dtype)
        out, settled, h, d = run(case, dtype)
        found = case.check(out, h, d)
        assert settled.all() and not (out[side > 0] > 0).any()  # outside by construction
        faults, explained = faults + found[0], explained + found[1]
        assert (out[side > 0] < 0).all()
    assert faults > 100 and explained > 100


@pytest.mark.parametrize("dtype", DTYPES)
def test_no_direction_and_no_point_can_make_a_verdict_wrong(dtype, rng):
    """Garbage, directions and points near the best ones, and both scaled: the proof does not trust the
    search.
    """
    claims = np.zeros(2, int)
    for scale in (0, 1e-6, 1e-2, 1):

        def change(h, d, scale=scale):
            h = h + scale * rng.normal(size=h.shape) * (rng.random(h.shape) < 0.5)
            return (h * 10.0 ** rng.uniform(-6, 6, N)).astype(dtype), (
                d * (1 + scale * rng.normal(size=d.shape))
            ).astype(dtype)

        case = Case(rng, rng.choice([-0.2, -1e-6, 0, 1e-6, 1e-3, 0.5], N), spread=8, dtype=dtype)
        out, _, h, d = run(case, dtype, change=change)
        claims += case.check(out, h, d)
    assert (claims > 20).all()


@pytest.mark.parametrize("dtype", DTYPES)
def test_absent_rows_are_left_out_of_the_proofs(dtype, rng):
    claims = np.zeros(2, int)
    for gone in (1, 2, 3):
        case = Case(rng, rng.choice([-0.1, 0.3, 1.0], N), gone=gone, dtype=dtype)
        out, settled, h, d = run(case, dtype)
        inner = np.array([bool(absent & set(case.frame.inner)) for absent in case.absent])
        assert (out[~settled] == 0).all() and (~settled <= inner).all()
        claims += case.check(out, h, d)
        for w in np.flatnonzero(out < 0):
            assert not any(
                x
                for i, x in enumerate(case.whole([Fraction(float(v)) for v in np.asarray(h)[:, w]]))
                if i in case.absent[w]
            )
    assert (claims > 10).all()


def test_the_factor_is_that_of_a_linear_program(rng):
    case = Case(rng, rng.uniform(-0.9, 3, N), jitter=0.3)
    frame, mid, rad, *_, known, _ = case.floats(np.float64)
    got = np.asarray(margin(frame, mid, rad, known))
    R, K = (np.array([[float(x) for x in row] for row in a]) for a in (case.frame.R, case.frame.K))
    inner, outer = list(case.frame.inner), list(case.frame.outer)
    z = mid[outer] - R @ mid[inner] - K @ known
    for w in range(N):
        scaled = np.vstack([R, np.eye(UNKNOWNS)]) / np.r_[rad[outer, w], rad[inner, w]][:, None]
        target, one = np.r_[z[:, w] / rad[outer, w], np.zeros(UNKNOWNS)], np.ones((ROWS, 1))
        program = Program(
            np.vstack([np.hstack([scaled, one]), np.hstack([scaled, -one])]), np.r_[np.zeros(UNKNOWNS), 1.0]
        )
        free = np.full(ROWS, np.inf)
        expected = program.solve(np.r_[target, -free][None], np.r_[free, target][None])[0]
        assert 1 - got[w] == pytest.approx(expected, rel=1e-8)


def test_margins_and_verdicts_say_the_same(rng):
    case = Case(rng, rng.uniform(-0.9, 3, N), jitter=0.3)
    frame, mid, rad, *_, known, _ = case.floats(np.float64)
    out, *_ = run(case, np.float64)
    assert (out != 0).all()
    np.testing.assert_allclose(out, margin(frame, mid, rad, known), rtol=1e-12, atol=1e-13)


def test_gradients_are_those_of_finite_differences(rng):
    case = Case(rng, rng.uniform(-0.9, 3, N), jitter=0.3)
    frame, mid, rad, *_, known, _ = case.floats(np.float64)
    summed = lambda mid, rad, known: separation_margin(frame, mid, rad, known).sum()
    total, got = kernel(summed), kernel(jax.grad(summed, (0, 1, 2)))(mid, rad, known)
    for part, x in enumerate((mid, rad, known)):
        for i in range(len(x)):
            step = 1e-7 * np.eye(len(x))[i][:, None] * abs(rad).max()
            moved = [
                [v + sign * step if j == part else v for j, v in enumerate((mid, rad, known))]
                for sign in (1, -1)
            ]
            difference = (total(*moved[0]) - total(*moved[1])) / (2 * step.max())
            np.testing.assert_allclose(np.sum(got[part][i]), difference, rtol=1e-5, atol=1e-5)


@pytest.mark.long(by_day="test_every_verdict_near_the_boundary_is_proved_and_sharp")
def test_the_proofs_say_the_same_eagerly(rng):
    case = Case(rng, rng.choice([-1e-3, 1e-3, 1.0], N))
    frame, mid, rad, scale, known, known_scale = case.floats(np.float64)
    out, _, h, d = run(case, np.float64)
    seen = separation.separation_image(frame, mid, rad, scale, known, known_scale, 1.0, np.ones(N))
    eager, _ = separation.separation_verdict(frame, seen, np.ones(N), h, d, np.ones(N, bool))
    case.check(eager, h, d)
    np.testing.assert_array_equal(np.sign(out), np.sign(eager))


def test_a_window_at_the_middle_has_margin_one(rng):
    case = Case(rng, -1.0)
    out, settled, *_ = run(case, np.float64)
    assert settled.all()
    np.testing.assert_allclose(out, 1, atol=1e-13)


def test_without_any_row_of_a_relation_there_is_no_verdict(rng):
    case = Case(rng)
    for absent in case.absent:
        absent |= set(case.frame.outer)
    out, settled, *_ = run(case, np.float64)
    assert np.isnan(out).all() and settled.all()
    frame, mid, rad, *_, known, _ = case.floats(np.float64)
    assert np.isnan(margin(frame, mid, rad, known)).all()


@pytest.mark.parametrize("size", [1e150, 1e300])
def test_a_coefficient_below_all_floats_still_counts(size):
    """y0 = x0, y1 = x0 / 2 + 1e-320 x1, y2 = x1: with x1 large enough, a residual of y0 and y1 is healthy,
    however small.
    """
    least = Fraction(1, 10**320)
    E = ((1, 0), (Fraction(1, 2), least), (0, 1))
    E = tuple(tuple(map(Fraction, row)) for row in E)
    frame = frame_of(frames.frame(E, ((Fraction(0),),) * 3), np.float64)
    assert (np.asarray(frame.R) != 0).sum() == 2
    moved = float(least * Fraction(size))
    mid = np.array([[0.0], [moved], [size]])
    rad = np.full((3, 1), np.finfo(float).tiny) + [[0], [0], [size * 1e-16]]
    one, scale, known = np.ones(1), abs(mid) + rad, np.zeros((1, 1))
    seen = image(frame, mid, rad, scale, known, known, 1.0, one)
    for h in (1.0, 1e-20):
        out, _ = verdict(frame, seen, one, np.full((1, 1), h), np.zeros((2, 1)), np.ones(1, bool))
        assert out[0] >= 0


def test_no_bound_at_all_leaves_no_verdict_without_a_proof(rng):
    """Infinite samples: NaN and infinity anywhere are neither inside nor outside."""
    case = Case(rng)
    frame, mid, rad, scale, known, known_scale = case.floats(np.float64)
    mid[rng.integers(ROWS, size=N), np.arange(N)] = np.inf
    one = np.ones(N)
    seen = image(frame, mid, rad, abs(mid) + rad, known, known_scale, 1.0, one)
    out, _ = verdict(frame, seen, one, *search(frame, seen, one, 60))
    assert not (out < 0).any() and not (out > 0).any()

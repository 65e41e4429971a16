"""Linearized models: every simulated step of the nonlinear plant obeys the linear one within its disturbance,
and the bound is close.
"""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbound as jb
from jaxbound.models.linearize import linearize
from jaxbound.models.remainder import plane

integrate = pytest.importorskip("scipy.integrate")
linalg = pytest.importorskip("scipy.linalg")

SLACK = 1e-10  # of the simulation, run with a relative tolerance of 1e-12


@jax.jit
def tanks(x, u):
    """Two tanks in a row, levels in m, inflow in 1/s."""
    out = 0.05 * jnp.sqrt(x)
    return jnp.array([0.1 * u[0] - out[0], out[0] - out[1]])


@jax.jit
def reactor(x, u):
    """A stirred tank: concentration, temperature in 100 K; temperature of the coolant."""
    rate = 7.2e10 * jnp.exp(-87.5 / x[1]) * x[0]
    return jnp.array([1 - x[0] - rate, 3.5 - x[1] + 2.092 * rate + 2.092 * (u[0] - x[1])])


@jax.jit
def pendulum(x, u, p):
    return jnp.array([x[1], -9.81 / p["length"] * jnp.sin(x[0]) - p["drag"] * x[1] + u[0]])


@jax.jit
def fan(x, u, p):
    """Heat of a room: proportional to what is uncertain."""
    return jnp.array([p["UA"] * (u[0] - x[0]) + 0.1 * u[1]])


def floats(a):
    return np.array([[float(v) for v in row] for row in a])


def steps(f, region, dt, rng, count, p=None):
    """Return (x, u, x+) of steps that stay in the region: from random points, half of them on corners, inputs
    held.
    """
    lo, hi = (np.array([pair[k] for pair in (*region["x"], *region["u"])]) for k in (0, 1))
    n, found = len(region["x"]), []
    for k in range(count):
        z = np.where(rng.random(len(lo)) < 0.5, lo, hi) if k % 2 else rng.uniform(lo, hi)
        x, u = z[:n], z[n:]
        rate = lambda t, x, u=u: np.asarray(f(x, u, *([] if p is None else [p])))
        run = integrate.solve_ivp(rate, (0, dt), x, "DOP853", rtol=1e-12, atol=1e-14, dense_output=True)
        path = run.sol(np.linspace(0, dt, 30)).T
        if ((path >= lo[:n]) & (path <= hi[:n])).all():
            found.append((x, u, run.y[:, -1]))
    assert len(found) >= count // 10
    return (np.array(part) for part in zip(*found, strict=True))


def left_over(m, x, u, after, p=None):
    """Return what the linear model leaves of the steps."""
    A, B = floats(m.A), floats(m.B)
    for v in m.uncertainties:
        away = p[v.name] - float(v.centre)
        A = A + away * floats(v.A) if v.A else A
        B = B + away * floats(v.B) if v.B else B
    x0, u0 = (np.array([float(v) for v in m.offset[s]]) for s in "yu")
    return (after - x0) - (x - x0) @ A.T - ((u - u0) @ B.T if len(u0) else 0)


def inside(w, m):
    lo, hi = floats(m.disturbance).T
    return ((w >= lo - SLACK) & (w <= hi + SLACK)).all()


LEVELS, FLOW = [1.0, 1.0], [0.5]


def region_of(r):
    return {"x": [(1 - r, 1 + r)] * 2, "u": [(0.5 - r, 0.5 + r)]}


@pytest.fixture(scope="module")
def two_tanks():
    return {
        r: linearize(tanks, LEVELS, FLOW, 2.0, region=region_of(r), states=["h1", "h2"]) for r in (0.2, 0.1)
    }


def test_every_step_inside_the_region_obeys_the_model(two_tanks, rng):
    for r, m in two_tanks.items():
        w = left_over(m, *steps(tanks, region_of(r), 2.0, rng, 60))
        lo, hi = floats(m.disturbance).T
        assert inside(w, m)
        assert (w.max(0) > 0.5 * hi).all() and hi[0] > -100 * lo[
            0
        ]  # not far off, and of one sign as the remainder of a root is


def test_half_the_region_has_a_quarter_of_the_bound(two_tanks):
    wide, small = (np.diff(floats(two_tanks[r].disturbance))[:, 0] for r in (0.2, 0.1))
    assert ((3.9 < wide / small) & (wide / small < 4.3)).all()


def test_matrices_are_those_of_the_slopes_held_over_a_step(two_tanks):
    block = np.zeros((3, 3))
    block[:2, :2], block[0, 2] = np.array([[-0.025, 0], [0.025, -0.025]]) * 2.0, 0.1 * 2.0
    step, m = linalg.expm(block), two_tanks[0.2]
    np.testing.assert_allclose(floats(m.A), step[:2, :2], atol=1e-15)
    np.testing.assert_allclose(floats(m.B), step[:2, 2:], atol=1e-15)
    assert m.offset == {"u": (Fraction(1, 2),), "y": (1, 1)} and m.outputs == ("h1", "h2") and m.dt == 2
    assert (
        m.provenance["disturbance"] == "linearized over h1 in [0.8, 1.2], h2 in [0.8, 1.2], u1 in [0.3, 0.7]"
    )


def test_a_healthy_plant_is_never_faulty_and_a_leak_is_seen(rng):
    m = linearize(
        tanks, LEVELS, FLOW, 2.0, region=region_of(0.2), noise=0.001, disturbance=([[1], [0]], [(0, 0)])
    )
    assert m.g == 3 and m.disturbance[2] == (0, 0)
    u = np.repeat(rng.uniform(0.47, 0.53, 8), 10)[:, None]
    drain = lambda x, u, leak: np.asarray(tanks(x, u)) - np.array([leak, 0])
    for leak in (0.0, 0.004):
        x = [np.array([1.0, 1.0])]
        for now in u[:-1]:
            run = integrate.solve_ivp(
                lambda t, x, now=now, leak=leak: drain(x, now, leak), (0, 2.0), x[-1], rtol=1e-9, atol=1e-12
            )
            x.append(run.y[:, -1])
        y = np.array(x) + rng.uniform(-0.001, 0.001, (len(x), 2))
        status = jb.detect(jb.parity_relations(m), u, y).status
        assert (status == jb.Status.FAULT).any() == (leak > 0)


@pytest.fixture(scope="module")
def uncertain():
    """A model that is linear but for its parameter, taken about zero: nothing is left but what the
    exponential adds.
    """
    return linearize(
        fan,
        [0],
        [0, 0],
        0.5,
        region={"x": [(10, 30)], "u": [(0, 40), (-10, 10)]},
        parameters={"UA": (0.2, "0.25")},
        varying=False,
        inputs=["outside", "heater"],
        states=["T"],
        units={"T": "degC"},
        noise=0.1,
    )


def test_parameters_become_uncertainties_in_their_own_units(uncertain, rng):
    (v,) = uncertain.uncertainties
    assert v.name == "UA" and v.between == (Fraction(1, 5), Fraction(1, 4)) and not v.varying
    region = {"x": [(10, 30)], "u": [(0, 40), (-10, 10)]}
    for value in (0.2, 0.25, rng.uniform(0.2, 0.25)):
        w = left_over(uncertain, *steps(fan, region, 0.5, rng, 20, {"UA": value}), {"UA": value})
        assert inside(w, uncertain)
    # the second derivative of exp(-UA dt) by UA, times 0.025^2, times the largest difference of temperatures:
    # what cannot be avoided
    (lo, hi), curved = uncertain.disturbance[0], 0.5**2 * np.exp(-0.1) / 2 * 0.025**2 * 30
    assert curved / 2 < hi < 3 * curved and -hi <= lo < 0


def test_a_discrete_model_keeps_its_own_steps(rng):
    f = lambda x, u: jnp.array([0.9 * x[0] - 0.1 * x[0] * x[0] + u[0]])
    m = linearize(f, [1.0], [0.2], region={"x": 0.5, "u": 0.1}, continuous=False)
    x, u = rng.uniform(0.5, 1.5, (1000, 1)), rng.uniform(0.1, 0.3, (1000, 1))
    w = left_over(m, x, u, 0.9 * x - 0.1 * x * x + u)
    lo, hi = floats(m.disturbance)[0]
    assert m.A == ((Fraction(7, 10),),) and inside(w, m) and hi - lo < 1.02 * 0.1 * 0.5**2


def test_a_curved_output_widens_the_noise():
    h = lambda x, u: jnp.array([x[0], x[0] * x[0]])
    f = lambda x, u: jnp.array([-x[0]])
    m = linearize(f, [2.0], None, 0.1, region={"x": 0.5}, output=h, noise=[0.1, 0.2], tolerance=[0.02, 0.1])
    assert m.offset["y"] == (2, 4) and m.C == ((1,), (4,)) and "linearized" in m.provenance["noise"]
    assert 0 <= m.noise[0] - Fraction(1, 10) < 1e-12
    assert 0.25 * 1.1 <= float(m.noise[1]) - 0.2 < 0.25 * 1.1 * 1.01


@pytest.mark.parametrize(
    "change, sentence",
    [
        ({"region": {"x": [(0, 2), (0, 2)], "u": 0.1}}, "not proved to be continuous with bounded slopes"),
        ({"region": {"x": 0.1}}, 'region needs the fields "x" and, with inputs, "u"'),
        ({"region": {"x": [0.1] * 3, "u": 0.1}}, "needs one radius, 2 radii or 2 pairs"),
        ({"region": {"x": -0.1, "u": 0.1}}, "lo <= hi and radii >= 0"),
        ({"dt": 0}, "positive dt"),
        ({"x0": [1.0]}, "one number for each of the 1 states"),
        ({"offset": {"u": 0}}, "itself finds offset"),
        ({"parameters": {"k": 3}}, "the lowest and the highest"),
        ({"states": ["a"]}, "states needs 2 names"),
    ],
)
def test_bad_input_is_told(change, sentence):
    given = {"x0": LEVELS, "u0": FLOW, "dt": 2.0, "region": {"x": 0.1, "u": 0.1}} | change
    f = tanks if "parameters" not in change else lambda x, u, p: tanks(x, u)
    with pytest.raises(ValueError, match=sentence):
        linearize(f, given.pop("x0"), given.pop("u0"), **given)


def test_reactor_and_pendulum_obey_their_models(rng):
    region = {"x": [(0.4, 0.6), (3.4, 3.6)], "u": [(2.9, 3.1)]}
    m = linearize(reactor, [0.5, 3.5], [3.0], 0.05, region=region)
    w = left_over(m, *steps(reactor, region, 0.05, rng, 30))
    hi = np.abs(floats(m.disturbance)).max(1)
    assert inside(w, m) and (np.abs(w).max(0) > 0.3 * hi).all()

    region = {"x": [(-0.5, 0.5), (-1, 1)], "u": [(-1, 1)]}
    between = {"length": (0.9, 1.1), "drag": (0.1, 0.3)}
    m = linearize(pendulum, [0, 0], [0], 0.05, region=region, parameters=between)
    for _ in range(3):
        p = {name: rng.choice([lo, hi, rng.uniform(lo, hi)]) for name, (lo, hi) in between.items()}
        w = left_over(m, *steps(pendulum, region, 0.05, rng, 12, p), p)
        assert inside(w, m)
    assert {v.name for v in m.uncertainties} == {"length", "drag"} and np.abs(
        floats(m.disturbance)
    ).max() < 0.03


def test_a_kink_is_enclosed_with_all_its_slopes(rng):
    found = plane(lambda x: jnp.abs(x) + jnp.sin(3 * x), [Fraction(-1)], [Fraction(2)])
    x = rng.uniform(-1, 2, 5000)
    r = np.abs(x) + np.sin(3 * x) - float(found.slopes[0, 0]) * (x - 0.5)
    lo, hi = found.remainder[0].astype(float)
    assert lo <= r.min() and r.max() <= hi and hi - lo < 1.01 * np.ptp(r)


@pytest.mark.compiled
@pytest.mark.long(by_day="test_every_step_inside_the_region_obeys_the_model")
@pytest.mark.parametrize("case", range(9))
def test_random_plants_obey_their_models_about_any_point(case, rng):
    n, m, q = 1 + case % 3, case % 2, (case // 3) % 3
    W, V, M, P = (rng.normal(size=shape) for shape in ((n, n), (n, max(m, 1)), (n, n), (n, q + 1)))
    centre, radii = rng.uniform(-1, 1, n + m), 10.0 ** rng.uniform(-2, -0.3, n + m)
    stiff = 10.0 ** rng.uniform(-1, 1.5)

    @jax.jit
    def f(x, u, p=None):
        v = V[:, :m] @ (u - centre[n:]) if m else 0.0
        k = sum((P[:, i] * p[f"p{i}"] for i in range(q)), jnp.zeros(n))
        return (
            -stiff * (x - centre[:n])
            + jnp.sin(W @ (x - centre[:n]) + v) * (1 + 0.3 * k)
            + 0.2 * (M @ x) ** 2
            + k * (x - centre[:n])
        )

    boxes = [(c - r, c + r * rng.uniform(0.2, 1)) for c, r in zip(centre, radii, strict=True)]
    region = {"x": boxes[:n], "u": boxes[n:]} if m else {"x": boxes}
    origin = np.round(centre + rng.choice([0.0, 0.7], n + m), 3)  # inside the region, or elsewhere
    between = {f"p{i}": tuple(np.sort(rng.uniform(-1, 1, 2))) for i in range(q)}
    dt = 10.0 ** rng.uniform(-2, 0) / stiff
    made = jb.linearize(
        f, origin[:n], origin[n:] if m else None, dt, region=region, parameters=between or None
    )
    enclosed = []
    for _ in range(2):
        p = {name: rng.choice([lo, hi, rng.uniform(lo, hi)]) for name, (lo, hi) in between.items()}
        rate = lambda t, x, u, p=p: np.asarray(f(x, u, *([p] if q else [])))
        for _ in range(20):
            z = np.array([rng.choice([lo, hi, rng.uniform(lo, hi), rng.uniform(lo, hi)]) for lo, hi in boxes])
            run = integrate.solve_ivp(
                rate, (0, dt), z[:n], "DOP853", rtol=1e-12, atol=1e-14, dense_output=True, args=(z[n:],)
            )
            path = run.sol(np.linspace(0, dt, 30)).T
            if all(
                (path[:, i] >= lo).all() and (path[:, i] <= hi).all() for i, (lo, hi) in enumerate(boxes[:n])
            ):
                enclosed.append(inside(left_over(made, z[None, :n], z[None, n:], run.y[:, -1], p), made))
    if not enclosed:
        pytest.skip("no trajectory of this plant stayed in its region")
    assert all(enclosed)

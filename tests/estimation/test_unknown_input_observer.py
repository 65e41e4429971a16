"""Set observers of models with unknown inputs: whatever these do, the state is inside, and a FAULT is one of
a linear program.
"""

import json

import jax
import numpy as np
import pytest
from check_certificate import confirm
from scipy.optimize import linprog

import jaxbound as jb
from jaxbound.certificates.interface import certify
from jaxbound.certificates.long_window import program as in_floats
from jaxbound.certificates.long_window import stretch
from jaxbound.exact import linalg
from jaxbound.models.unknown_directions import unknown_directions, with_direct_states

SPRINGS = [
    ["1", "0.1", "0", "0"],
    ["-0.1", "0.9", "0.1", "0"],
    ["0", "0", "1", "0.1"],
    ["0.1", "0", "-0.1", "0.95"],
]
TANK = jb.LinearSystem(
    [["0.9", "0.2"], ["-0.1", "0.95"]],
    [[0], [1]],
    [[1, 0], [0, 1], [1, 1]],
    [["0.3"], [0], ["0.5"]],
    noise=["0.1", "0.2", "0.3"],
    disturbance=([[1], ["0.5"]], "0.02"),
    unknown_inputs=[[1], ["0.5"]],
    tolerance=[0, "0.01", 0],
)
"""Each of its outputs shows the unknown input at once."""
MASSES = jb.LinearSystem(
    SPRINGS,
    None,
    [[1, 0, 0, 0], [0, 0, 1, 0]],
    noise="0.1",
    unknown_inputs=[[0], [1], [0], [0]],
    disturbance=([[0], [0], [0], [1]], "0.02"),
)
"""An unknown force on one of two masses whose places are measured: its speed is never known, all else is."""
GAUGE = TANK.replace(unknown_inputs=([[1], ["0.5"]], [[0], [0], [1]]), tolerance=[0, "0.01", 0])
"""What acts on the states acts on an output, too."""
SYSTEMS = {"tank": TANK, "masses": MASSES, "gauge": GAUGE}


def program(model, u, y, k, x0=None):
    """Return the least and largest of each state of sample k that explain all samples up to it; None: nothing
    does.

    Independent of the observer: floats of the model, variables are all states, disturbances and unknown
    inputs, these without bounds.
    """
    A, B, C, D, F, D_v, G = (
        np.array(getattr(model, x), float).reshape(len(getattr(model, x)), -1)
        for x in ("A", "B", "C", "D", "F", "D_v", "G")
    )
    n, g, d, T = model.n, model.g, model.d, k + 1
    at = lambda j, what: {"x": j * n, "w": T * n + j * g, "d": T * (n + g) + j * d}[what]
    count = T * (n + g + d)
    same, right, below, ends = [], [], [], []
    lo, hi = np.array(model.disturbance, float).T
    free: list = [(None, None)] * (T * n) + list(zip(lo, hi, strict=True)) * T + [(None, None)] * (T * d)
    if x0 is not None:
        free[:n] = zip(*x0, strict=True)
    for j in range(T):
        v = u[j] if B.size else np.zeros(0)
        if j + 1 < T:
            row = np.zeros((n, count))
            row[:, at(j, "x") : at(j, "x") + n], row[:, at(j + 1, "x") : at(j + 1, "x") + n] = -A, np.eye(n)
            row[:, at(j, "w") : at(j, "w") + g], row[:, at(j, "d") : at(j, "d") + d] = -G, -F
            same.append(row)
            right.append(B @ v if B.size else np.zeros(n))
        for i in range(model.p):
            if not np.isnan(y[j, i]):
                t, r = float(model.tolerance[i]), float(model.noise[i])
                values = [
                    (y[j, i] + a) / (1 + b) - (D[i] @ v if B.size else 0) for a in (-r, r) for b in (-t, t)
                ]
                row = np.zeros(count)
                row[at(j, "x") : at(j, "x") + n], row[at(j, "d") : at(j, "d") + d] = C[i], D_v[i]
                below += [row, -row]
                ends += [max(values), -min(values)]
    out = np.zeros((2, n))
    for i in range(n):
        for side, sign in enumerate((1, -1)):
            cost = sign * np.eye(count)[at(k, "x") + i]
            rows = (np.concatenate(same), np.concatenate(right)) if same else (None, None)
            found = linprog(cost, below, ends, *rows, bounds=free, method="highs")
            if found.status == 2:
                return None
            out[side, i] = sign * (-np.inf if found.status in (3, 4) else found.fun)
    return out


def recorded(model, T, key, N, at="uniform", dtype=np.float64):
    """Return u, x, y of fault-free recordings whose unknown inputs are anything between nothing and a
    thousand.
    """
    rng = np.random.default_rng(key)
    u, size = rng.normal(size=(N, T, model.m)).astype(dtype), 10 ** rng.uniform(-3, 3, (N, T, 1))
    d = (size * rng.normal(size=(N, T, model.d))).astype(dtype)
    found = jb.simulate(
        model, u, jax.random.key(key), x0=3 * rng.normal(size=(N, model.n)), at=at, unknown_input=d
    )
    return np.array(found.u), np.asarray(found.x, np.float64), np.array(found.y)


def inside(found, x, size, dtype):
    slack = (1e-12 if dtype == np.float64 else 2e-6) * (
        1 + abs(x) + size
    )  # of the states as simulate returns them
    return (np.asarray(found.state.lo) <= x + slack) & (x - slack <= np.asarray(found.state.hi))


@pytest.mark.parametrize("name", ["tank", "masses"])
def test_an_enclosure_holds_what_linear_programs_with_free_inputs_allow(name):
    model, first = SYSTEMS[name], ([-20.0] * SYSTEMS[name].n, [20.0] * SYSTEMS[name].n)
    u, _, y = recorded(model, 10, 1, 2)
    y[:, 4, 1] = np.nan
    free, known = jb.observe(model, u, y), jb.observe(model, u, y, x0=jb.interval(*first))
    compared = 0
    for k in (0, 3, 9):
        for found, x0 in ((free, None), (known, first)):
            lo, hi = program(model, u[1], y[1], k, x0)
            got = np.array([found.state.lo[1, k], found.state.hi[1, k]])
            slack = 1e-6 * (1 + np.where(np.isfinite(lo), abs(lo), 0))
            assert (got[0] <= lo + slack).all() and (hi - slack <= got[1]).all()
            if found.since[1, k] == 0 and k:
                bounded = np.isfinite(hi - lo)
                assert (np.isfinite(got).all(0) == bounded).all(), (
                    "nothing is known of exactly the states that inputs may move unseen"
                )
                assert ((got[1] - got[0]) < 4 * (hi - lo))[bounded].all(), "and the rest is not much wider"
                compared += 1
    assert compared >= 1
    assert (name == "masses") == (not np.isfinite(free.state.hi[..., 1]).any())


@pytest.mark.parametrize(
    "name",
    ["tank", pytest.param("masses", marks=pytest.mark.long), pytest.param("gauge", marks=pytest.mark.long)],
)
def test_every_proof_of_a_fault_is_one_of_a_linear_program(name):
    """Near the boundary: jumps of a sensor from far below to far above what can be proved."""
    model, N = SYSTEMS[name], 24
    u, _, y = recorded(model, 12, 3, N)
    y[:, 6:, 1 if name == "masses" else 0] += np.linspace(0, 1.6, N)[:, None]
    found = jb.observe(model, u, y, restart=False)
    proved = possible = 0
    for j in range(N):
        wrong = found.status[j] == jb.Status.FAULT
        possible += program(model, u[j], y[j], 11) is None
        if wrong.any():
            k = int(wrong.argmax())
            assert wrong[k:].all() and program(model, u[j], y[j], k) is None
            proved += 1
    print(f"{name}: {proved} of {possible} contradictions proved")
    assert possible >= 6 and proved >= 0.7 * possible


@pytest.mark.usefixtures("searched_in_numpy")
@pytest.mark.parametrize("name", ["tank", pytest.param("gauge", marks=pytest.mark.long)])
def test_joint_observers_prove_nearly_what_programs_with_free_inputs_refute_and_nothing_else(name):
    model, N, T = SYSTEMS[name], 8, 14
    u, x, y = recorded(model, T, 11, N)
    y[0, 5, 0] = np.nan
    healthy = jb.observe(model, u, y, method="joint", window=6)
    assert inside(healthy, x, 1, np.float64).all() and not (healthy.status == jb.Status.FAULT).any()
    lo, hi = program(model, u[1], y[1], T - 1)
    got = healthy.state.lo[1, -1], healthy.state.hi[1, -1]
    assert (
        (got[0] <= lo + 1e-9).all()
        and (hi <= got[1] + 1e-9).all()
        and (got[1] - got[0] < 1.1 * (hi - lo)).all()
    )
    y[:, 8:, 0] += np.linspace(0.05, 1.6, N)[:, None]
    found = jb.observe(model, u, y, method="joint", window=6, restart=False)
    proved = [int(wrong.argmax()) if wrong.any() else None for wrong in found.status == jb.Status.FAULT]
    assert all(k is None or program(model, u[j], y[j], k) is None for j, k in enumerate(proved))
    possible = [program(model, u[j], y[j], T - 1) is None for j in range(N)]
    assert sum(possible) >= 4 and sum(k is not None for k in proved) >= sum(possible) - 1


def systems(rng):
    """Return a random model with one or two unknown inputs, on states, outputs or both, and everything else
    that a model can have.
    """
    while True:
        n, p, d = rng.integers(2, 5), rng.integers(2, 5), rng.integers(1, 3)
        A = rng.normal(size=(n, n))
        A = (rng.choice([0.8, 1.0, 1.05]) * A / abs(np.linalg.eigvals(A)).max()).round(3)
        some = lambda *shape: rng.normal(size=shape).round(2) * (rng.random(shape) < 0.6)
        B, C, D, G, F = some(n, 1), some(p, n), some(p, 1), some(n, 2), some(n, d)
        D_v = some(p, d) * (rng.random() < 0.3)
        more = (
            {"uncertainties": [jb.Uncertainty("a", A=(0.003 * rng.normal(size=(n, n))).round(5))]}
            if rng.random() < 0.3
            else {}
        )
        model = jb.LinearSystem(
            A,
            B,
            C,
            D,
            noise=rng.choice([0.02, 0.1, 0.3], p),
            tolerance=rng.choice([0, 0.02], p),
            unknown_inputs=(F, D_v),
            disturbance=(G, [[-0.02, 0.05], [0, 0]]),
            offset={"u": 1.5, "y": rng.normal(size=p).round(1)},
            **more,
        )
        try:
            jb.observer(model, x0=jb.interval([-1.0] * n, [1.0] * n))
        except ValueError as e:
            assert "whatever" in str(e), model
            continue
        return model


def fault_free(models, N, T, dtype, methods=("zonotope", "strips")):
    """Return how many fault-free samples were observed, and of how many something was known of a state; half
    with unknowns at vertices.
    """
    samples, known = 0, 0
    for seed, model in enumerate(models):
        u, x, y = recorded(model, T, seed, N, ("vertices", "uniform")[seed % 2], dtype)
        size = np.max(abs(np.nan_to_num(y)), axis=(1, 2))[:, None, None]
        y[np.random.default_rng(seed).random(y.shape) < 0.01] = np.nan
        first = jb.interval([float(x[:, 0].min()) - 1] * model.n, [float(x[:, 0].max()) + 1] * model.n)
        for method in methods:
            x0 = None if method == "zonotope" else first
            try:
                found = jb.observe(model, u, y, order=5, method=method, x0=x0, starts=[T // 2])
            except ValueError as e:
                assert (
                    "needs outputs" in str(e) if method == "joint" else x0 is None and "do not show" in str(e)
                )
                continue
            assert inside(found, x, size, dtype).all() and not (found.status == jb.Status.FAULT).any()
            samples += y[..., 0].size
            known += np.isfinite(found.state.hi).any(-1).sum()
    return samples, known


def test_the_state_of_fault_free_recordings_is_inside_and_nothing_is_a_fault():
    unsure = MASSES.replace(uncertainties=[jb.Uncertainty("a", A=(0.01 * np.eye(4)).tolist())])
    samples, known = fault_free([unsure, TANK], 24, 40, np.float64, ["zonotope"])
    assert known > 0.9 * samples > 1500, "what encloses nothing proves nothing"


@pytest.mark.long(by_day="test_the_state_of_fault_free_recordings_is_inside_and_nothing_is_a_fault")
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_half_a_million_fault_free_samples(rng, dtype):
    with jax.enable_x64(dtype == np.float64):
        samples, known = fault_free([systems(rng) for _ in range(40)], 100, 96, dtype)
    print(
        f"{np.dtype(dtype).name}: {samples} fault-free samples, {known} with bounds of a state, the state "
        f"inside all, 0 FAULT"
    )
    assert samples > 500_000 and known > 0.3 * samples


@pytest.mark.long(by_day="test_the_state_of_fault_free_recordings_is_inside_and_nothing_is_a_fault")
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_fifty_thousand_fault_free_samples_of_joint_observers(rng, dtype):
    with jax.enable_x64(dtype == np.float64):
        samples, known = fault_free([systems(rng) for _ in range(16)], 64, 96, dtype, ["joint"])
    print(
        f"joint, {np.dtype(dtype).name}: {samples} fault-free samples, {known} with bounds of a state, the "
        f"state inside all, 0 FAULT"
    )
    assert samples > 50_000 and known > 0.3 * samples


def test_a_model_is_refused_exactly_where_no_window_has_a_relation(rng):
    refused = 0
    for _ in range(60):
        n, p, d = rng.integers(1, 4), rng.integers(1, 4), rng.integers(1, 3)
        A, C, F = (rng.integers(-1, 2, shape) for shape in ((n, n), (p, n), (n, d)))
        D_v = rng.integers(-1, 2, (p, d)) * (rng.random() < 0.5)
        model = jb.LinearSystem(A, None, C, noise=1, unknown_inputs=(F, D_v))
        whole = with_direct_states(model)
        if not F.any() and not D_v.any():
            continue
        try:
            found = unknown_directions(whole)
        except ValueError as e:
            assert "measure one more signal" in str(e)
            found = None
        refused += found is None
        try:
            jb.parity_relations(model, model.n + model.d + 1)
        except ValueError as e:
            assert found is None, f"{e}: {model.A} {model.C} {model.F} {model.D_v}"
            continue
        assert found is not None
        S = linalg.transpose(found.rows)
        for way in found.ways:
            seen = [
                [sum(row) for row in zip(*parts, strict=True)]
                for parts in zip(
                    linalg.matmul(whole.C, way.M),
                    linalg.matmul(linalg.matmul(whole.C, way.H), whole.C),
                    strict=True,
                )
            ]
            assert not any(x for row in linalg.matmul(way.M, S) for x in row)
            assert tuple(map(tuple, seen)) == whole.C
    assert 5 <= refused <= 55


def test_an_output_that_is_missing_is_replaced_by_another_and_only_all_of_them_begin_anew():
    u, _, y = recorded(TANK, 14, 5, 2)
    some, none = y.copy(), y.copy()
    some[:, 6, :2], none[:, 6] = np.nan, np.nan
    found = jb.observe(TANK, u, some, restart=False)
    assert found.status[0, 6:].tolist() == [jb.Status.MISSING, *[jb.Status.UNDECIDED] * 7], (
        "one output shows the unknown input: no test"
    )
    assert (found.since[0, 1:] == 0).all() and np.isfinite(found.state.hi[0, 6]).all()
    found = jb.observe(TANK, u, none)
    assert found.since[0, 6] == -1 and found.since[0, 8] == 7


def test_in_pieces_it_says_the_same_and_a_fault_is_proved_behind_wild_inputs():
    u, _, y = recorded(TANK, 30, 7, 2)
    y[1, 20:, 2] += 4
    whole = jb.detect(jb.observer(TANK), u, y)
    assert (whole.status[0] != jb.Status.FAULT).all() and (whole.status[1, 20:] == jb.Status.FAULT).any()
    alone, monitor = jb.detect(jb.observer(TANK), u[1], y[1]), jb.Monitor(jb.observer(TANK))
    state, told = monitor.init(), []
    for a, b in zip(u[1], y[1], strict=True):
        state, one = monitor.step(state, a, b)
        told.append(int(one.status))
    assert told == alone.status.tolist() == whole.status[1].tolist()


@pytest.mark.parametrize("name", ["tank", "masses", "gauge"])
@pytest.mark.parametrize("known", [False, True])
def test_a_contradiction_of_many_samples_is_one_relation_that_fractions_replay(name, known):
    model = SYSTEMS[name]
    u, _, y = recorded(model, 40, 7, 1)
    y[0, 20:, 0] += (0.2 if name == "tank" else 0.5) * np.arange(20)
    y[0, 7, 0 if name == "gauge" else 1] = np.nan
    about = stretch(model, 39, [(-20.0, 20.0)] * model.n if known else None)
    found = certify(about, u[0], y[0])
    confirm(json.loads(found.to_json()))
    assert float(found.factor) == pytest.approx(in_floats(found.window)[0], rel=1e-4) and found.factor > 1
    assert program(model, u[0], y[0], 39, ([-20.0] * model.n, [20.0] * model.n) if known else None) is None
    healthy = recorded(model, 40, 7, 1)[2][0]
    with pytest.raises(NotImplementedError, match="no relation"):
        certify(about, u[0], healthy)
    healthy[10] = np.nan
    with pytest.raises(NotImplementedError, match="no relation"):
        certify(about, u[0], healthy)


def test_an_unknown_input_that_is_made_a_state_is_enclosed_one_sample_later(rng):
    d, u = 1000 * rng.normal(size=(60, 1)), rng.normal(size=(60, 1))
    found = jb.simulate(TANK, u, jax.random.key(1), unknown_input=d, at="vertices")
    u, y = np.array(found.u), np.array(found.y)
    y[30] = np.nan
    more = TANK.replace(
        A=[["0.9", "0.2", 0], ["-0.1", "0.95", 0], [0, 0, 0]],
        B=[[0], [1], [0]],
        C=[[1, 0, 0], [0, 1, 0], [1, 1, 0]],
        disturbance=([[1], ["0.5"], [0]], "0.02"),
        unknown_inputs=[[1], ["0.5"], [1]],
        states=["x1", "x2", "before"],
    )
    state = jb.observe(more, u, y).state
    lo, hi = np.asarray(state.lo)[1:, 2], np.asarray(state.hi)[1:, 2]
    assert ((lo <= d[:-1, 0]) & (d[:-1, 0] <= hi)).all()
    assert np.isfinite(hi).mean() > 0.9 and (np.sort(hi - lo)[:50] < 0.8).all()


def test_what_an_observer_of_unknown_inputs_cannot_take_is_said():
    for match, model in (
        (
            "unknown input 1 alone explains whatever the 1 outputs show",
            jb.LinearSystem([[0.5]], None, [[1]], noise=1, unknown_inputs=[[1]]),
        ),
        (
            "unknown inputs 1, 3 together explain",
            MASSES.replace(unknown_inputs=[[0, 0, 0], [1, 1, 0], [0, 0, 0], [0, 0, 1]]),
        ),
        (
            "needs certain outputs, and 'a' acts on C",
            TANK.replace(uncertainties=[jb.Uncertainty("a", C=[[1, 0], [0, 0], [0, 0]])]),
        ),
    ):
        with pytest.raises(ValueError, match=match):
            jb.observer(model)
    with pytest.raises(ValueError, match="needs outputs that show what unknown inputs do at once"):
        jb.observer(MASSES, method="joint")

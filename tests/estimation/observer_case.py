"""What tests of set observers share: a plant, random models, recordings without a fault, and linear programs
over all samples.
"""

import jax
import numpy as np
from scipy.optimize import linprog

import jaxbound as jb
from jaxbound.sets import zonotope
from jaxbound.sets.floats.kernel import is_outside_xla, outside_xla

PLANT = jb.LinearSystem(
    [["0.9", "0.2"], ["-0.1", "0.95"]],
    [[0], [1]],
    [[1, 0]],
    noise="0.1",
    disturbance=([[1], ["0.5"]], "0.02"),
    tolerance="0.01",
)


def program(model, u, y, x0=None):
    """Return the least and largest of each state of the last sample that explain all samples, by linear
    programs; None: nothing does.

    Independent of the observer: floats of the model, one variable a first state and a disturbance.
    """
    A, B, C, G = (np.array(getattr(model, name), float) for name in "ABCG")
    n, g, T = model.n, model.g, len(y)
    lo, hi = np.array(model.disturbance, float).T
    count = n + g * (T - 1)
    bounds = [(None, None)] * n if x0 is None else list(zip(*x0, strict=True))
    bounds += [(a, b) for _ in range(T - 1) for a, b in zip(lo, hi, strict=True)]
    X, f = np.eye(n, count), np.zeros(n)
    rows, right = [], []
    for k in range(T):
        if k:
            X, f = A @ X, A @ f + (B @ u[k - 1] if B.size else 0)
            X[:, n + g * (k - 1) : n + g * k] += G
        for i in range(model.p):
            if not np.isnan(y[k, i]):
                t, r = float(model.tolerance[i]), float(model.noise[i])
                ends = [(y[k, i] + a) / (1 + b) for a in (-r, r) for b in (-t, t)]
                rows += [C[i] @ X, -C[i] @ X]
                right += [max(ends) - C[i] @ f, C[i] @ f - min(ends)]
    out = np.zeros((2, n))
    for i in range(n):
        for side, sign in enumerate((1, -1)):
            found = linprog(sign * X[i], np.array(rows), right, bounds=bounds, method="highs")
            if found.status == 2:
                return None
            assert found.status == 0
            out[side, i] = sign * found.fun + f[i]
    return out


def recorded(model, T, key, N=None, at="vertices", dtype=np.float64):
    """Return u, x, y of fault-free recordings."""
    rng = np.random.default_rng(key)
    shape = (T, model.m) if N is None else (N, T, model.m)
    u = rng.normal(size=shape).astype(dtype)
    x0 = 3 * rng.normal(size=(*shape[:-2], model.n))
    found = jb.simulate(model, u, jax.random.key(key), x0=x0, at=at)
    return np.array(found.u), np.asarray(found.x, np.float64), np.array(found.y)


def inside(found, x, dtype=np.float64):
    slack = (1e-12 if dtype == np.float64 else 2e-6) * (1 + abs(x))  # of the states as simulate returns them
    return (np.asarray(found.state.lo) <= x + slack) & (x - slack <= np.asarray(found.state.hi))


def published(case):
    """Return (model, u, y, x0) of CORA's example, with an input that does nothing: of the sizes of PLANT,
    whose kernels it shares.
    """
    noise, walk = case["V_radius"][0], (case["W_generators"], 1)
    model = jb.LinearSystem(case["A"], [[0], [0]], case["C"], noise=noise, disturbance=walk)
    y = np.array(case["y"]).T
    return model, np.zeros((len(y), 1)), y, zonotope([0.0, 0.0], case["R0_generators"])


def systems(rng, kind):
    """Return a random model: stable, integrating or unstable, perhaps uncertain, with everything that a model
    can have.
    """
    if kind == "integrating":  # exactly: a first row (1 0 0), the rest stable and moved by it
        A = np.vstack(
            [[1, 0, 0], np.hstack([rng.normal(size=(2, 1)), 0.9 * _scaled(rng.normal(size=(2, 2)))])]
        ).round(4)
    else:
        A = ({"stable": 0.9, "unstable": 1.05}[kind] * _scaled(rng.normal(size=(3, 3)))).round(4)
    more = (
        {"uncertainties": [jb.Uncertainty("a", A=(0.003 * rng.normal(size=(3, 3))).round(5))]}
        if rng.random() < 0.5
        else {}
    )
    B, C, D, G = (rng.normal(size=s).round(2) for s in ((3, 1), (2, 3), (2, 1), (3, 2)))
    return jb.LinearSystem(
        A,
        B,
        C,
        D,
        noise=[0.1, 0.02],
        tolerance=[0, 0.02],
        disturbance=(G, [[-0.02, 0.05], [0, 0]]),
        offset={"u": 1.5, "y": [-20.25, 3]},
        **more,
    )


def first_decided_in_numpy(monkeypatch, kind, doubted=slice(0)):
    """Have NumPy take the place of XLA in the decisions of a kind of observers that are taken twice, and call
    samples FAULT there.
    """
    real = kind.found

    def found(self, carry, samples):
        if is_outside_xla():
            return real(self, carry, samples)
        with outside_xla():
            state, verdicts = real(self, carry, samples)
        status = np.array(verdicts.status)
        status[doubted] = jb.Status.FAULT
        return state, verdicts._replace(status=status)

    monkeypatch.setattr(kind, "found", found)


def _scaled(A):
    return A / abs(np.linalg.eigvals(A)).max()


def jumps_near_the_boundary(**how):
    """Return what an observer says of 24 recordings of PLANT whose sensor jumps by far less to far more than
    what can be proved, how many contradictions it proves of those of linear programs over all samples, and
    how wide it takes the states of the others to be.

    Every proof is one of a program, the states of the others are inside.
    """
    u, _, y = recorded(PLANT, 14, 3, N=24, at="uniform")
    y[:, 8:, 0] += np.linspace(0, 0.6, 24)[:, None]
    found = jb.observe(PLANT, u, y, restart=False, **how)
    proved = possible = 0
    wider = []
    for j in range(24):
        wrong = np.asarray(found.status[j] == jb.Status.FAULT)
        exact = program(PLANT, u[j], y[j])
        possible += exact is None
        if wrong.any():
            k = int(wrong.argmax())
            assert wrong[k:].all() and program(PLANT, u[j, : k + 1], y[j, : k + 1]) is None
            assert found.margin[j, k] < 0
            proved += 1
        elif exact is not None:
            lo, hi = exact
            assert (found.state.lo[j, -1] <= lo + 1e-9).all() and (hi - 1e-9 <= found.state.hi[j, -1]).all()
            wider.append((found.state.hi[j, -1] - found.state.lo[j, -1]) / (hi - lo))
    print(
        f"{proved} of {possible} contradictions proved; widths {np.mean(wider):.2f} of the exact ones, at "
        f"most {np.max(wider):.2f}"
    )
    return proved, possible, wider


def fault_free(rng, seeds, N, T, **how):
    """Return how many samples without a fault were observed, with gaps and missing samples: the state inside
    all, no FAULT.
    """
    samples = 0
    for seed in seeds:
        dtype, kind = (np.float64, np.float32)[seed % 2], ("stable", "integrating", "unstable")[seed % 3]
        model = systems(rng, kind)
        with jax.enable_x64(seed % 4 != 3):
            u, x, y = recorded(model, T, seed, N, ("vertices", "uniform")[seed // 2 % 2], dtype)
            y[rng.random(y.shape) < 0.03] = np.nan
            found = jb.observe(model, u, y, x0=jb.interval([-50.0] * 3, [50.0] * 3), starts=[T // 2], **how)
            assert inside(found, x, dtype).all() and not (found.status == jb.Status.FAULT).any()
            samples += y[..., 0].size
    print(f"{samples} fault-free samples: the state inside all, 0 FAULT")
    return samples

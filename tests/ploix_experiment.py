"""The experiment of golden with uncertain parameters: runs of 100 samples, a change of C at samples 10 to 39
and 60 to 89.
"""

import numpy as np
from uncertain_systems import model

FAULTY = np.r_[10:40, 60:90]


def inputs(rng, runs, samples=100):
    """Draw golden's inputs: uniform in [0, 2], held for 10 samples."""
    return np.repeat(rng.uniform(0, 2, (runs, -(-samples // 10), 1)), 10, 1)[:, :samples]


def record(rng, name, runs, at, samples=100, dC=None, **changes):
    """Return (u, y) of runs of a system, from rest; dC is added to C at golden's faulty samples; changes:
    noise and the like.
    """
    m, u = model(name, **changes), inputs(rng, runs, samples)
    numbers = lambda a: np.array([[float(x) for x in row] for row in a])
    draw = (lambda *s: rng.uniform(-1, 1, s)) if at == "uniform" else (lambda *s: rng.choice([-1.0, 1.0], s))
    tolerance, noise = (np.array([float(x) for x in bound]) for bound in (m.tolerance, m.noise))
    lo, hi = numbers(m.disturbance).T if m.g else np.zeros((2, 0))
    push = (
        ((lo + hi) / 2 + (hi - lo) / 2 * draw(runs, samples, m.g)) @ numbers(m.G).T
        if m.g
        else np.zeros((runs, samples, m.n))
    )
    values = [
        draw(runs, samples) if p.varying else np.repeat(draw(runs, 1), samples, 1) for p in m.uncertainties
    ]
    now = {}
    for letter in "ABC":
        parts = [
            (v, numbers(p.on(letter)))
            for v, p in zip(values, m.uncertainties, strict=True)
            if p.on(letter) is not None
        ]
        now[letter] = numbers(getattr(m, letter)) + sum(
            (v[..., None, None] * d for v, d in parts), np.zeros((runs, samples, 1, 1))
        )
    now["C"] = now["C"] + np.zeros((runs, samples, 1, 1))
    now["C"][:, FAULTY] += np.zeros(()) if dC is None else np.asarray(dC, float)
    x, y = np.zeros((runs, m.n, 1)), np.empty((runs, samples, m.p))
    for k in range(samples):
        y[:, k] = (now["C"][:, k] @ x)[..., 0]
        x = now["A"][:, k] @ x + now["B"][:, k] @ u[:, k, :, None] + push[:, k, :, None]
    return u, y * (1 + tolerance * draw(*y.shape)) + noise * draw(*y.shape)


def in_fault(s):
    """Return the ends of windows that lie wholly within golden's fault."""
    return np.r_[10 + s : 40, 60 + s : 90]

"""What windows with memory see on a recorded heater, beside exact linear programs over the same samples.

    python -m benchmarks.memory        some minutes; needs the recordings and golden/heater_memory.json in the
    shared folder

For process noise rho and a room that drifts, in shares of the sensors' bound b: b itself, 1.25 times the
smallest that explains training; the share of it that the unseen half of a recording needs; and for each
sensor the sizes of a jump that is seen within 30 samples, of a bias that was always there, and what a ramp of
0.05 degC a sample has reached when it is seen first. The definitions are those of the file.

Observers rest on everything since the start, with the bound of the ideal that does; nothing of theirs is
found by steps. "joint" tests windows exactly, its first state within what the samples before allow.

A method to compare is one function `need(rho, drift)` that returns `least(u, y)`: u (T, 2), y (..., T, 2) to
(..., T), the smallest b with which the method would not call sample k a FAULT, NaN where it says nothing. One
that only gives verdicts is made so by `by_steps`.

Windows here know nothing of the room where it drifts; the ideal takes it to begin within 3 degC, which is why
it may see a little more, and why its unseen half needs wider bounds.
"""

import json
import math
import os
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

import jaxbound as jb

SHARED = Path(os.environ.get("JAXBOUND_SHARED", Path(__file__).resolve().parents[2] / "shared"))
SETTINGS = (0, 0), (0.05, 0.02), (0.1, 0.02), (0.3, 0)
SIZES = np.array([0.3, 0.5, 0.75, 1, 1.5, 2, 3, 4, 6, 9, 14])
LAGS = (0, 1, 2, 3, 4, 6, 8, 11, 14, 18, 23, 29, 36, 43, 51, 60)

OBSERVERS = {
    "strips, order 60": {"method": "strips", "order": 60},
    "zonotopes, order 20": {},
    "zonotopes, order 60": {"order": 60},
    "joint, 16 samples": {"method": "joint", "window": 16},
    "joint, 32 samples": {"method": "joint", "window": 32},
}

Least = Callable[[np.ndarray, np.ndarray], np.ndarray]


def recordings() -> tuple:
    """Return (golden file, (u, y) of the excitation, of the seen and of the unseen half of the other
    recording).
    """
    golden = json.loads((SHARED / "golden/heater_memory.json").read_text())
    read = lambda name: np.genfromtxt(SHARED / "data/tclab" / name, delimiter=",", skip_header=1)
    prbs, hybrid = read("mimo_prbs_3s.csv"), read("mimo_hybrid_3s.csv")
    half = golden["split"]
    return golden, *((a[:, 1:3], a[:, 3:5]) for a in (prbs, hybrid[:half], hybrid[half:]))


def heater(golden: dict, rho: float, drift: float, bound: float = 1.0) -> jb.LinearSystem:
    """Return the heater: sensors known to `bound`, process noise rho times it, a room that moves by drift
    times it a sample.
    """
    text = lambda rows: [[str(x) for x in row] for row in rows]
    A, B, C, G = (text(golden[letter]) for letter in "ABCG")
    walks = [rho * bound] * 2 if rho else []
    if drift:
        A, B = [[*row, 0] for row in A] + [[0, 0, 0, 0, 1]], [*B, [0, 0]]
        C, G = [[*row, 1] for row in C], [[*row, 0] for row in G] + [[0, 0, 1]]
        G, walks = (G, [*walks, drift * bound]) if rho else ([row[2:] for row in G], [drift * bound])
    more = {"disturbance": (G, walks)} if walks else {}
    return jb.LinearSystem(
        A, B, C, dt=3, noise=bound, offset={"y": str(golden["room"])}, outputs=["T1", "T2"], **more
    )


def windows(golden: dict, **window: object) -> Callable[[float, float], Least]:
    """Return the method of windows, of a horizon or of lags: margins scale with the bounds."""

    def need(rho, drift):
        relations = jb.parity_relations(heater(golden, rho, drift), **window)
        return lambda u, y: 1 - jb.detect(relations, np.broadcast_to(u, y.shape), y).margin

    return need


def by_steps(
    faults: Callable[[float, np.ndarray, np.ndarray], np.ndarray], top: float = 30.0, ratio: float = 0.97
) -> Least:
    """Return `least` of a method that says FAULT or not, (..., T) bool, at a bound: the smallest of bounds in
    steps of 3 % without one.
    """

    def least(u, y):
        found, bound = np.full(y.shape[:-1], np.inf), top
        while bound > 0.05:
            found, bound = np.where(faults(bound, u, y), found, bound), bound * ratio
        return found

    return least


def row(least: Least, runs: tuple, samples: int) -> dict:
    """Return what a method with a memory of so many samples sees, as a row of the golden table."""
    prbs, first, second = runs
    most = lambda run: float(np.nanmax(least(*run)[_ends(samples, len(run[1]))]))
    bound = 1.25 * max(most(prbs), most(first))
    beyond = lambda u, y: least(u, y) > bound
    return {"bound": bound, "unseen": most(second) / bound} | sizes(beyond, prbs, samples)


def sizes(beyond: Callable[[np.ndarray, np.ndarray], np.ndarray], run: tuple, samples: int) -> dict:
    """Return what is seen of faults in both sensors, by `beyond(u, y)`: (..., T) bool, True where sample k is
    a FAULT.
    """
    u, y = run
    k, out = np.arange(len(y)), {}
    smallest = lambda seen: next((float(z) for z, hit in zip(SIZES, seen, strict=True) if hit), None)
    for i, name in enumerate(("T1", "T2")):
        wrong = SIZES[:, None, None] * np.eye(2)[i]
        jump = beyond(u[:141], y[None, :141] + wrong * (k[:141, None] >= 110))[:, _ends(samples, 141, 110)]
        always = beyond(u, y[None] + wrong)[:, _ends(samples, len(y))]
        at = np.arange(115, len(y), 7)
        ramp = beyond(u, y + 0.05 * np.maximum(0, k - 109)[:, None] * np.eye(2)[i])[at]
        out[name] = {
            "jump": smallest(jump.any(1)),
            "always": smallest(always.any(1)),
            "ramp": round(0.05 * float(at[ramp][0] - 109), 2) if ramp.any() else None,
        }
    return out


def _ends(samples, T, first=0):
    return np.arange(max(first, samples - 1), T, 6)


def observed(
    golden: dict, rho: float, drift: float, bound: float, **options: object
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return `beyond` of a set observer: everything since the start, the first state known to 200 degC, the
    room to 3.
    """
    model = heater(golden, rho, drift, round(bound, 4))
    room = [3.0] * (model.n - 4)
    x0 = jb.interval([-100.0] * 4 + [-r for r in room], [300.0] * 4 + room)
    watch = jb.observer(model, restart=False, x0=x0, **options)
    return lambda u, y: jb.detect(watch, np.broadcast_to(u, y.shape), y).status == jb.Status.FAULT


def text(label: str, found: dict, ideal: dict | None = None) -> str:
    """Return a line of the table; sizes over those of the ideal where both are known."""
    shown = lambda x: "-" if x is None else f"{x:g}"
    sizes = "  ".join(
        " / ".join(shown(found[name][what]) for what in ("jump", "always", "ramp")) for name in ("T1", "T2")
    )
    ratio = ""
    if ideal:
        pairs = [
            (found[name][what], ideal[name][what])
            for name in ("T1", "T2")
            for what in ("jump", "always", "ramp")
        ]
        ratio = (
            f"  worst ratio "
            f"{max((math.inf if a is None else a / b for a, b in pairs if b is not None), default=1):.2f}"
        )
    unseen = f"unseen {found['unseen']:.2f}" if "unseen" in found else " " * 11
    return f"{label:<28} b {found['bound']:.3f}  {unseen}  {sizes}{ratio}"


def main() -> None:
    """Print the table."""
    jax.config.update("jax_enable_x64", True)
    golden, *runs = recordings()
    methods = {
        "61 samples": (windows(golden, horizon=60), 61),
        "16 of 61 samples": (windows(golden, lags=LAGS), 61),
    }
    print("sizes in degC: T1 jump / always / ramp, then T2; - is never seen")
    for rho, drift in SETTINGS:
        print(f"\nprocess noise {rho} b, drift {drift} b")
        ideal = {r["memory"]: r for r in golden["rows"] if (r["rho"], r["drift"]) == (rho, drift)}
        for memory in ("past", 61, 16):
            print(text(f"ideal, {memory}", ideal[memory]))
        for name, (need, samples) in methods.items():
            least = need(rho, drift)
            least(*runs[0])  # compiled
            start = time.process_time()
            least(*runs[0])
            spent = (time.process_time() - start) / (len(runs[0][1]) - samples + 1)
            print(
                f"{text(name, row(least, tuple(runs), samples), ideal[61])}  {1e6 * spent:.0f} us a window",
                flush=True,
            )
        bound = ideal["past"]["bound"]
        for name, options in OBSERVERS.items():
            beyond = observed(golden, rho, drift, bound, **options)
            false = int(beyond(*runs[0]).sum())
            start = time.process_time()
            beyond(*runs[0])
            spent = (time.process_time() - start) / len(runs[0][1])
            found = {"bound": bound} | sizes(beyond, runs[0], 1)
            print(
                f"{text(name, found, ideal['past'])}  {1e6 * spent:.0f} us a sample, {false} false alarms",
                flush=True,
            )


if __name__ == "__main__":
    main()

"""Recordings to try the commands on, simulated, so that what is true of them is known.

heater  a laboratory of two heaters and two sensors, like the small ones that teach control: three healthy
        recordings and one in which a sensor jumps; truth.toml is the model that made them, with the bounds
        within which everything was drawn
tank    the model file that `jaxbound info --template` prints, and a recording in which its level sensor reads
        too much for a minute
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

from jaxbound.models.faults import Fault
from jaxbound.models.modelfile import load_model, save_model
from jaxbound.models.simulate import simulate
from jaxbound.models.system import LinearSystem
from jaxbound.models.template import template

JUMP, ONSET = 0.8, 60  # degC added to T1, from which sample of jump.csv on


def heater_model() -> LinearSystem:
    """Return the laboratory: heaters H1 and H2 in %, their temperatures as states, sensors T1 and T2 that
    follow with a lag of 20 s.

    Example:
        >>> heater_model()
        LinearSystem('two heaters': 4 states, inputs ['Q1', 'Q2'], outputs ['T1', 'T2'], dt=3 s)
    """
    return LinearSystem(
        [[0.976, 0.006, 0, 0], [0.006, 0.976, 0, 0], [0.14, 0, 0.86, 0], [0, 0.14, 0, 0.86]],
        [[0.016, 0.0], [0.0, 0.009], [0.0, 0.0], [0.0, 0.0]],
        [[0, 0, 1, 0], [0, 0, 0, 1]],
        dt=3,
        noise=0.1,
        resolution=0.005,
        disturbance=([[1, 0], [0, 1], [0, 0], [0, 0]], 0.01),
        inputs=["Q1", "Q2"],
        outputs=["T1", "T2"],
        states=["H1", "H2", "S1", "S2"],
        units={"Q1": "%", "Q2": "%", "T1": "degC", "T2": "degC"},
        offset={"y": 21},
        columns={
            "Q1": "Heater 1",
            "Q2": "Heater 2",
            "T1": "Temperature 1",
            "T2": "Temperature 2",
            "time": "Time (s)",
        },
        name="two heaters",
        provenance={name: "simulated: true" for name in ("model", "noise", "resolution", "disturbance")},
    )


def _write_heater(folder: Path) -> None:
    """Write three healthy recordings of ten minutes, the third once more with a jump, and the true model."""
    model = heater_model()
    save_model(model, folder / "truth.toml")
    for number in (1, 2, 3):
        levels = (
            np.random.default_rng(number).integers(0, 17, (20, 2)) * 5.0
        )  # each heater gets a new level every 30 to 90 s
        lasts = np.random.default_rng(10 + number).integers(10, 31, (20, 2))
        u = np.stack([np.repeat(levels[:, i], lasts[:, i])[:201] for i in (0, 1)], 1)
        for name, faults in (("jump.csv", [Fault("T1", "bias", JUMP, ONSET)]), (f"healthy_{number}.csv", [])):
            if number == 3 or not faults:
                y = simulate(model, u, jax.random.key(number), faults=faults).y
                _write_recording(folder / name, model, u, np.asarray(y))
    rows = ["unit,model,recording", "lab 1,plant.toml,healthy_3.csv", "lab 2,plant.toml,jump.csv"]
    (folder / "units.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")


def _write_tank(folder: Path) -> None:
    """Write the template of a model file and a recording to it in which the level reads too much for a
    minute.
    """
    (folder / "tank.toml").write_text(template(), encoding="utf-8")
    model = load_model(folder / "tank.toml")
    u = 50 + np.repeat(np.random.default_rng(1).integers(0, 6, (15, 1)) / 2, 20, 0)
    run = simulate(model, u, jax.random.key(1), faults=[Fault("level", "bias", 0.5, 200, 260)])
    _write_recording(folder / "tank.csv", model, u, np.asarray(run.y))


@dataclass(frozen=True)
class Example:
    """An example: recordings whose truth is known.

    Fields:
        about: it in words. files: {file: its contents in words}. first: the command to try first.
        write: writes the files into a folder.
    """

    about: str
    files: dict[str, str]
    first: str
    write: Callable[[Path], None]


EXAMPLES = {
    "heater": Example(
        "a laboratory with two heaters: three healthy recordings, one with a fault",
        {
            "healthy_1.csv": "10 minutes at 3 s: heaters Q1, Q2 in %, temperatures T1, T2 in degC",
            "healthy_2.csv": "the same on another day",
            "healthy_3.csv": "and another one, kept for the test",
            "jump.csv": f"healthy_3.csv with {JUMP:g} degC added to T1 from row {ONSET} ({3 * ONSET} s) on",
            "units.csv": "two units for jaxbound fleet, with the model that jaxbound fit is to write",
            "truth.toml": "the model that made them, with the bounds within which everything was drawn",
        },
        'jaxbound fit healthy_1.csv healthy_2.csv --inputs "Q1=Heater 1,Q2=Heater 2" '
        '--outputs "T1=Temperature 1,T2=Temperature 2" --out plant.toml',
        _write_heater,
    ),
    "tank": Example(
        "a model file to fill in, with a recording to it",
        {
            "tank.toml": "the commented model file of jaxbound info --template",
            "tank.csv": "5 minutes at 1 s; the level sensor reads 0.5 m too much from 200 s to 260 s: "
            "windows of 16 samples show all of it",
        },
        "jaxbound detect tank.toml tank.csv --test horizon=15 --out report/",
        _write_tank,
    ),
}
"""The examples by their names."""


def _write_recording(path: Path, model: LinearSystem, u: np.ndarray, y: np.ndarray) -> None:
    """Write a recording as CSV, time first; an output is rounded by no more than its resolution, without one
    it stands in full.
    """
    names = [model.columns.get("time", "Time (s)")]
    names += [model.column(name) for name in (*model.inputs, *model.outputs)]
    lines = [",".join(names)]
    for k in range(len(y)):
        cells = [f"{k * model.dt:g}", *(f"{x:g}" for x in u[k])]
        for x, resolution in zip(y[k], model.resolution, strict=True):
            cells.append(_output_text(float(x), float(resolution)))
        lines.append(",".join(cells))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _output_text(x: float, resolution: float) -> str:
    if not resolution:
        return repr(x)
    places = -math.floor(math.log10(2 * resolution))
    return f"{x:.{places}f}"

"""Recordings that no model can be fitted to, or that say little: one sentence each, from the shell and from
Python, with exit code 2 where nothing can be done.
"""

import re

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main

COUNT = 400


def day(seed, count=COUNT, freq="min", begin="2024-03-01"):
    """Return a healthy recording of a plant with one input."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.integers(0, 4, count // 10 + 1), 10)[:count].astype(float)
    x = np.zeros(count)
    for k in range(1, count):
        x[k] = 0.8 * x[k - 1] + u[k - 1]
    time = pd.date_range(begin, periods=count, freq=freq)
    return pd.DataFrame({"time": time, "u": u, "y": (x + rng.uniform(-0.05, 0.05, count)).round(3)})


A, B = day(1), day(2, begin="2024-03-02")
FAHRENHEIT = B.assign(y=B["y"] * 1.8 + 32)
IRREGULAR = A.assign(time=A["time"][0] + pd.to_timedelta(np.cumsum(np.arange(COUNT) % 2 + 1), "s"))

# case: (recordings, output, sentence of the shell, sentence of Python)
REFUSED = {
    "no excitation": (
        [A.assign(u=3.0), B.assign(u=3.0)],
        "y",
        r"no input moves in these recordings \(u\)",
        ...,
    ),
    "constant output": (
        [A.assign(y=20.0)],
        "y",
        "y stands still in all recordings: nothing can be learnt",
        ...,
    ),
    "one row": ([A[:1]], "y", "a.csv: the file has one row of data", "too few samples: 1,"),
    "shorter than the order": (
        [A[:2]],
        "y",
        "too few samples: 2, in 1 recording, hold 0 complete windows",
        ...,
    ),
    "shorter than the horizon": (
        [A[:12]],
        "y",
        "too few samples: 12, in 1 recording, hold 0 complete wind",
        ...,
    ),
    "two units in names": (
        [A.rename(columns={"y": "T [degC]"}), FAHRENHEIT.rename(columns={"y": "T [degF]"})],
        "T [degC]",
        r"b.csv: the recording has column 'T \[degF\]', in another unit: convert it, .* place of 'T \[degC",
        r"recording 2: \w+ has column 'T \[degF\]', in another unit: convert it, as one signal has one unit",
    ),
    "a name without its unit": (
        [A.rename(columns={"y": "T [degC]"})],
        "T",
        r"has column 'T \[degC\]', with a unit in its name: give .* in the place of 'T'",
        ...,
    ),
    "two sampling periods": (
        [A, day(3, freq="5min")],
        "y",
        r"b.csv has a sample every 300 s, .*a.csv every 60 s, .*: fit a model to each, .*--every 5min",
        "recording 2 has a sample every 300 s, recording 1 every 60 s.*: fit a .*every = '5min'",
    ),
    "steps that vary": ([IRREGULAR], "y", 'steps vary from 1 s to 2 s: .*every = "2s"', ...),
    "nothing but words": (
        [A.assign(y="Bad")],
        "y",
        "holds 'Bad', which is not a number: leave a missing",
        ...,
    ),
}
SAID = {
    "ranges with nothing in common": (
        [A, FAHRENHEIT.assign(y=FAHRENHEIT["y"] + 20)],
        "y lies at .* in recording 1 and at .* in recording 2, which have nothing in common: is it in",
    ),
    "one day": (
        [A],
        "there is one recording, and its 3 blocks of",
    ),
    "one input of two at rest": ([A.assign(v=1.0)], "v never moves in these recordings"),
}


def shell(path, frames, output, inputs="u", *options):
    """Return the exit code of a fit to these recordings."""
    files = []
    for name, frame in zip("ab", frames, strict=False):
        frame.to_csv(path / f"{name}.csv", index=False)
        files.append(str(path / f"{name}.csv"))
    ways = ["--inputs", inputs, "--outputs", output, "--out", str(path / "m.toml")]
    return main.main(["fit", *files, *ways, *options])


@pytest.mark.parametrize("case", REFUSED)
def test_the_shell_refuses_in_one_sentence(tmp_path, capsys, case):
    frames, output, sentence, _ = REFUSED[case]
    assert shell(tmp_path, frames, output) == 2
    out, err = capsys.readouterr()
    assert re.search(sentence, err), err
    assert not out and err.count("\n") == 1 and not (tmp_path / "m.toml").exists()


@pytest.mark.parametrize("case", REFUSED)
def test_python_refuses_in_one_sentence(case):
    frames, output, of_shell, sentence = REFUSED[case]
    with pytest.raises(ValueError, match=of_shell if sentence is ... else sentence) as e:
        jb.fit(frames, inputs="u", outputs=output)
    assert "\n" not in str(e.value)


@pytest.mark.parametrize("case", SAID)
def test_what_little_a_fit_means_is_said(tmp_path, capsys, monkeypatch, case):
    monkeypatch.setattr("jaxbound.diagnosis.memory.LONGEST", 64)  # advice about long windows takes seconds
    frames, sentence = SAID[case]
    inputs = [name for name in ("u", "v") if name in frames[0]]
    model = jb.fit(frames, inputs=inputs, outputs="y", horizon=4, method="least squares")
    assert re.search(sentence, " ".join(model.check.sentences))
    assert shell(tmp_path, frames, "y", ",".join(inputs), "--recipe", "horizon=4,method=least squares") == 0
    out, err = capsys.readouterr()
    assert re.search(sentence, re.sub(r"\s+", " ", out)) and not err

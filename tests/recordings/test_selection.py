"""Signals and conditions computed while a recording is read: the same from CSV, from Parquet and in
chunks.
"""

import json

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from streaming_case import shrink, verdicts
from systems import paper

import jaxbound as jb
from jaxbound.cli import evaluation, main
from jaxbound.models.modelfile import load_model, model_text, save_model
from jaxbound.recordings.parquet import open_parquet
from jaxbound.recordings.read import read, read_signals
from jaxbound.recordings.selection import wanted
from jaxbound.recordings.signals import Signals
from jaxbound.runs.streaming import Asked, write_parts

COLUMNS = {
    "u1": "= `in [V]` * 2",
    "y1": "= hot - cold",
    "y2": "level ",
    "where": "fan > 0 and mode == 'auto'",
}


TYPES = {"mode": pa.string(), "spare": pa.string()}


def model(**bounds):
    return paper(name="paper", columns=COLUMNS, **bounds)


def table(n=400, rng=None, step=0.01):
    """Return columns of the paper's plant without a fault, the condition false in stretches of 1 to 9
    samples, and what is kept.
    """
    rng = rng or np.random.default_rng(1)
    u = np.repeat(rng.uniform(-1, 1, (n // 20 + 1, 1)), 20, 0)[:n]
    x, y = np.zeros(2), np.zeros((n, 2))
    for k in range(n):
        y[k] = x[0], x[0] + x[1]
        x = np.array([0.8 * x[0] + x[1], 0.2 * x[1] + u[k, 0]])
    y *= 1 + rng.uniform(-0.01, 0.01, (n, 2))  # half of what the sensors may do
    cold = np.round(rng.normal(size=n), 1)
    fan, mode = np.ones(n), np.full(n, "auto", object)
    for k in rng.integers(0, n, 12):
        fan[k : k + rng.integers(1, 10)] = rng.choice([0.0, np.nan])
    mode[rng.integers(0, n, 5)] = "hand"
    mode[rng.integers(0, n, 2)] = None
    kept = (np.nan_to_num(fan) > 0) & (mode == "auto")
    y[~kept] += rng.normal(size=(n, 2))[~kept] * 100  # what the plant does there is nobody's business
    columns = {
        "t": step * np.arange(n),
        "in [V]": u[:, 0] / 2,
        "hot": y[:, 0] + cold,
        "cold": cold,
        "level": y[:, 1],
        "fan": fan,
        "mode": mode,
        "spare": ["x"] * n,
    }
    return columns, kept


def csv(path, columns):
    cell = lambda x: "" if x is None or x != x else str(x)
    lines = [
        " , ".join(columns),
        *(
            ",".join(map(cell, row))
            for row in zip(*(np.asarray(c, object) for c in columns.values()), strict=True)
        ),
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def parquet(path, columns, cuts=(150, 151, 300)):
    path.mkdir()
    for i, (a, b) in enumerate(zip((0, *cuts), (*cuts, len(columns["t"])), strict=True)):
        pq.write_table(
            pa.table(
                {
                    k: pa.array(list(x[a:b]), TYPES.get(k, pa.float64()), from_pandas=True)
                    for k, x in columns.items()
                }
            ),
            path / f"{i}.parquet",
        )
    return path


def expected(relations, r, kept):
    """Return the verdicts that the stretches in which the condition holds get as recordings of their own."""
    status = np.full(len(kept), jb.Status.MISSING, np.int8)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], kept, [0]])))
    for a, b in edges.reshape(-1, 2):
        if b - a > relations.horizon:
            status[a:b] = jb.detect(relations, r.u[a:b], r.y[a:b]).status
    return status


class TestReading:
    def test_the_same_from_csv_and_from_parquet(self, tmp_path, rng):
        columns, kept = table(rng=rng)
        a = read(csv(tmp_path / "a.csv", columns), model())
        b = read(parquet(tmp_path / "b", columns), model())
        for r in (a, b):
            np.testing.assert_array_equal(r.y[kept, 0], (columns["hot"] - columns["cold"])[kept])
            np.testing.assert_array_equal(r.u[kept, 0], columns["in [V]"][kept] * 2)
            np.testing.assert_array_equal(r.excluded, ~kept)
            assert np.isnan(r.y[~kept]).all() and np.isnan(r.u[~kept]).all()
        assert a.hints == b.hints and list(a.starts) == list(b.starts) and a.dt == b.dt == 0.01
        assert a.hints[-1].startswith(
            f"{(~kept).sum()} of 400 samples are set aside by the condition \"fan > 0 and mode == 'auto'\""
        )
        assert not any("missing:" in hint for hint in a.hints)  # they are not missing: they do not count

    @pytest.mark.parametrize("horizon", [1, 3])
    def test_windows_touch_no_sample_that_is_set_aside(self, tmp_path, rng, horizon):
        columns, kept = table(rng=rng)
        r = read(csv(tmp_path / "a.csv", columns), model())
        relations = jb.parity_relations(model(), horizon)
        for method in ("joint", "box"):
            res = jb.detect(relations, r.u, r.y, method=method, starts=r.starts)
            touches = np.array([not kept[max(k - horizon, 0) : k + 1].all() for k in range(len(kept))])
            assert (res.status[touches] == jb.Status.MISSING).all() and (res.status != jb.Status.FAULT).all()
            if method == "joint":
                np.testing.assert_array_equal(res.status, expected(relations, r, kept))
        assert r.aside(horizon) == touches[horizon:].sum()

    def test_only_what_is_needed_is_parsed(self, tmp_path):
        columns, _ = table(30)
        r = read(csv(tmp_path / "a.csv", columns | {"spare": ["not a number"] * 30}), model())
        assert len(r.time) == 30
        plan = wanted(list(columns), model())
        assert (
            plan.columns == ["in [V]", "hot", "cold", "level", "fan", "mode", "t"]
            and plan.texts == ["mode"]
            and plan.time == "t"
        )

    def test_a_signal_of_its_own_name_serves_if_the_columns_are_absent(self, tmp_path):
        path = tmp_path / "a.csv"
        path.write_text("t,u1,y1,level,fan,mode\n0,1,2,3,1,auto\n0.01,1,2,3,1,auto\n")
        assert read(path, model()).y[0, 0] == 2

    @pytest.mark.parametrize(
        "change, sentence",
        [
            ({"y1": "= hot - tepid"}, "for 'hot - tepid', has no column 'tepid': it has 't', 'in"),
            ({"where": "fan > 'x'"}, "text has no order"),
            ({"where": "mode > 1"}, "column 'mode' holds 'auto', which is not a number"),
            ({"where": "t > '2020-01-01'"}, "column 't' holds numbers"),
        ],
    )
    def test_a_sentence_for_what_is_wrong(self, tmp_path, change, sentence):
        path = csv(tmp_path / "a.csv", table(30)[0])
        with pytest.raises(ValueError, match=sentence) as e:
            read(path, paper(columns=COLUMNS | change))
        assert str(path) in str(e.value)

    def test_dates_in_the_condition(self, tmp_path):
        path = tmp_path / "a.csv"
        path.write_text(
            "Datetime,y1\n" + "".join(f"9/{19 + k // 2}/2017 {12 * (k % 2)}:00,{k}\n" for k in range(6))
        )
        m = jb.LinearSystem(
            [[0.5]],
            None,
            [[1]],
            dt=43200,
            noise=1,
            columns={"where": "'2017-09-20' <= Datetime < '2017-09-21'"},
        )
        np.testing.assert_array_equal(read(path, m).excluded, [True, True, False, False, True, True])

    def test_float32_columns_are_computed_in_float64_and_count_as_float32(self, tmp_path, rng):
        a, b = rng.normal(size=(2, 50)).astype(np.float32)
        pq.write_table(pa.table({"t": np.arange(50.0), "a": a, "b": b}), tmp_path / "r.parquet")
        m = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1, columns={"y1": "= a - b"})
        r = read(tmp_path / "r.parquet", m)
        assert r.y.dtype == np.float32
        np.testing.assert_array_equal(r.y[:, 0], (a.astype(float) - b.astype(float)).astype(np.float32))


class TestChunks:
    def test_verdicts_and_what_is_counted_do_not_depend_on_the_chunk(self, tmp_path, rng, monkeypatch):
        shrink(monkeypatch)
        columns, _ = table(3000, rng)
        m = model()
        r = read(parquet(tmp_path / "run", columns, (700, 701, 2000)), m)
        relations = jb.parity_relations(m, 2)
        whole = jb.detect(relations, r.u, r.y, starts=r.starts)
        found = jb.detect_dataset(relations, tmp_path / "run", tmp_path / "out", chunk=500)
        status, margin = verdicts(tmp_path / "out")
        np.testing.assert_array_equal(status, whole.status)
        np.testing.assert_array_equal(margin, whole.margin)
        assert found.aside == r.aside(2) and found.hints == r.hints and found.counts == whole.counts
        k = int(np.flatnonzero(whole.status == jb.Status.CONSISTENT)[-1])
        assert found.explain(k).status == jb.Status.CONSISTENT

    def test_on_after_an_interruption(self, tmp_path, rng, monkeypatch):
        shrink(monkeypatch)
        columns, _ = table(3000, rng)
        relations = jb.parity_relations(model())
        source = open_parquet(parquet(tmp_path / "run", columns), model())

        def stop(share):
            if share > 0.6:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            write_parts(Asked(relations, chunk=500), source, tmp_path / "out", progress=stop)
        found = jb.detect_dataset(relations, tmp_path / "run", tmp_path / "out")
        r = read(tmp_path / "run", model())
        assert found.aside == r.aside(1) and found.hints == r.hints
        np.testing.assert_array_equal(
            verdicts(tmp_path / "out")[0], jb.detect(relations, r.u, r.y, starts=r.starts).status
        )


class TestFiles:
    def test_a_model_file_keeps_expressions_and_the_condition(self, tmp_path):
        save_model(model(), tmp_path / "m.toml")
        again = load_model(tmp_path / "m.toml")
        assert again.columns == COLUMNS and model_text(again) == model_text(model())
        assert "where = \"fan > 0 and mode == 'auto'\"" in model_text(again)

    @pytest.mark.parametrize("kind", ["csv", "parquet"])
    def test_what_is_set_aside_is_no_evidence_and_no_lack_of_it(
        self, tmp_path, rng, kind, capsys, monkeypatch
    ):
        monkeypatch.setattr(main, "_configure", lambda: None)
        monkeypatch.setattr(evaluation, "write_report", lambda *args, **options: None)
        columns, _ = table(rng=rng)
        columns["fan"][50:350] = 0
        save_model(model(), tmp_path / "m.toml")
        data = csv(tmp_path / "a.csv", columns) if kind == "csv" else parquet(tmp_path / "a", columns)
        code = main.main(
            [
                "detect",
                str(tmp_path / "m.toml"),
                str(data),
                "--out",
                str(tmp_path / "out"),
                "--min-coverage",
                "1",
                "--json",
            ]
        )
        found = json.loads(capsys.readouterr().out)
        assert code == 0 and found["decided"] == 1 and found["counts"]["MISSING"] > 300
        assert found["summary"].startswith(
            f"No fault found: the model explains all {found['counts']['CONSISTENT']} windows"
        )

    def test_nothing_left(self, tmp_path, capsys, monkeypatch):
        monkeypatch.setattr(main, "_configure", lambda: None)
        monkeypatch.setattr(evaluation, "write_report", lambda *args, **options: None)
        columns, _ = table(40)
        save_model(model(), tmp_path / "m.toml")
        data = csv(tmp_path / "a.csv", columns | {"fan": np.zeros(40)})
        assert main.main(["detect", str(tmp_path / "m.toml"), str(data), "--out", str(tmp_path / "out")]) == 3
        assert "Too little evidence: only 0 of 0 windows" in capsys.readouterr().out
        assert (
            main.main(
                [
                    "detect",
                    str(tmp_path / "m.toml"),
                    str(data),
                    "--out",
                    str(tmp_path / "out"),
                    "--method",
                    "validation",
                ]
            )
            == 2
        )
        assert "no stretch of 2 complete samples in a row" in capsys.readouterr().err


class TestSignals:
    def test_signals_without_a_model(self, tmp_path, rng):
        columns, kept = table(rng=rng)
        paths = [csv(tmp_path / "a.csv", columns), parquet(tmp_path / "b", columns)]
        found = read_signals(
            paths, [("u1", "= `in [V]` * 2")], [("y1", "= hot - cold"), "level"], {"where": COLUMNS["where"]}
        )
        r = read(paths[0], model())
        for f in found:
            np.testing.assert_array_equal(f.y, r.y)
            np.testing.assert_array_equal(f.u, r.u)
            assert (
                list(f.starts) == list(r.starts)
                and f.dt == 0.01
                and f.hints[0] == "dt = 0.01 s, the median step of the time"
            )
        one = read_signals(str(paths[0]), [], ["level"], dt=0.01)
        assert len(one) == 1 and one[0].excluded is None and one[0].u.shape == (400, 0)

    def test_jitter_of_the_clock_is_not_in_dt(self, shared):
        (r,) = read_signals(
            shared("data/tclab/mimo_energy_1s.csv"), ["Heater 1 (%)"], ["Temperature 1 (degC)"]
        )
        assert r.dt == 1

    def test_recordings_of_different_periods(self, tmp_path):
        slow, quick = tmp_path / "slow.csv", tmp_path / "quick.csv"
        slow.write_text("t,y1\n" + "".join(f"{3 * k},{k % 3}\n" for k in range(20)))
        quick.write_text("t,y1\n" + "".join(f"{k},{k % 3}\n" for k in range(20)))
        with pytest.raises(
            ValueError, match="slow.csv has a sample every 3 s, .*quick.csv every 1 s, and a model has one"
        ) as e:
            read_signals([quick, slow], [], ["y1"])
        assert (
            f"keep one of every 3 rows of {quick} first, or let the samples of all be means (--every 3s)"
            in str(e.value)
        )
        with pytest.raises(
            ValueError,
            match="you gave dt = 3 s, but the rows of the recording are 1 s apart: keep one of every 3 rows",
        ):
            read_signals([slow, quick], [], ["y1"], dt=3)

    @pytest.mark.parametrize(
        "text, options, sentence",
        [
            (
                "a,b\n1,2\n3,4\n",
                {},
                "no column is called like time or holds time stamps: name it, .* or, if no row is missing, "
                "give dt",
            ),
            (
                "t,a,b\n0,1,2\n1,3,4\n",
                {"columns": {"where": "b > 5"}},
                "the condition 'b > 5' holds for none of its 2 samples",
            ),
            ("t,a,b\n0,1,2\n0,3,4\n", {}, "more than half of the rows repeat the time"),
            ("t,a,b\n1,1,2\n0,3,4\n", {}, "the rows run backwards in time"),
            (
                "0,1,2\n1,3,4\n",
                {},
                "first row must hold the names of the columns: it holds numbers .*Put a line above it, such "
                "as: time, a, b",
            ),
        ],
    )
    def test_a_sentence_for_what_is_wrong(self, tmp_path, text, options, sentence):
        (tmp_path / "a.csv").write_text(text)
        with pytest.raises(ValueError, match=sentence):
            read_signals([tmp_path / "a.csv"], [], ["a"], **options)

    def test_dates_without_a_model_to_say_how_far_apart(self, tmp_path):
        (tmp_path / "a.csv").write_text(
            "Datetime,a\n" + "".join(f"9/12/2017 {k // 60}:{k % 60:02d},{k}\n" for k in range(100))
        )
        (r,) = read_signals(tmp_path / "a.csv", [], ["a"])
        assert r.dt == 60 and r.stamps[61] == np.datetime64("2017-09-12T01:01")
        (tmp_path / "b.csv").write_text(
            "timestamp,a\n" + "".join(f"{1_505_174_400_000 + 500 * k},{k}\n" for k in range(9))
        )
        assert read_signals(tmp_path / "b.csv", [], ["a"])[0].dt == 0.5

    def test_nothing_given(self):
        for args, sentence in ((([], [], ["a"]), "no recording"), ((["x.csv"], ["a"], []), "no output")):
            with pytest.raises(ValueError, match=sentence):
                read_signals(*args)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_signal_may_be_a_condition_on_text(tmp_path, suffix):
    path = tmp_path / f"run.{suffix}"
    columns = {"mode": ["heat", "cool", None, "heat"], "level": [1.0, 2.0, 3.0, 4.0]}
    if suffix == "csv":
        rows = zip(*columns.values(), strict=True)
        path.write_text("mode,level\n" + "".join(f"{mode or ''},{level}\n" for mode, level in rows))
    else:
        pq.write_table(pa.table(columns), path)
    (run,) = read_signals(path, [("heating", "= mode == 'heat'")], ["level"], dt=1.0)
    np.testing.assert_array_equal(run.u[:, 0], [1, 0, np.nan, 1])


def test_an_expression_over_a_column_that_is_called_like_its_signal_is_that_of_the_file(tmp_path):
    import pandas as pd

    table = pd.DataFrame({"time": [0.0, 1.0, 2.0], "y1": [1.0, 2.0, 4.0]})
    table.to_csv(tmp_path / "run.csv", index=False)
    model = jb.LinearSystem([[0.5]], None, [[1]], dt=1, noise=0.1, columns={"y1": "= y1 - 273"})
    for given in (table, tmp_path / "run.csv"):
        run = jb.Recording.of(model, given) if given is table else jb.read(given, model)
        assert run.y.ravel().tolist() == [-272, -271, -269]


def test_two_columns_called_like_time_are_named(tmp_path):
    table = pd.DataFrame({"time": np.arange(5.0), "Time": 2 * np.arange(5.0), "y": np.zeros(5)})
    table.to_csv(path := tmp_path / "run.csv", index=False)
    (hint,) = [hint for hint in jb.read(path, Signals((), ("y",), {}, 1)).hints if "called alike" in hint]
    assert hint.startswith("the time is column 'time', not 'Time', called alike: say which")
    named = jb.read(path, Signals((), ("y",), {"time": "Time"}, 2))
    assert named.dt == 2 and not any("called alike" in hint for hint in named.hints)

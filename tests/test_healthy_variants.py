"""A healthy recording is never called faulty and loses no row, however it is written and whoever reads it;
what cannot be read is said.
"""

import json
import shutil
from collections import Counter

import pytest
from healthy_variants import READERS, TOML, Variant

import jaxbound as jb
from jaxbound.cli import evaluation, main, pipe


class Polars:
    """What jaxbound sees of a polars.DataFrame."""

    def __init__(self, frame):
        self._frame = frame

    def to_pandas(self):
        return self._frame.copy()


class Bench:
    """Judges Variants in a folder and counts."""

    def __init__(self, folder, capsys):
        self.folder, self.capsys, self.found, self.wrong = folder, capsys, Counter(), []
        (folder / "model.toml").write_text(TOML.format(columns="", y1=""))
        (folder / "raw.toml").write_text(TOML.format(columns="", y1='column = "= raw / 10000"'))
        self.model = jb.load_model(folder / "model.toml")
        self.relations = jb.parity_relations(self.model)

    def judge(self, v):
        """Return (counts of verdicts or None, what was said)."""
        place = self.folder / str(v.seed)
        self.file = "raw.toml" if v.by_thousands else "model.toml"
        place.mkdir()
        self.capsys.readouterr()
        try:
            return getattr(self, f"_{v.reader}", self._table)(v, place)
        finally:
            shutil.rmtree(place)

    def _shell(self, *args):
        code = main.main([*map(str, args), "--json"])
        out, err = self.capsys.readouterr()
        if code == 2 and not out:  # a fleet has a row for what it could not test
            assert err.startswith("jaxbound: ") and err.count("\n") == 1, err
            return None, err
        return json.loads(out), err

    def _detect(self, path, place):
        found, said = self._shell("detect", self.folder / self.file, path, "--out", place / "out")
        return found and found["counts"], " ".join((said, *(found["hints"] if found else ())))

    def _file(self, v, place):
        (place / "run.csv").write_bytes(v.text())
        return self._detect(place / "run.csv", place)

    def _parquet(self, v, place):
        return self._detect(v.parquet(place), place)

    def _pipe(self, v, place):
        data = v.text()
        cuts = sorted(v.draw.randrange(len(data)) for _ in range(v.draw.choice((0, 3, 40))))
        pieces = [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]
        try:
            pipe.judge_stream(pipe.LiveRun(self.folder / "model.toml", out=place / "out"), pieces)
        except pipe.Refused as e:
            return None, str(e)
        rows = (place / "out" / "verdicts.csv").read_text().splitlines()[1:]
        return Counter(row.split(",")[-3] for row in rows), self.capsys.readouterr().err

    def _table(self, v, place):
        import pandas as pd

        columns, index = v.frame()
        frame = pd.DataFrame(columns, index=None if index is None else pd.DatetimeIndex(index))
        frame = frame.iloc[v.arranged(list(range(v.rows)))]
        frame = frame.reset_index(drop=True) if index is None else frame
        if v.reader == "polars":
            flat = frame if index is None else frame.reset_index(names="time")
            try:
                import polars

                frame = polars.from_pandas(flat)
            except ImportError:
                frame = Polars(flat)
        elif v.reader == "arrow":
            import pyarrow as pa

            frame = pa.Table.from_pandas(frame)
        elif v.reader == "xarray":
            frame = frame.rename_axis("time" if index is not None else "row").to_xarray()
        try:
            return jb.detect(self.relations, frame).counts, ""
        except ValueError as e:
            return None, str(e)

    def _fleet(self, v, place):
        (place / "P 1.csv").write_bytes(v.text())
        ((counts, said),) = self._units(place, place / "P 1.csv")
        return counts, said

    def _units(self, place, *recordings, options=()):
        for path in recordings:
            (place / "units.csv").write_text(f"unit,model,recording\nP,{self.folder / self.file},{path}\n")
            found, said = self._shell("fleet", place / "units.csv", "--out", place / "out", *options)
            (unit,) = found["units"] if found else (None,)
            tested = unit is not None and unit["verdict"] != "not tested"
            yield (unit["counts"] if tested else None), said or json.dumps(unit)

    def _state(self, v, place):
        paths = []
        for i, half in enumerate(v.halves()):
            paths.append(place / f"day{i}.csv")
            paths[-1].write_bytes(half.text())
        found = list(self._units(place, *paths, options=("--state", place / "kept")))
        total = Counter()
        for counts, _ in found:
            total.update(counts or {})
        again = self.relations.horizon  # samples of the day before come first once more, MISSING
        rows = v.rows - sum("line end" in said for _, said in found)
        if found[1][0] and sum(total.values()) > rows:
            total["MISSING"] -= min(again, sum(total.values()) - rows)
        whole = all(counts for counts, _ in found)
        return (total if whole or total["FAULT"] else None), " ".join(said for _, said in found)

    def check(self, v):
        """Judge a healthy Variant and count; note where it is called faulty, or rows are lost without a
        word.
        """
        counts, said = self.judge(v)
        self.found[v.reader] += 1
        self.found["rows"] += v.rows
        if counts is None:
            self.found["refused"] += 1
            self.wrong += [] if len(said) > 20 else [(v.seed, v.reader, "refused without a sentence", said)]
            return
        judged = sum(counts.values())
        if counts.get("FAULT"):
            self.wrong.append((v.seed, v.reader, v.time, v.order, counts, said))
        rows = v.rows - said.count("has no line end")  # of it nothing shows that it is complete
        if judged != rows and not (v.reader == "pipe" and judged < v.rows and "line" in said):
            self.wrong.append((v.seed, v.reader, v.time, v.order, judged, v.rows, said))
        self.found["left out"] += v.rows - judged
        self.found["judged"] += judged
        self.found["decided"] += counts.get("CONSISTENT", 0)


@pytest.fixture
def bench(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.setattr(evaluation, "write_report", lambda *args, **options: None)
    return Bench(tmp_path, capsys)


def run(bench, seeds):
    for seed in seeds:
        bench.check(Variant(seed))
    found = bench.found
    assert {found[reader] for reader in READERS} <= {
        len(seeds) // len(READERS),
        len(seeds) // len(READERS) + 1,
    }
    assert (
        found["refused"] < 0.3 * len(seeds)
        and found["judged"] > 0.6 * found["rows"]
        and found["decided"] > 0.5 * found["judged"]
    )
    assert not bench.wrong, (len(bench.wrong), bench.wrong[:30])
    print(f"{len(seeds)} variants, 0 FAULT: {dict(found)}")


def test_no_healthy_recording_is_faulty_and_none_loses_rows(bench):
    run(bench, range(27))


@pytest.mark.long(by_day="test_no_healthy_recording_is_faulty_and_none_loses_rows")
def test_no_healthy_recording_of_many_is_faulty_and_none_loses_rows(bench):
    run(bench, range(1000, 3250))


def test_a_fault_in_such_a_recording_is_seen_by_every_reader(bench):
    seen = Counter()
    for seed in range(27):
        v = Variant(seed, fault=True)
        counts, _ = bench.judge(v)
        seen[v.reader] += bool(counts and counts.get("FAULT"))
    assert all(seen[reader] for reader in READERS), seen

"""Recordings larger than memory: the verdicts of one piece, whatever the chunks, and again after any
interruption.
"""

import os
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest
from streaming_case import MODELS, N, Stop, recording, stopped_after, verdicts, write
from systems import paper

import jaxbound as jb
from jaxbound.consistency import interface
from jaxbound.plots.timeline import Timeline
from jaxbound.recordings import parquet
from jaxbound.recordings.parquet import open_parquet
from jaxbound.recordings.read import read
from jaxbound.recordings.stillness import Runs, follow_runs
from jaxbound.runs import ask, parts
from jaxbound.runs.digest import detect_dataset, digest
from jaxbound.runs.outputs import output_folder
from jaxbound.runs.partnotes import read_runs
from jaxbound.runs.parts import part_files
from jaxbound.runs.streaming import Asked, publish, write_parts
from jaxbound.runs.summary import evidence
from jaxbound.runs.verdictfiles import AlarmColumns, write_alarms

pytestmark = [pytest.mark.compiled, pytest.mark.usefixtures("many")]


def flip(path, at):
    """Turn one bit of a byte over; dates and size stay as they are."""
    state, data = path.stat(), bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(data)
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))


def edited_in_place(path):
    """Change one bit of the third column, at the same size and with the dates of before."""
    chunk = pq.read_metadata(path).row_group(0).column(2)
    flip(path, chunk.data_page_offset + chunk.total_compressed_size - 9)


class TestSameVerdicts:
    @pytest.mark.parametrize("name", MODELS)
    def test_one_piece_has_something_to_compare(self, case, name):
        whole = case(name)[2]
        expected = {
            jb.Status.MISSING,
            jb.Status.FAULT,
            jb.Status.UNDECIDED if whole.method == "box" else jb.Status.CONSISTENT,
        }
        assert expected <= set(whole.status)

    @pytest.mark.parametrize("name", MODELS)
    def test_whatever_the_chunks(self, case, name, small, tmp_path, rng):
        r, folder, whole, _ = case(name)
        for chunk in (
            (int(rng.integers(150, 500)), 1000, N) if name == "section 5" else (int(rng.integers(700, 2000)),)
        ):
            found = detect_dataset(r, folder, tmp_path / str(chunk), method=whole.method, chunk=chunk)
            status, margin = verdicts(tmp_path / str(chunk))
            assert status.tobytes() == whole.status.tobytes() and found.counts == whole.counts
            assert found.margins == whole.margins
            if whole.margins == "exact":
                np.testing.assert_array_equal(margin, whole.margin)
                continue
            # which d explains a window may depend on those beside it; that it does not is proved for each
            fault = whole.status == jb.Status.FAULT
            np.testing.assert_array_equal(margin[fault], whole.reported[fault])
            inside = whole.status == jb.Status.CONSISTENT
            assert (0 < margin[inside]).all() and (margin[inside] <= whole.exact[inside] + 1e-9).all()

    @pytest.mark.long(
        by_day="test_margins_of_a_monitor_are_those_that_detect_chooses_by_the_number_of_windows"
    )
    def test_exact_margins_of_long_windows_whatever_the_chunks(self, case, small, tmp_path):
        r, folder, whole, _ = case("long windows")
        found = detect_dataset(r, folder, tmp_path / "out", chunk=1100, margins="exact")
        status, margin = verdicts(tmp_path / "out")
        assert (found.margins, whole.margins) == ("exact", "bounds")
        np.testing.assert_array_equal(status, whole.status)
        np.testing.assert_array_equal(margin, whole.exact)

    def test_margins_of_no_kind_are_refused(self, case, tmp_path):
        with pytest.raises(ValueError, match="margins"):
            detect_dataset(*case("section 5")[:2], tmp_path / "none", margins="sharp")

    @pytest.mark.parametrize("many, kind", [(N - 20, "bounds"), (N + 1, "exact")])
    def test_margins_of_a_monitor_are_those_that_detect_chooses_by_the_number_of_windows(
        self, case, small, tmp_path, monkeypatch, many, kind
    ):
        folder, exact = case("long windows")[1], case("long windows")[2].exact
        monkeypatch.setattr(interface, "MANY", many)
        bank = jb.monitor(paper(), [{"name": "long", "horizon": 20}])
        whole = jb.detect(bank, read(folder, paper()))
        found = detect_dataset(bank, folder, tmp_path / "out", chunk=1100)
        status, margin = verdicts(tmp_path / "out")
        assert (found.margins, whole.margins) == (kind, kind)
        assert found.bounded == (kind == "bounds"), "JSON says that the margin of the worst is none"
        np.testing.assert_array_equal(status, whole.status)
        assert np.array_equal(margin, exact, equal_nan=True) == (kind == "exact")
        fault, healthy = status == jb.Status.FAULT, status == jb.Status.CONSISTENT
        assert (exact[fault] <= margin[fault]).all() and (margin[fault] < 0).all()
        assert (margin[healthy] <= exact[healthy] + 1e-9).all() and (margin[healthy] > 0).all()

    def test_float32(self, case, small, tmp_path):
        r, folder, whole, _ = case("section 5", np.float32)
        assert whole.margin.dtype == np.float32
        detect_dataset(r, folder, tmp_path / "out", chunk=333)
        status, margin = verdicts(tmp_path / "out")
        np.testing.assert_array_equal(status, whole.status)
        np.testing.assert_array_equal(margin, whole.margin)

    def test_windows_across_a_gap_at_the_border_of_chunks_and_files_are_missing(self, small, tmp_path):
        model = paper()
        t, u, y = 0.01 * np.arange(N), np.zeros((N, 1)), np.zeros((N, 2))
        t[1000:] += 5
        t[2048:] += 5
        folder = write(tmp_path / "run", t, u, y, cuts=(1000,))
        for chunk in (1000, 512):
            detect_dataset(jb.parity_relations(model, 2), folder, tmp_path / f"out{chunk}", chunk=chunk)
            status = verdicts(tmp_path / f"out{chunk}")[0]
            assert list(np.flatnonzero(status == jb.Status.MISSING)) == [0, 1, 1000, 1001, 2048, 2049]

    def test_the_default_chunk_takes_a_whole_block_of_the_kernel(self, case, tmp_path):
        r, folder, whole, _ = case("section 5")
        detect_dataset(r, folder, tmp_path / "out", chunk=1)
        np.testing.assert_array_equal(verdicts(tmp_path / "out")[1], whole.margin)
        assert len(part_files(tmp_path / "out/verdicts.parquet")) == 1

    def test_time_is_written_as_it_was_read(self, case, small, tmp_path):
        r, folder, _, whole = case("section 5")
        detect_dataset(r, folder, tmp_path / "out")
        np.testing.assert_array_equal(
            pq.read_table(tmp_path / "out/verdicts.parquet")["time"].to_numpy(), whole.time
        )


class TestDigest:
    @pytest.mark.parametrize("k, n", [(1, 1), (2, 3), (3, 3), (5, 40), (1, 1500)])
    def test_alarms_are_those_of_one_piece(self, case, small, tmp_path, k, n):
        r, folder, whole, rec = case("section 5")
        partial, _ = write_parts(Asked(r), open_parquet(folder, r.model), tmp_path)
        found = digest(
            Asked(r),
            open_parquet(folder, r.model),
            partial,
            alarm=(k, n),
            alarms_csv=tmp_path / "streamed.csv",
        )
        alarms = whole.alarms(k, n)
        write_alarms(tmp_path / "whole.csv", alarms, rec, AlarmColumns(r.model.dt))
        assert (tmp_path / "streamed.csv").read_text() == (tmp_path / "whole.csv").read_text()
        assert (
            found.alarm_count == len(alarms)
            and all(a in alarms for a in found.alarms)
            and found.alarms[0] == alarms[0]
        )
        deepest = sorted(a.depth for a in alarms)[:200]
        assert sorted(a.depth for a in found.alarms)[: len(deepest)] == deepest and len(found.alarms) <= 201

    def test_everything_else_too(self, case, small, tmp_path):
        r, folder, whole, rec = case("section 5")
        found = detect_dataset(r, folder, tmp_path / "out", chunk=777)
        assert (
            found.worst == (evidence(whole, ()).at, evidence(whole, ()).margin)
            and found.counts == whole.counts
            and found.samples == N
        )
        assert (
            found.hints == rec.hints
            and any("stays at exactly" in h for h in found.hints)
            and any("gap" in h for h in found.hints)
        )
        assert [found.label(k) for k in (0, 2999, 3000, 4321, N - 1)] == [
            rec.label(k) for k in (0, 2999, 3000, 4321, N - 1)
        ]
        line = Timeline(N)
        line.add(0, rec.axis, whole.status, whole.margin)
        line.mark([a.worst for a in whole.alarms()])
        for field in ("x", "status", "low", "high", "marked"):
            np.testing.assert_array_equal(getattr(found.line, field), getattr(line, field))
        k = found.worst[0]
        assert found.explain(k).factor == whole.explain(k).factor == found.explain(found.label(k)).factor
        with pytest.raises(ValueError, match=f"there is no sample {N}: the recording has {N}"):
            found.explain(N)
        (first, last), alarm = found.alarms[0].times, found.alarms[0]
        assert (first, last) == (found.when(alarm.start), found.when(alarm.end))
        assert f"times='{found.when(alarm.start)}" in repr(alarm).replace("T", " ")
        part, near = found.around(k, 500)
        at = int(np.flatnonzero(near.time == rec.time[k])[0])
        assert part.margin[at] == whole.margin[k] and len(part.status) <= 501

    def test_alarms_name_the_sensors_that_could_be_wrong(self, case, small, tmp_path):
        r, folder, whole, _ = case("section 5")
        found = detect_dataset(r, folder, tmp_path, alarm=(2, 3))
        assert found.alarms[0].candidates == whole.alarms(2, 3)[0].candidates and found.alarms[0].errors
        with pytest.raises(ValueError, match="k of n needs k <= n: 3 of 2"):
            detect_dataset(r, folder, tmp_path, alarm=(3, 2))

    def test_all_fault_is_one_alarm_and_none_is_none(self, small, tmp_path):
        model = paper()
        for name, y in (
            ("healthy", np.zeros((N, 2))),
            ("wild", np.tile([[9.0, -9.0], [-9.0, 9.0]], (N // 2, 1))),
        ):
            folder = write(tmp_path / name, 0.01 * np.arange(N), np.zeros((N, 1)), y)
            found = detect_dataset(jb.parity_relations(model), folder, tmp_path / f"{name} out", chunk=999)
            assert [(a.start, a.end, a.windows) for a in found.alarms] == (
                [(1, N - 1, N - 1)] if name == "wild" else []
            )

    def test_runs_survive_their_way_through_a_file(self, case, small, tmp_path):
        r, folder, _, rec = case("section 5")
        partial, _ = write_parts(Asked(r, chunk=500), open_parquet(folder, r.model), tmp_path)
        last = read_runs(part_files(partial))
        for runs, x in zip(last, (rec.u[:, 0], rec.y[:, 0], rec.y[:, 1]), strict=True):
            once = follow_runs(Runs(), x)
            assert (runs.samples, runs.present, runs.longest, runs.last) == (
                once.samples,
                once.present,
                once.longest,
                once.last,
            )
            np.testing.assert_array_equal(runs.counts, once.counts)


def test_a_report_says_which_other_device_judged_each_chunk(case, small, tmp_path, monkeypatch):
    r, folder, whole, _ = case("section 5")
    monkeypatch.setattr(parts, "judging_device", lambda remembers: "gpu")
    for part in (1, 2):
        detect_dataset(r, folder, tmp_path / "out", chunk=777, part=(part, 2))
    found = detect_dataset(r, folder, tmp_path / "out", merge=True)
    assert found.hints.count("judged on gpu") == 1 and found.counts == whole.counts


class TestResume:
    def test_stopped_anywhere_it_goes_on_without_losing_or_repeating_a_window(
        self, case, small, tmp_path, rng, monkeypatch
    ):
        r, folder, whole, _ = case("section 5")
        tested = []
        monkeypatch.setattr(
            ask,
            "detect",
            lambda r, piece, **k: tested.append(piece.samples) or jb.detect(r, piece, **k),
        )
        source, out = open_parquet(folder, r.model), tmp_path / "out"
        for share in np.sort(rng.uniform(0.1, 0.95, 3)):
            before = len(part_files(out / "verdicts.partial"))
            tested.clear()
            with pytest.raises(Stop):
                write_parts(
                    Asked(r, chunk=int(rng.integers(200, 900))), source, out, progress=stopped_after(share)
                )
            assert len(part_files(out / "verdicts.partial")) >= before
            assert (
                sum(tested) < (share + 0.3) * N - 1024 * before + len(tested) * 2
            )  # parts that are there are not tested again
        write_parts(Asked(r, chunk=400), source, out)
        parts = part_files(out / "verdicts.partial")
        assert [pq.read_metadata(p).num_rows for p in parts] == [1024] * 5 + [N - 5 * 1024]
        found = digest(Asked(r), source, out / "verdicts.partial")
        with output_folder(out) as place:
            publish(place)
        status, margin = verdicts(out)
        np.testing.assert_array_equal(status, whole.status)
        np.testing.assert_array_equal(margin, whole.margin)
        assert found.hints == read(folder, r.model).hints

    def test_a_part_that_was_being_written_is_no_part(self, case, small, tmp_path):
        r, folder, whole, _ = case("section 5")
        with pytest.raises(Stop):
            write_parts(
                Asked(r, chunk=500), open_parquet(folder, r.model), tmp_path, progress=stopped_after(0.5)
            )
        (tmp_path / "verdicts.partial/.part-00003.parquet.jaxbound-part").write_bytes(
            b"PAR1 and half of the rest"
        )
        detect_dataset(r, folder, tmp_path)
        np.testing.assert_array_equal(verdicts(tmp_path)[0], whole.status)
        assert {p.suffix for p in (tmp_path / "verdicts.parquet").iterdir()} == {".parquet"}

    def test_all_parts_there_and_the_report_missing(self, case, small, tmp_path):
        r, folder, whole, _ = case("section 5")
        write_parts(Asked(r), open_parquet(folder, r.model), tmp_path)
        assert detect_dataset(r, folder, tmp_path).counts == whole.counts

    @pytest.mark.parametrize(
        "change, what",
        [
            ("matrix", "another model"),
            ("offset", "another model"),
            ("horizon", "another horizon"),
            ("bounds", "another model"),
            ("method", "another method"),
            ("content", "another content of the recording"),
            ("another file", "another recording"),
            ("version", "another version of jaxbound"),
            ("precision", "another precision"),
        ],
    )
    def test_another_run_is_not_continued(self, case, small, tmp_path, monkeypatch, change, what):
        r, folder, _, _ = case("section 5")
        folder = shutil.copytree(folder, tmp_path / "copy")
        with pytest.raises(Stop):
            write_parts(
                Asked(r, chunk=500), open_parquet(folder, r.model), tmp_path, progress=stopped_after(0.5)
            )
        kept = part_files(tmp_path / "verdicts.partial")
        method = "box" if change == "method" else "joint"
        if change == "matrix":
            r = jb.parity_relations(paper(A=[["0.8", 1], [0, "0.2000001"]]))
        elif change == "offset":
            r = jb.parity_relations(paper(offset={"y": [0, "0.001"]}))
        elif change == "horizon":
            r = jb.parity_relations(paper(), 2)
        elif change == "bounds":
            r = r.with_bounds({"noise": 0.5})
        elif change == "content":
            edited_in_place(folder / "1.parquet")
        elif change == "another file":
            t, u, y = recording()
            write(tmp_path / "more", t[-1] + 0.01 + t, u, y, cuts=())
            shutil.copyfile(tmp_path / "more/0.parquet", folder / "9.parquet")
        elif change == "version":
            monkeypatch.setattr(jb, "__version__", "0.0.1")
        elif change == "precision":
            monkeypatch.setattr("jax.dtypes.canonicalize_dtype", lambda kind: np.dtype(np.float32))
        with pytest.raises(
            ValueError, match=f"part-00000.parquet is of {what}: choose another place, or delete it"
        ):
            detect_dataset(r, folder, tmp_path, method=method)
        assert part_files(tmp_path / "verdicts.partial") == kept != []

    def test_a_recording_that_was_only_copied_is_continued(self, case, small, tmp_path):
        r, folder, whole, _ = case("section 5")
        folder = shutil.copytree(folder, tmp_path / "copy")
        with pytest.raises(Stop):
            write_parts(
                Asked(r, chunk=500), open_parquet(folder, r.model), tmp_path, progress=stopped_after(0.5)
            )
        shutil.copyfile(folder / "1.parquet", tmp_path / "spare")
        (tmp_path / "spare").replace(folder / "1.parquet")
        assert detect_dataset(r, folder, tmp_path).counts == whole.counts

    def test_a_recording_that_grows_meanwhile_is_refused(self, case, small, tmp_path):
        r, folder, _, _ = case("section 5")
        folder = shutil.copytree(folder, tmp_path / "copy")
        touch = lambda share: (
            share > 0.5 and (folder / "0.parquet").write_bytes((folder / "0.parquet").read_bytes() + b" ")
        )
        with pytest.raises(ValueError, match="0.parquet has changed since it was opened: test it again"):
            write_parts(Asked(r, chunk=500), open_parquet(folder, r.model), tmp_path / "out", progress=touch)
        assert not any((tmp_path / "out").iterdir())

    def test_a_part_that_was_damaged_is_noticed(self, case, small, tmp_path):
        r, folder, _, _ = case("section 5")
        write_parts(Asked(r), open_parquet(folder, r.model), tmp_path)
        part = part_files(tmp_path / "verdicts.partial")[2]
        edited_in_place(part)
        with pytest.raises(
            ValueError,
            match="part-00002.parquet is a damaged Parquet file: .* CRC checksum verification failed",
        ):
            detect_dataset(r, folder, tmp_path)

    def test_a_finished_run_is_replaced(self, case, small, tmp_path):
        r, folder, whole, _ = case("section 5")
        detect_dataset(r, folder, tmp_path, method="box")
        detect_dataset(r, folder, tmp_path)
        np.testing.assert_array_equal(verdicts(tmp_path)[0], whole.status)
        assert {p.name for p in tmp_path.iterdir()} == {"verdicts.parquet", ".jaxbound.json"}

    def test_bad_data_leave_nothing(self, case, small, tmp_path, monkeypatch):
        monkeypatch.setattr(parquet, "PROBE", 1000)
        r, _, _, _ = case("section 5")
        t, u, y = recording()
        y[5500, 0] = np.inf
        folder = write(tmp_path / "run", t, u, y)
        with pytest.raises(ValueError, match="row 1001 of 3.parquet of column 'y1' is infinite"):
            detect_dataset(r, folder, tmp_path / "out", chunk=500)
        assert not (tmp_path / "out").exists()

    def test_irregular_data_leave_nothing(self, small, tmp_path, monkeypatch):
        monkeypatch.setattr(parquet, "PROBE", 1000)
        t, u, y = recording()
        t[1100:] = 20 + np.cumsum(np.tile([0.005, 0.015], (N - 1100) // 2))
        with pytest.raises(ValueError, match="the recording is not regular"):
            detect_dataset(jb.parity_relations(paper()), write(tmp_path / "run", t, u, y), tmp_path / "out")
        assert not (tmp_path / "out").exists()

    def test_a_full_disk_keeps_what_is_there(self, case, small, tmp_path, monkeypatch):
        r, folder, whole, _ = case("section 5")
        replace, count = os.replace, []

        def full(a, b):
            count.append(b)
            if len(count) == 4:
                raise OSError(28, "No space left on device", str(b))
            replace(a, b)

        monkeypatch.setattr(os, "replace", full)
        with pytest.raises(OSError, match="No space left"):
            detect_dataset(r, folder, tmp_path, chunk=500)
        assert len(part_files(tmp_path / "verdicts.partial")) == 3
        assert detect_dataset(r, folder, tmp_path, chunk=500).counts == whole.counts

    def test_other_relations_are_refused(self, case, tmp_path):
        with pytest.raises(
            TypeError, match="needs relations of a model, whose verdicts can be kept, not LinearSystem"
        ):
            detect_dataset(paper(), case("section 5")[1], tmp_path)

    def test_a_method_that_does_not_apply_is_refused_before_anything_is_written(self, case, tmp_path):
        r, folder, _, _ = case("section 5")
        with pytest.raises(ValueError, match="method 'linearized' is gone"):
            detect_dataset(r, folder, tmp_path / "out", method="linearized")
        assert not (tmp_path / "out").exists()

"""Shares of one recording, made apart and merged: the bytes of one process, and a sentence wherever that
cannot be.
"""

import json
import re
import shutil
import threading

import numpy as np
import pyarrow.parquet as pq
import pytest
from streaming_case import N, Stop, parts_of, recording, stopped_after, verdicts, write
from systems import paper

import jaxbound as jb
from jaxbound.cli import evaluation, main
from jaxbound.recordings import contents
from jaxbound.recordings.parquet import ParquetSource, open_parquet
from jaxbound.runs import ask
from jaxbound.runs.digest import detect_dataset
from jaxbound.runs.parts import part_files
from jaxbound.runs.streaming import Asked, write_parts

COUNT = 6  # parts of the recording


pytestmark = [pytest.mark.usefixtures("small"), pytest.mark.compiled]


def shares(case, out, n, order=None, **options):
    """Make all shares, each by a call of its own."""
    r, folder, _, _ = case("section 5")
    return [detect_dataset(r, folder, out, part=(i, n), **options) for i in order or range(1, n + 1)]


class TestSameBytes:
    @pytest.mark.parametrize("n, chunk", [(2, 2000), (7, 900)])  # 7 are more than there are parts
    def test_as_one_process_writes(self, case, one, tmp_path, n, chunk):
        r, folder, _, _ = case("section 5")
        made = shares(case, tmp_path, n, chunk=chunk)
        assert sorted(p.name for files in made for p in files) == [
            f"part-{k:05d}.parquet" for k in range(COUNT)
        ]
        found = detect_dataset(r, folder, tmp_path, merge=True)
        assert parts_of(tmp_path / "verdicts.parquet") == parts_of(one[0] / "verdicts.parquet")
        assert {p.name for p in tmp_path.iterdir()} == {"verdicts.parquet", ".jaxbound.json"}
        for name in ("counts", "worst", "hints", "alarm_count", "alarms", "ended", "found"):
            assert getattr(found, name) == getattr(one[1], name), name

    def test_in_any_order(self, case, one, tmp_path):
        r, folder, _, _ = case("section 5")
        shares(case, tmp_path, 3, (3, 1, 2))
        detect_dataset(r, folder, tmp_path, merge=True)
        assert parts_of(tmp_path / "verdicts.parquet") == parts_of(one[0] / "verdicts.parquet")

    def test_shares_of_different_numbers_are_finished_by_one_process(self, case, one, tmp_path, monkeypatch):
        r, folder, whole, _ = case("section 5")
        detect_dataset(r, folder, tmp_path, part=(1, 3))
        detect_dataset(r, folder, tmp_path, part=(4, 4))
        tested = []
        monkeypatch.setattr(
            ask,
            "detect",
            lambda r, piece, **k: tested.append(piece.samples) or jb.detect(r, piece, **k),
        )
        assert detect_dataset(r, folder, tmp_path).counts == whole.counts
        assert sum(tested) == 2 * 1024 + r.horizon  # parts 2 and 3, and the window before them
        assert parts_of(tmp_path / "verdicts.parquet") == parts_of(one[0] / "verdicts.parquet")

    def test_both_at_once(self, case, one, tmp_path):
        r, folder, _, _ = case("section 5")
        said = [None, None]
        both = threading.Barrier(2)

        def work(i):
            together = lambda share: share == 0 and both.wait(20)
            try:
                said[i] = detect_dataset(r, folder, tmp_path, part=(i + 1, 2), chunk=500, progress=together)
            except BaseException as e:
                said[i] = e

        threads = [threading.Thread(target=work, args=(i,), daemon=True) for i in range(2)]
        for t in threads:
            t.start()
        for t in threads:
            t.join(60)
        assert [len(files) for files in said] == [3, 3]
        assert {p.name for p in tmp_path.iterdir()} == {"verdicts.partial"}
        detect_dataset(r, folder, tmp_path, merge=True)
        assert parts_of(tmp_path / "verdicts.parquet") == parts_of(one[0] / "verdicts.parquet")

    def test_parts_that_were_made_in_folders_of_their_own_and_brought_together(self, case, one, tmp_path):
        r, folder, _, _ = case("section 5")
        (tmp_path / "out/verdicts.partial").mkdir(parents=True)
        for i in (1, 2):
            for file in detect_dataset(r, folder, tmp_path / str(i), part=(i, 2)):
                file.rename(tmp_path / "out/verdicts.partial" / file.name)
        detect_dataset(r, folder, tmp_path / "out", merge=True)
        assert parts_of(tmp_path / "out/verdicts.parquet") == parts_of(one[0] / "verdicts.parquet")


class TestMissing:
    @pytest.mark.parametrize(
        "made, n, sentence",
        [
            (
                (1, 3),
                3,
                "lacks part-00002.parquet and part-00003.parquet, 2 of 6 parts: the same without merge makes "
                "only these",
            ),
            (
                (2, 3, 4, 5),
                6,
                "lacks part-00000.parquet and part-00005.parquet, 2 of 6 parts: the same without merge makes "
                "only these",
            ),
            (
                (1,),
                6,
                "lacks part-00001.parquet to part-00005.parquet, 5 of 6 parts: the same without merge makes "
                "only these",
            ),
            (
                (),
                2,
                "lacks part-00000.parquet to part-00005.parquet, 6 of 6 parts: the same without merge makes "
                "only these",
            ),
        ],
    )
    def test_parts_are_named_and_what_makes_them(self, case, tmp_path, made, n, sentence):
        r, folder, _, _ = case("section 5")
        for i in made:
            detect_dataset(r, folder, tmp_path, part=(i, n))
        before = parts_of(tmp_path / "verdicts.partial")
        with pytest.raises(ValueError, match=re.escape(f"{tmp_path}/verdicts.partial {sentence}")):
            detect_dataset(r, folder, tmp_path, merge=True)
        assert parts_of(tmp_path / "verdicts.partial") == before

    def test_the_parts_of_a_bad_share_are_missing_and_it_says_why(self, case, tmp_path, monkeypatch):
        r = case("section 5")[0]
        t, u, y = recording()
        y[5500, 0] = np.inf
        folder = write(tmp_path / "run", t, u, y)
        monkeypatch.setattr(ParquetSource, "probe", lambda self: self.read(0, 1000))
        sentence = "row 1001 of 3.parquet of column 'y1' is infinite"
        with pytest.raises(ValueError, match=sentence) as alone:
            detect_dataset(r, folder, tmp_path / "alone", chunk=500)
        detect_dataset(r, folder, tmp_path / "out", chunk=500, part=(1, 6))
        with pytest.raises(ValueError, match=sentence) as shared:
            detect_dataset(r, folder, tmp_path / "out", chunk=500, part=(6, 6))
        assert str(shared.value) == str(alone.value)
        for i in range(2, 6):
            detect_dataset(r, folder, tmp_path / "out", chunk=500, part=(i, 6))
        with pytest.raises(
            ValueError,
            match=r"lacks part-00005.parquet, 1 of 6 parts: the same without merge makes only these",
        ):
            detect_dataset(r, folder, tmp_path / "out", merge=True)

    def test_a_share_that_was_stopped_goes_on_and_what_is_there_stays(self, case, one, tmp_path, monkeypatch):
        r, folder, _, _ = case("section 5")
        with pytest.raises(Stop):
            detect_dataset(r, folder, tmp_path, part=(2, 2), chunk=300, progress=stopped_after(0.5))
        kept = {p: p.stat().st_mtime_ns for p in part_files(tmp_path / "verdicts.partial")}
        assert [p.name for p in kept] == ["part-00003.parquet"]
        (tmp_path / "verdicts.partial/.part-00004.parquet.jaxbound-part").write_bytes(
            b"PAR1 and half of the rest"
        )  # kill -9
        tested = []
        monkeypatch.setattr(
            ask,
            "detect",
            lambda r, piece, **k: tested.append(piece.samples) or jb.detect(r, piece, **k),
        )
        shares(case, tmp_path, 2, chunk=N)
        assert sum(tested) == N - 1024 + r.horizon and {p: p.stat().st_mtime_ns for p in kept} == kept
        detect_dataset(r, folder, tmp_path, merge=True)
        assert parts_of(tmp_path / "verdicts.parquet") == parts_of(one[0] / "verdicts.parquet")


class TestAnother:
    def test_model_is_refused_by_share_and_by_merge(self, case, tmp_path):
        r, folder, _, _ = case("section 5")
        other = jb.parity_relations(paper(noise=["0.1", "0.02"]))
        detect_dataset(other, folder, tmp_path, part=(2, 2))
        kept = parts_of(tmp_path / "verdicts.partial")
        for options in ({"part": (1, 2)}, {"merge": True}, {}):
            with pytest.raises(
                ValueError, match="part-00003.parquet is of another model: choose another place, or delete it"
            ):
                detect_dataset(r, folder, tmp_path, **options)
        assert parts_of(tmp_path / "verdicts.partial") == kept

    def test_model_that_came_in_meanwhile_is_refused_by_merge(self, case, tmp_path):
        r, folder, _, _ = case("section 5")
        other = jb.parity_relations(paper(noise=["0.1", "0.02"]))
        for i in (1, 2):
            detect_dataset((r, other)[i - 1], folder, tmp_path / str(i), part=(i, 2))
        for file in part_files(tmp_path / "2/verdicts.partial"):
            file.rename(tmp_path / "1/verdicts.partial" / file.name)
        with pytest.raises(ValueError, match="part-00003.parquet is of another model"):
            detect_dataset(r, folder, tmp_path / "1", merge=True)

    def test_recording_is_refused(self, case, tmp_path):
        r, folder, _, _ = case("section 5")
        detect_dataset(r, folder, tmp_path, part=(1, 2))
        t, u, y = recording()
        y[10, 0] += 1e-12
        with pytest.raises(ValueError, match="part-00000.parquet is of another recording"):
            detect_dataset(r, write(tmp_path / "cut", t, u, y, cuts=(1000, 4500)), tmp_path, part=(2, 2))
        other = write(tmp_path / "run", t, u, y)
        detect_dataset(r, other, tmp_path, part=(2, 2))  # it reads nothing of part 0
        with pytest.raises(ValueError, match="part-00000.parquet is of another content of the recording"):
            detect_dataset(r, other, tmp_path, merge=True)

    def test_content_is_refused_where_it_was_read_and_nowhere_else(self, case, tmp_path, monkeypatch):
        """One bit in the last file, at the same size: only the part that was made of it is another's."""
        monkeypatch.setattr(contents, "BLOCK", 1024)
        r, folder, _, _ = case("section 5")
        folder = shutil.copytree(folder, tmp_path / "copy")
        shares(lambda name: (r, folder, None, None), tmp_path / "out", 6)
        data = bytearray((folder / "3.parquet").read_bytes())
        chunk = pq.read_metadata(folder / "3.parquet").row_group(2).column(2)
        data[chunk.data_page_offset + chunk.total_compressed_size - 9] ^= 1
        (folder / "3.parquet").write_bytes(data)
        with pytest.raises(
            ValueError, match="part-00005.parquet is of another content of the recording: choose"
        ):
            detect_dataset(r, folder, tmp_path / "out", merge=True)

    def test_a_part_under_another_number_is_refused(self, case, tmp_path):
        r, folder, _, _ = case("section 5")
        shares(case, tmp_path, 2)
        partial = tmp_path / "verdicts.partial"
        (partial / "part-00001.parquet").rename(partial / "spare")
        (partial / "part-00002.parquet").rename(partial / "part-00001.parquet")
        (partial / "spare").rename(partial / "part-00002.parquet")
        with pytest.raises(ValueError, match="part-00001.parquet is of another place in the recording"):
            detect_dataset(r, folder, tmp_path, merge=True)


def test_a_share_reads_no_more_of_the_recording_than_it_judges(case, tmp_path, monkeypatch):
    """Not even to know it again: of the bytes, few are digested by more than one of many shares."""
    monkeypatch.setattr(contents, "BLOCK", 4096)
    digested = []
    digest = contents._digest_of_block
    monkeypatch.setattr(contents, "_digest_of_block", lambda block: digested.append(block) or digest(block))
    each = [len(digested) for _ in shares(case, tmp_path, 6)]
    blocks = sum(-(-p.stat().st_size // 4096) for p in case("section 5")[1].iterdir())
    assert len(set(digested)) == blocks and each == sorted(each)
    assert len(digested) < 2 * blocks  # borders of row groups and the ends of files


class TestDoor:
    @pytest.mark.parametrize("part", [(0, 2), (3, 2), (1, 0), (1.0, 2), (True, 2), (1,), 1, "1/2"])
    def test_a_share_that_is_none(self, case, tmp_path, part):
        r, folder, _, _ = case("section 5")
        with pytest.raises(
            ValueError, match=r"part is \(i, n\), the i-th of n shares with 1 <= i <= n, not "
        ):
            detect_dataset(r, folder, tmp_path / "out", part=part)
        assert not (tmp_path / "out").exists()

    def test_part_and_merge_together(self, case, tmp_path):
        r, folder, _, _ = case("section 5")
        with pytest.raises(
            ValueError, match="part makes verdicts and merge reports on them: give one of the two"
        ):
            detect_dataset(r, folder, tmp_path, part=(1, 2), merge=True)

    def test_a_share_keeps_away_who_merges_and_not_another_share(self, case, tmp_path):
        r, folder, _, _ = case("section 5")
        said = []

        def meanwhile(share):
            if not said:
                said.append(None)
                detect_dataset(r, folder, tmp_path, part=(2, 2))
                for options in ({}, {"merge": True}):
                    with pytest.raises(ValueError, match="another jaxbound, process [0-9]+, is writing into"):
                        detect_dataset(r, folder, tmp_path, **options)

        detect_dataset(r, folder, tmp_path, part=(1, 2), progress=meanwhile)
        assert said and detect_dataset(r, folder, tmp_path, merge=True)


@pytest.fixture
def place(tmp_path, monkeypatch, case):
    """Return a folder with model.toml and the recording run, in which commands run."""
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.setattr(evaluation, "write_report", lambda file, *args, **options: file.touch())
    monkeypatch.chdir(tmp_path)
    jb.save_model(paper(), tmp_path / "model.toml")
    (tmp_path / "run").symlink_to(case("section 5")[1])
    return tmp_path


DETECT = ["detect", "model.toml", "run", "--out"]


class TestCommand:
    def test_shares_and_their_merge_write_what_one_command_writes(self, place, capsys):
        assert main.main([*DETECT, "one", "--alarm", "2/3", "--json"]) == 1
        alone = json.loads(capsys.readouterr().out)
        for i in (2, 1):
            assert main.main([*DETECT, "out", "--part", f"{i}/2", "--json"]) == 0
            found = json.loads(capsys.readouterr().out)
            assert (found["part"], found["parts"], len(found["files"])) == (f"{i}/2", 6, 3)
        assert main.main([*DETECT, "out", "--merge", "--alarm", "2/3", "--json"]) == 1
        merged = json.loads(capsys.readouterr().out)
        assert {**merged, "seconds": 0, "out": 0} == {**alone, "seconds": 0, "out": 0}
        files = lambda out: {
            p.relative_to(out).as_posix(): p.read_bytes()
            for p in out.rglob("*")
            if p.is_file() and p.name[0] != "."
        }
        assert files(place / "out") == files(place / "one") and "alarms.csv" in files(place / "out")
        assert {p.name for p in (place / "out").iterdir()} == {p.name for p in (place / "one").iterdir()}

    def test_a_share_says_what_it_did_and_what_comes_next(self, place, capsys):
        assert main.main([*DETECT, "out", "--part", "2/3", "--test", "horizon=2"]) == 0
        said = capsys.readouterr().out
        assert said.startswith(
            "Part 2/3 is done: the verdicts of samples 2048 to 4095 are in out/verdicts.partial\n"
        )
        assert "jaxbound detect --merge model.toml run --out out --test horizon=2" in said

    def test_a_share_of_nothing_is_done(self, place, capsys):
        assert main.main([*DETECT, "out", "--part", "1/7"]) == 0
        assert (
            "Part 1/7 is done: there are 6 parts, and none of them is in this share"
            in capsys.readouterr().out
        )
        assert not (place / "out").exists()

    def test_a_missing_part_is_2_and_what_makes_it(self, place, capsys):
        main.main([*DETECT, "out", "--part", "1/2"])
        capsys.readouterr()
        assert main.main([*DETECT, "out", "--merge"]) == 2
        assert capsys.readouterr() == (
            "",
            (
                "jaxbound: out/verdicts.partial lacks part-00003.parquet to part-00005.parquet, 3 of 6 "
                "parts: the same without merge "
                "makes only these\n"
            ),
        )

    def test_interrupted_it_says_how_to_go_on(self, place, capsys, monkeypatch):
        calls = []

        def detect(*args, **options):
            calls.append(1)
            if len(calls) == 4:
                raise KeyboardInterrupt
            return jb.detect(*args, **options)

        monkeypatch.setattr(ask, "detect", detect)
        assert main.main([*DETECT, "out", "--part", "1/2", "--chunk", "500"]) == 130
        assert capsys.readouterr().err == (
            "jaxbound: interrupted: what part 1/2 has done is kept in out/verdicts.partial; the same command "
            "goes on from there\n"
        )

    @pytest.mark.parametrize(
        "args, sentence",
        [
            (
                ("run.csv", "--out", "out", "--part", "1/2"),
                "--part is for Parquet: run.csv is read as a whole",
            ),
            (("run.csv", "--out", "out", "--merge"), "--merge is for Parquet: run.csv is read as a whole"),
            (("-", "--out", "out", "--part", "1/2"), "--part is for recordings: give a file instead of -"),
            (("-", "--out", "out", "--merge"), "--merge is for recordings: give a file instead of -"),
            (
                ("run", "--out", "out", "--part", "1/2", "--method", "validation"),
                "--part is for other methods: validation reads run",
            ),
            (
                ("run", "--out", "out", "--part", "1/2", "--merge"),
                "--merge reports on what --part makes: give one of the two",
            ),
            (
                ("run", "--out", "out", "--part", "3/2"),
                "--part needs i/n with 1 <= i <= n, like 2/3, not '3/2'",
            ),
            (
                ("run", "--out", "run/0.parquet", "--part", "1/2"),
                "run/0.parquet is a file: a folder is needed",
            ),
        ],
    )
    def test_where_there_are_no_shares(self, place, capsys, args, sentence):
        (place / "run.csv").write_text("t,u1,y1,y2\n0,0,0,0\n0.01,0,0,0\n")
        assert main.main(["detect", "model.toml", *args]) == 2
        assert sentence in capsys.readouterr().err and not (place / "out").exists()

    def test_the_command_does_not_touch_a_stranger(self, place, capsys):
        (place / "out/verdicts.partial").mkdir(parents=True)
        (place / "out/verdicts.partial/mine.txt").write_text("mine")
        for option in (("--part", "1/2"), ("--merge",)):
            assert main.main([*DETECT, "out", *option]) == 2
            assert (
                "out/verdicts.partial holds mine.txt, which was not written by jaxbound: move it"
                in capsys.readouterr().err
            )


def test_a_part_made_by_another_share_meanwhile_is_looked_at_before_it_is_replaced(case, tmp_path):
    r, folder, _, _ = case("section 5")
    other = jb.parity_relations(paper(noise=["0.1", "0.02"]))
    made = []

    def meanwhile(share):
        if not made:
            made.extend(detect_dataset(other, folder, tmp_path, part=(1, 2)))

    with pytest.raises(ValueError, match="part-00000.parquet is of another model"):
        write_parts(Asked(r), open_parquet(folder, r.model), tmp_path, part=(1, 2), progress=meanwhile)


def test_killed_shares_leave_no_lock(case, tmp_path):
    r, folder, whole, _ = case("section 5")
    shares(case, tmp_path, 2)
    (tmp_path / ".jaxbound-lock").write_text("1")
    assert detect_dataset(r, folder, tmp_path, merge=True).counts == whole.counts
    assert (
        not (tmp_path / ".jaxbound-lock").exists()
        and verdicts(tmp_path)[0].tobytes() == whole.status.tobytes()
    )

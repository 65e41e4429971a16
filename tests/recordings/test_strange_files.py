"""Files as loggers, historians and spreadsheets write them: whatever stands around the samples, and however
stamps and numbers are written, the samples are those of the plain file, or a sentence counts what is left
out; a pipe, Parquet, a table, a fleet and a fit say the same of the same samples.
"""

import datetime

import numpy as np
import pandas as pd
import pytest
from strange_files import (
    COUNT,
    DAMAGE,
    DIALECTS,
    STAMPS,
    draw,
    drawn_names,
    no_damage,
    plant,
    samples,
)

import jaxbound as jb
from jaxbound.certificates.checker.files import read_model
from jaxbound.models.modelfile import model_text
from jaxbound.recordings.pipetext import PipeText
from jaxbound.recordings.read import read_signals
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.recordingformat import format_of, with_format
from jaxbound.recordings.stream import Taken
from jaxbound.recordings.timestamps import instant_of
from jaxbound.runs.ask import Ask
from jaxbound.runs.fleet import FleetTest, detect_fleet, read_manifest

PLANT = plant()


def from_pipe(data, model, cuts):
    """Return (Recording of all pieces, sentences) of bytes that come in pieces."""
    said, edges = [], [0, *cuts, len(data)]
    pipe = PipeText(model, lambda kind, sentence: said.append(sentence))
    pieces = [pipe.take(data[a:b]) for a, b in zip(edges, edges[1:], strict=False)]
    pipe.ended()
    pieces = [piece for piece in pieces if piece is not None]
    whole = pieces[0]
    for piece in pieces[1:]:
        whole = whole.followed(piece)
    return whole, said


def check(path, rng, file):
    """Compare a file that is drawn with its samples, through every door that reads it; return (Recording,
    Result).
    """
    path.write_bytes(file.data)
    u, y = file.u[file.kept], file.y[file.kept]
    run = jb.read(path, file.model)
    about = f"{file.about}: {run.hints}"
    assert run.samples == len(u), about
    np.testing.assert_array_equal(run.u[:, 0], u, about)
    np.testing.assert_array_equal(run.y[:, 0], y, about)
    moments = [file.moments[k] for k in file.kept]
    since = np.array([moment.since - moments[0].since for moment in moments])
    np.testing.assert_allclose(run.time - run.time[0], since, rtol=1e-9, atol=1e-3, err_msg=about)
    for sentence in file.said:
        assert sentence in " ".join(run.hints), (sentence, about)
    result = jb.detect(file.relations, run)
    assert (result.status != jb.Status.FAULT).all(), about
    if file.dialect.from_pipe:
        live, said = from_pipe(file.data, file.model, sorted(rng.integers(0, len(file.data), 5).tolist()))
        np.testing.assert_array_equal(live.u, run.u, f"{about} {said}")
        np.testing.assert_array_equal(live.y, run.y, f"{about} {said}")
        np.testing.assert_allclose(np.diff(live.time), np.diff(since), 1e-9, 1e-3, err_msg=f"{about} {said}")
    frame = pd.DataFrame({"time": [moment.utc for moment in moments], "heater": u, "temp": y})
    frame.to_parquet(path.with_suffix(".parquet"))
    bare = file.model.replace(columns={})
    for same in (Recording.of(bare, frame), jb.read(path.with_suffix(".parquet"), bare)):
        assert same.u.tobytes() == run.u.tobytes() and same.y.tobytes() == run.y.tobytes(), about
        assert same.starts.tolist() == run.starts.tolist(), about
    if not file.dialect.long and not file.dialect.on_change:
        index = pd.DatetimeIndex([moment.utc for moment in moments])
        cells = {name: file.texts[name] for name in ("heater", "temp")}
        texts = Recording.of(file.model, pd.DataFrame(cells, index, dtype=object))
        np.testing.assert_array_equal(texts.u[:, 0], u, about)
        np.testing.assert_array_equal(texts.y[:, 0], y, about)
    return run, result


def check_fit(path, file):
    """Check that a file gives the model of its samples, bit for bit."""
    if not file.stamp.fits:
        return
    path.write_bytes(file.data)
    index = pd.DatetimeIndex([file.moments[k].utc for k in file.kept], name="time")
    frame = pd.DataFrame({"heater": file.u[file.kept], "temp": file.y[file.kept]}, index)
    models = []
    for data, how in ((frame, None), (path, file.dialect.how)):
        try:
            model = jb.fit(data, order=1, horizon=4, inputs=["heater"], outputs=["temp"], recording=how)
        except ValueError as refused:  # an input that does not move
            models.append(str(refused).partition(": ")[2])
        else:
            models.append(model_text(model.replace(columns={})))
    assert models[0] == models[1], file.about


def check_fleet(folder, drawn):
    """Check that units of one fleet are what each is alone. drawn: [(file, its Recording, its Result)]."""
    jb.save_model(drawn[0][0].model, folder / "plant.toml")
    rows = ["unit,model,recording"]
    for k, (file, _, _) in enumerate(drawn):
        (folder / f"{k}.csv").write_bytes(file.data)
        rows.append(f"{k},plant.toml,{k}.csv")
    (folder / "fleet.csv").write_text("\n".join([*rows, ""]))
    units = list(detect_fleet(read_manifest(folder / "fleet.csv"), FleetTest(Ask())))
    assert len(units) == len(drawn)
    for unit, (file, run, result) in zip(units, drawn, strict=True):
        assert unit.verdict in ("no fault", "too little evidence"), (file.about, unit)
        assert unit.summary.counts == result.counts, file.about
        assert {*run.hints} <= {*unit.summary.hints}, file.about


@pytest.mark.parametrize("stamp", STAMPS)
def test_every_form_of_time_stamps_is_read(tmp_path, stamp):
    rng = np.random.default_rng(len(stamp))
    check(tmp_path / "run.csv", rng, draw(rng, stamp, "German", [no_damage]))


@pytest.mark.parametrize("dialect", DIALECTS)
def test_every_way_to_write_cells_is_read(tmp_path, dialect):
    rng = np.random.default_rng(len(dialect))
    check(tmp_path / "run.csv", rng, draw(rng, "historian", dialect, [no_damage]))


@pytest.mark.parametrize("damage", DAMAGE, ids=lambda damage: damage.__name__)
def test_rows_that_are_no_data_are_left_out_and_counted(tmp_path, damage):
    rng = np.random.default_rng(len(damage.__name__))
    for stamp, dialect in (("iso", "plain"), ("seconds", "German")):
        check(tmp_path / "run.csv", rng, draw(rng, stamp, dialect, [damage]))


@pytest.mark.parametrize("count", [4, 5000])
def test_drawn_files_are_read_as_they_were_meant_or_say_what_is_left_out(tmp_path, count):
    rng = np.random.default_rng(48)
    for _ in range(0, count, 4):
        dialect, dt = str(rng.choice(list(DIALECTS))), int(rng.choice([1, 60, 900]))
        files = [draw(rng, *drawn_names(rng, dialect, dt)) for _ in range(4)]
        check_fleet(tmp_path, [(file, *check(tmp_path / "run.csv", rng, file)) for file in files])
        check_fit(tmp_path / "run.csv", files[0])


CELLS = {  # (delimiter, cells of temp, their numbers; None: refused)
    "commas in quotes": (",", ['"40,0"', '"40,25"', '"7"'], [40, 40.25, 7]),
    "below one": (",", ['"0,125"', '"0,250"', '"0,5"'], [0.125, 0.25, 0.5]),
    "decimals or thousands": (",", ['"40,125"', '"40,250"', '"7"'], None),
    "percent": (";", ["97 %", "97,25 %", "-1 %"], [97, 97.25, -1]),
    "percent in a comma file": (",", ["97 %", "97.125 %", "-1e2 %"], [97, 97.125, -100]),
    "thousandths or thousands of a unit": (";", ["97.125 %", "97.250 %", "97.375 %"], None),
    "two units": (",", ["5 kW", "500 W", "6 kW"], None),
    "a unit now and then": (",", ["5 kW", "6", "7 kW"], None),
    "minus": (",", ["\u22121.5", "2", "\u22120.25"], [-1.5, 2, -0.25]),
    "on": (",", ["ON", "OFF", "on"], [1, 0, 1]),
    "true": (",", ["true", "false", "True"], [1, 0, 1]),
    "on and true": (",", ["ON", "false", "ON"], None),
    "on and a number": (",", ["ON", "1", "OFF"], None),
    "English": (",", ['"35,010.5"', "998", '"1,234,567"'], [35010.5, 998, 1234567]),
    "German": (";", ["35.010,5", "998", "1.002"], [35010.5, 998, 1002]),
    "Swiss": (",", ["35'010.5", "998", "1'002"], [35010.5, 998, 1002]),
    "French": (";", ["35\u202f010,5", "998", "1\u00a0002"], [35010.5, 998, 1002]),
    "a word": (",", ["1", "Bad", "2"], None),
    "a power behind a space": (",", ["1.5 E3", "2 E3", "3 E3"], None),
    "a power in words": (",", ["1.5 x10^3", "2 x10^3", "3 x10^3"], None),
    "a sign behind a space": (",", ["1.5 -", "2 -", "3 -"], None),
    "cubic metres": (",", ["1.5 m3/h", "2 m3/h", "3 m3/h"], [1.5, 2, 3]),
}
THREE = PLANT.replace(inputs=["heater"], dt=60)


def small(cells, delimiter, more=()):
    lines = [delimiter.join(["time", "heater", "temp"])]
    lines += [delimiter.join([str(60 * k), "1", cell]) for k, cell in enumerate(cells)]
    return "\n".join([*lines, *more, ""])


@pytest.mark.parametrize("case", CELLS)
def test_a_column_is_read_where_all_its_cells_have_one_notation(tmp_path, case):
    delimiter, cells, numbers = CELLS[case]
    path = tmp_path / "run.csv"
    path.write_text(small(cells, delimiter), encoding="utf-8")
    frame = pd.DataFrame({"heater": 1.0, "temp": [cell.strip('"') for cell in cells]})
    if numbers is None:
        with pytest.raises(ValueError, match="row . of column 'temp' holds .* which is not a number"):
            jb.read(path, THREE)
        return
    run = jb.read(path, THREE)
    assert run.y[:, 0].tolist() == numbers and "column 'temp' is read as written, like" in " ".join(run.hints)
    live, said = from_pipe(path.read_bytes(), THREE, [])
    known = [k for k, time in enumerate(run.time) if time in live.time]  # of others a sentence says why
    assert live.y[:, 0].tolist() == [numbers[k] for k in known] and len(known) + len(said) == 3
    pipe = PipeText(THREE, print)
    pipe.take(path.read_bytes())
    again = PipeText(THREE, print, pipe.memory())  # another process goes on by the same notation
    piece = again.take(f"{180}{delimiter}1{delimiter}{cells[0]}\n".encode())
    assert known[0] or piece.y[:, 0].tolist() == numbers[:1]
    if delimiter == ",":
        assert Recording.of(THREE, frame).y[:, 0].tolist() == numbers


def test_a_format_that_is_stated_is_read_by_all_doors_and_kept_by_the_model_file(tmp_path):
    how = {"missing": "Bad,-999", "on": "open", "off": "shut", "comment": "//", "skip": "4"}
    model = THREE.replace(columns=with_format({}, how))
    text = "// pump 3\ntime,heater,temp\n0,open,1\n60,shut,77\n// a note\n"
    text += "120,open,Bad\n180,shut,-999.0\n240,open,2\n"
    path = tmp_path / "run.csv"
    path.write_text(text)
    run = jb.read(path, model)
    assert run.u[:, 0].tolist() == [1, 1, 0, 1] and run.time.tolist() == [0, 120, 180, 240]
    np.testing.assert_array_equal(run.y[:, 0], [1, np.nan, np.nan, 2])
    np.testing.assert_array_equal(jb.read(path, THREE, recording=how).y, run.y)
    np.testing.assert_array_equal(from_pipe(text.encode(), model, [9, 40])[0].y, run.y)
    frame = pd.DataFrame({"heater": ["open", "open"], "temp": ["Bad", -999.0]})
    assert np.isnan(Recording.of(model, frame).y).all()
    jb.save_model(model, tmp_path / "m.toml")
    with pytest.raises(ValueError, match="recording"):  # the checker that stands alone reads plain files
        read_model(tmp_path / "m.toml")
    again = jb.load_model(tmp_path / "m.toml")
    assert again == model and format_of(again).missing == ("Bad", "-999")
    with pytest.raises(ValueError, match="has no field 'decimals'"):
        jb.read(path, THREE, recording={"decimals": ","})


def test_words_for_on_and_off_are_no_numbers():
    sentence = "on of .recording. must be words: 2 is a number, read as it is; an expression like `pump - 1`"
    for how in ({"on": "2", "off": "1"}, {"on": ["open", 2.0], "off": ["shut"]}):
        with pytest.raises(ValueError, match=sentence.replace(" 2 ", " 2(.0)? ")):
            with_format({}, how)
    with pytest.raises(ValueError, match="off of .recording. must be words: 1 is a number"):
        with_format({}, {"on": "1", "off": "shut,1"})
    usual = format_of(THREE.replace(columns=with_format({}, {"on": "open,1", "off": "shut,0"})))
    assert usual.on == ("open", "1")


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be", "utf-16-le", "utf-32"])
def test_streams_in_two_bytes_a_letter_are_read_as_files_are(tmp_path, encoding):
    text = small(["20,5", "21,5", "22,5", "23,5"], ";").replace("heater", "Küche")
    mark = "" if encoding in ("utf-16", "utf-32") else "\ufeff"
    data = (mark + text).encode(encoding)
    model = THREE.replace(inputs=["Küche"])
    if "32" in encoding:
        model = model.replace(columns=with_format({}, {"encoding": encoding}))
    (tmp_path / "run.csv").write_bytes(data)
    run = jb.read(tmp_path / "run.csv", model)
    for cuts in ([], range(1, len(data)), [77]):
        live, said = from_pipe(data, model, cuts)
        assert live.y.tolist() == run.y.tolist() and said == [f"standard input: {run.hints[0]}"]
    for at in range(30, len(data), 7):  # a process that goes on, within a letter too, or begins again
        pipe = PipeText(model, print, taken=Taken(bytes))
        begun = pipe.take(data[:at])
        count = 0 if begun is None else begun.samples
        for rest in (data[at:], data) if count else ():
            kept = Taken(lambda pipe=pipe: bytes(pipe.taken.fresh))
            again = PipeText(model, lambda kind, sentence: None, pipe.memory(), kept)
            pieces = [again.take(rest[k : k + 5]) for k in range(0, len(rest), 5)]
            assert sum(piece.samples for piece in pieces if piece is not None) == 4 - count


def test_rows_of_one_time_and_blank_cells_are_read_as_stated(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time,heater,temp\n0,1,1\n0,1,2\n60,,3\n120,,4\n180,,5\n")
    for which, first in (("first", 1), ("last", 2)):
        run = jb.read(path, THREE, recording={"equal": which, "hold": "2min"})
        assert run.y[:, 0].tolist() == [first, 3, 4, 5] and "1 row" in f"1 row{run.hints}"
        np.testing.assert_array_equal(run.u[:, 0], [1, 1, 1, np.nan])
        assert "has the time of another row" in " ".join(run.hints)
    with pytest.raises(ValueError, match="hold of .recording. is for CSV files, not for a pipe"):
        PipeText(THREE.replace(columns=with_format({}, {"hold": "1min"})), print)


def test_clocks_of_a_zone_have_the_hours_of_that_zone(tmp_path):
    path = tmp_path / "run.csv"
    for begin, steps in (("2026-03-29 00:30", 6), ("2026-10-25 00:30", 6)):
        stamps = pd.date_range(begin, periods=steps, freq="1h", tz="Europe/Berlin").tz_localize(None)
        path.write_text("time,heater,temp\n" + "".join(f"{t},1,{k}\n" for k, t in enumerate(stamps)))
        hourly = THREE.replace(dt=3600)
        run = jb.read(path, hourly, recording={"zone": "Europe/Berlin"})
        assert np.diff(run.time).tolist() == [3600] * 5 and len(run.starts) == 0
        assert len(jb.read(path, hourly).starts) == 1  # without the zone the clock jumps
        zoned = hourly.replace(columns=with_format({}, {"zone": "Europe/Berlin"}))
        live, _ = from_pipe(path.read_bytes(), zoned, [30, 60, 90, 120])
        assert np.diff(live.time).tolist() == [3600] * 5


@pytest.mark.parametrize("zone", ["Europe/Berlin", "Australia/Lord_Howe"])
def test_a_stream_knows_the_hour_that_comes_twice(zone):
    begin = {"Europe/Berlin": "2026-10-24 23:20Z", "Australia/Lord_Howe": "2026-04-04 13:50Z"}[zone]
    stamps = pd.date_range(begin, periods=14, freq="10min").tz_convert(zone).tz_localize(None)
    assert not stamps.is_unique
    by_field = THREE.replace(dt=600, columns=with_format({}, {"zone": zone}))
    for model, name in ((by_field, ""), (THREE.replace(dt=600), f" {zone}")):
        text = "".join(f"{t:%Y-%m-%d %H:%M}{name},1,{k}\n" for k, t in enumerate(stamps))
        lines = f"time,heater,temp\n{text}".splitlines(keepends=True)
        pipe = PipeText(model, print)
        times = []
        for line in lines:
            piece = pipe.take(line.encode())
            pipe = PipeText(model, print, pipe.memory()) if piece else pipe  # another process goes on
            times += [] if piece is None else piece.time.tolist()
        assert times == [600.0 * k for k in range(14)]
        assert from_pipe("".join(lines).encode(), model, [200, 300])[0].time.tolist() == times


def test_named_zones_follow_each_other_when_the_clock_goes_forward(tmp_path):
    stamps = [
        "2026-03-29 01:58 CET",
        "2026-03-29 01:59 CET",
        "2026-03-29 03:00 CEST",
        "2026-03-29 03:01 CEST",
    ]
    (tmp_path / "run.csv").write_text("time,heater,temp\n" + "".join(f"{t},1,1.5\n" for t in stamps))
    run = jb.read(tmp_path / "run.csv", THREE)
    assert np.diff(run.time).tolist() == [60, 60, 60] and str(run.stamps[0]).startswith("2026-03-29T00:58")


def test_fit_keeps_the_order_of_day_and_month_for_a_day_that_does_not_show_it(tmp_path):
    rng = np.random.default_rng(5)
    runs = []
    for name, form in (("days", "%d/%m/%Y %H:%M"), ("plain", "%Y-%m-%d %H:%M")):
        rng = np.random.default_rng(5)
        u, y = samples(rng)
        t = [datetime.datetime(2026, 3, 2) + datetime.timedelta(hours=9 * k) for k in range(COUNT)]
        path = tmp_path / f"{name}.csv"
        rows = [f"{a:{form}},{b},{c}\n" for a, b, c in zip(t, u, y, strict=True)]
        path.write_text("time,heater,temp\n" + "".join(rows))
        runs.append(jb.fit(path, order=1, horizon=4, inputs=["heater"], outputs=["temp"]))
    ordered, plain = runs
    assert format_of(ordered).time_format == "%d/%m/%Y" and format_of(plain).stated == {}
    text = model_text(ordered.replace(columns=plain.columns))
    assert text == model_text(plain.replace(columns=plain.columns))
    (tmp_path / "day.csv").write_text(path.read_text()[:17] + "02/03/2026 10:00,1,1\n02/03/2026 19:00,1,1\n")
    assert str(jb.read(tmp_path / "day.csv", ordered).stamps[0]).startswith("2026-03-02")
    assert str(jb.read(tmp_path / "day.csv", plain).stamps[0]).startswith("2026-02-03")


DAY = datetime.timedelta(days=1)
ORDERS = {  # (format, begin, step, dt that is stated, the order that is taken, whether a sentence asks)
    "year first, one day": ("%y/%m/%d %H:%M", "2024-03-04", DAY / 1440, 60, "2004-03-24", True),
    "year first, past midnight": ("%y/%m/%d %H:%M", "2024-03-04", DAY / 12, 7200, "2024-03-04", False),
    "year first, points": ("%y.%m.%d %H:%M", "2024-03-04", DAY / 12, None, "2024-03-04", False),
    "year first, days": ("%y/%m/%d %H:%M", "2024-03-04", DAY, None, "2024-03-04", True),
    "days": ("%d/%m/%y %H:%M", "2024-03-02", DAY, None, "2024-03-02", True),
    "days, month first": ("%m/%d/%y %H:%M", "2024-03-02", DAY, None, "2024-03-02", True),
    "three orders": ("%y/%m/%d %H:%M", "2010-11-12", DAY / 1440, 60, "2012-10-11", True),
    "month first, a gap": ("%m/%d/%y %H:%M", "2024-03-02", DAY / 1440, None, "2024-03-02", True),
    "month first in one day": ("%d/%m/%Y %H:%M", "2024-03-04", DAY / 1440, 60, "2024-04-03", True),
}


@pytest.mark.parametrize("case", ORDERS)
def test_the_order_of_a_date_is_what_makes_equal_steps_or_a_sentence_asks(tmp_path, case):
    form, begin, step, dt, first, asks = ORDERS[case]
    stamps = [datetime.datetime.fromisoformat(f"{begin} 08:00") + k * step for k in range(9)]
    if "gap" in case:
        del stamps[5:7]
    path = tmp_path / "run.csv"
    path.write_text("time,heater,temp\n" + "".join(f"{t:{form}},1,{k}\n" for k, t in enumerate(stamps)))
    (run,) = read_signals(path, ["heater"], ["temp"], dt=dt)
    assert str(run.stamps[0])[:10] == first and run.dt == step.total_seconds()
    said = [hint for hint in run.hints if "could also be" in hint and "say which by time_format" in hint]
    assert len(said) == asks
    taken = run.taken.time_format
    assert taken and taken in form or asks
    if case == "three orders":
        assert "read as month/day/year; they could also be day/month/year or year/month/day: " in said[0]
        assert "time_format, like '%d/%m/%y'" in said[0]
    live, _ = from_pipe(path.read_bytes(), THREE.replace(dt=step.total_seconds()), [40, 90])
    assert np.diff(live.time).tolist() == np.diff(run.time).tolist()
    for order in ("%d/%m/%y", "%y/%m/%d"):
        if "days" not in case and form.startswith(order):
            (run,) = read_signals(
                path, ["heater"], ["temp"], {"[recording]": f'{{"time_format": "{order}"}}'}
            )
            assert str(run.stamps[0])[:10] == begin


def test_an_order_of_dates_that_nothing_shows_is_asked_for_where_it_sets_the_step(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time,heater,temp\n01/02/24 08:00,1,1\n02/02/24 08:00,1,2\n")
    with pytest.raises(ValueError, match="may be .*: say which by time_format, like '%d/%m/%y' .--recording"):
        read_signals(path, ["heater"], ["temp"])
    assert jb.read(path, THREE.replace(dt=86400)).dt == 86400
    with pytest.raises(ValueError, match="write the year first"):
        instant_of("24/03/04 08:00")


@pytest.mark.parametrize(
    "form",
    ["%Y-%m-%d %H:%M:%S", "%Y-%m-%d %H:%M", "%m/%d/%Y %H:%M", "%d.%m.%Y %I:%M %p", "%d-%b-%y %H:%M"],
)
def test_a_date_without_a_clock_is_midnight_where_it_follows_the_row_before(tmp_path, form):
    """Spreadsheets write midnight so, and footers the day on which they were written."""
    path, date = tmp_path / "run.csv", form.split()[0]
    stamps = [datetime.datetime(2026, 3, 13, 23, 57) + datetime.timedelta(minutes=k) for k in range(9)]
    cells = [f"{t:{date}}" if (t.hour, t.minute) == (0, 0) else f"{t:{form}}" for t in stamps]
    lines = ["time;heater;temp", *(f"{cell};1;{k}" for k, cell in enumerate(cells))]
    path.write_text("\n".join([*lines, ""]))
    run = jb.read(path, THREE)
    assert run.time.tolist() == [60.0 * k for k in range(9)] and not [h for h in run.hints if "clock" in h]
    footers = [
        *lines[:3],
        f"{stamps[-1]:{date}};7;7",
        *lines[3:],
        *(f"{stamps[0]:{date}};8;{k}" for k in "89"),
    ]
    path.write_text("\n".join([*footers, ""]))
    again = jb.read(path, THREE)
    assert again.y[:, 0].tolist() == list(range(9)) and again.time.tolist() == run.time.tolist()
    left = "3 rows have a date without a clock, the first is row 4: left out"
    assert [hint for hint in again.hints if "clock" in hint] == [left]
    for cuts in ([], range(30, len(path.read_bytes()), 25)):
        live, said = from_pipe(path.read_bytes(), THREE, cuts)
        assert live.time.tolist() == run.time.tolist() and live.y.tolist() == run.y.tolist()
        assert said == [f"line {n} has a date without a clock: left out" for n in (4, 12, 13)]
    said, pipe = [], PipeText(THREE, print, taken=Taken(bytes))
    pipe.take(path.read_bytes())
    kept = Taken(lambda: bytes(pipe.taken.fresh))
    sender = PipeText(THREE, lambda kind, sentence: said.append(sentence), pipe.memory(), kept)
    more = f"{stamps[-1] + datetime.timedelta(minutes=1):{form}};1;9\n"  # it begins again
    pieces = [sender.take(line.encode()) for line in [*path.read_text().splitlines(keepends=True), more]]
    assert [piece.y.tolist() for piece in pieces if piece is not None] == [[[9]]]
    assert said[-1] == "9 lines were judged before and are skipped"
    days = [f"{t:{date}};1;{k}" for k, t in enumerate([stamps[0] + k * DAY for k in range(9)])]
    path.write_text("\n".join([lines[0], *days, ""]))
    assert jb.read(path, THREE.replace(dt=86400)).samples == 9  # no row has a clock


def test_a_stream_below_many_lines_goes_on_without_losing_any(tmp_path):
    lines = [
        "Logger 7",
        "Serial 3",
        "time;heater;temp",
        "s;%;degC",
        *(f"{60 * k};1;{k},5" for k in range(60)),
    ]
    first, rest = "\n".join([*lines[:24], ""]), "\n".join([*lines[24:], ""])
    pipe = PipeText(THREE, print)
    begun = pipe.take(first.encode())
    again = PipeText(THREE, print, pipe.memory())
    piece = again.take(rest.encode())
    assert begun.y[:, 0].tolist() == [k + 0.5 for k in range(20)]
    assert piece.y[:, 0].tolist() == [k + 0.5 for k in range(20, 60)]


def test_a_stream_whose_columns_change_places_is_refused():
    rows = [f"{60 * k},1,{k}.5" for k in range(20)]
    with pytest.raises(
        ValueError, match="goes on with another header than before, time, temp, heater: choose"
    ):
        from_pipe(
            "\n".join(["time,heater,temp", *rows[:9], "time,temp,heater", *rows[9:], ""]).encode(), THREE, []
        )


@pytest.mark.parametrize("cuts", [[], range(20, 200, 7)])
def test_a_stream_takes_one_decimal_sign_in_a_column(cuts):
    cells = ["1.002", "998,5", *["7,5"] * 20]
    data = small(cells, ";").encode()
    run, said = from_pipe(data, THREE, cuts)
    assert run.y[:, 0].tolist() == [1.002] and len(said) >= 21  # and no 998.5 behind what may be 1002


DAYS = {
    "clock with dots": "%d/%m/%Y %H.%M.%S",
    "half days": "%d/%m/%Y %I:%M:%S%p",
    "plain": "%d/%m/%Y %H:%M",
    "two digits": "%d-%m-%Y %H:%M:%S",
    "zone": "%d/%m/%y %H:%M:%S UTC",
    "fraction": "%d/%m/%Y %H:%M:%S.000",
}


def on_days(form, begin, hours):
    """Return lines of a file, hours apart."""
    moments = [begin + datetime.timedelta(hours=hours * k) for k in range(40)]
    return [f"{moment:{form}},1,{k}.5\n" for k, moment in enumerate(moments)]


@pytest.mark.parametrize("form", DAYS.values(), ids=DAYS)
@pytest.mark.parametrize("begun", [3, 9])
def test_a_stream_keeps_the_order_of_day_and_month_that_midnight_showed(form, begun):
    hourly, head = PLANT.replace(dt=3600), "time,heater,temp\n"
    lines = on_days(form, datetime.datetime(2026, 3, 4, 22), 1)
    pipe = PipeText(hourly, print)
    first = pipe.take("".join([head, *lines[:begun]]).encode())
    again = PipeText(hourly, print, pipe.memory())  # by another process, too
    assert str(first.stamps[-1]).startswith("2026-03-05")
    for pieces in (pipe, again):
        second = pieces.take("".join(lines[begun : begun + 2]).encode())
        third = pieces.take("".join(lines[begun + 2 :]).encode())
        assert [str(stamp)[:10] for stamp in second.stamps] == ["2026-03-05"] * 2
        assert str(third.stamps[-1]).startswith("2026-03-06") and not len(third.starts)


def test_a_stream_says_when_the_order_of_day_and_month_shows():
    said = []
    pipe = PipeText(PLANT.replace(dt=3600), lambda kind, sentence: said.append(sentence))
    lines = on_days("%d/%m/%Y %H:%M", datetime.datetime(2026, 3, 4, 22), 1)
    pipe.take(("time,heater,temp\n" + lines[0]).encode())
    pipe.take("".join(lines[1:9]).encode())
    pipe.take("".join(lines[9:]).encode())
    assert "are read as month/day/year; they could also be day/month/year" in said[0]
    assert said[1:] == ["time stamps like '04/03/2026 23:00' show their order: they are day/month/year"]


@pytest.mark.parametrize("form", DAYS.values(), ids=DAYS)
def test_fit_keeps_the_order_of_day_and_month_of_each_form(tmp_path, form):
    path = tmp_path / "run.csv"
    path.write_text("time,heater,temp\n" + "".join(on_days(form, datetime.datetime(2026, 3, 2), 9)))
    run = jb.read(path, PLANT.replace(dt=9 * 3600))
    assert run.taken.time_format == form.partition(" ")[0]


def test_fit_keeps_no_order_of_day_and_month_that_is_a_guess(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(
        "time,heater,temp\n" + "".join(on_days("%d/%m/%Y %H:%M", datetime.datetime(2026, 3, 4), 0.5))
    )
    run = jb.read(path, PLANT.replace(dt=1800))
    assert run.taken.time_format == "" and "could also be day/month/year" in " ".join(run.hints)


def test_dates_of_which_only_the_first_has_one_order_are_asked_about(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(
        "time,heater,temp\n" + "".join(f"0{d}/03/2026 08:0{k},1,1\n" for d in (3, 4) for k in (0, 1))
    )
    assert "they could also be day/month/year" in " ".join(jb.read(path, PLANT).hints)


def test_rows_with_a_delimiter_more_may_have_others_between(tmp_path):
    path = tmp_path / "run.csv"
    rows = [f"{60 * k};1;{k},5;" for k in range(9)]
    path.write_text("\n".join(["time;heater;temp", *rows[:5], "time;heater;temp", *rows[5:], "Total: 9", ""]))
    run = jb.read(path, PLANT)
    assert run.samples == 9 and "row 7 repeats what stands above the samples: left out" in run.hints


def test_zero_bytes_in_a_file_of_windows_are_left_out(tmp_path):
    path = tmp_path / "run.csv"
    rows = [f"{60 * k};1;{k},5 °C\n" for k in range(9)]
    path.write_bytes("".join(["time;heater;temp\n", *rows[:5], "\0" * 512, "\n", *rows[5:]]).encode("cp1252"))
    run = jb.read(path, PLANT)
    assert run.samples == 9 and "row 7 holds zero bytes, as a power cut leaves them: left out" in run.hints


def test_a_row_of_other_length_is_named_beside_columns_in_another_notation(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time,heater,temp\n0,1,5 kW\n60,1,6 kW,7\n120,1,7 kW\n")
    with pytest.raises(ValueError, match="row 3 has 4 cells, the header has 3 columns"):
        jb.read(path, PLANT)


@pytest.mark.parametrize("how", [{"thousands": "."}, {"decimal": ","}])
def test_a_table_of_texts_is_read_by_the_signs_that_are_stated(how):
    model = PLANT.replace(columns=with_format({}, how))
    frame = pd.DataFrame({"heater": ["1", "2"], "temp": ["34.900", "1.234.567"]})
    assert Recording.of(model, frame).y[:, 0].tolist() == [34900, 1234567]
    frame = pd.DataFrame({"heater": ["1", "2"], "temp": ["34.900", "34.9"]})
    with pytest.raises(ValueError, match="column 'temp' holds '34.900', which is not a number"):
        Recording.of(model, frame)


def test_tables_of_texts_may_lack_samples_and_be_categories():
    cells = ["34,5 kW", "", "NaN", "#N/A", "34,25 kW"]
    for kind in (object, "category"):
        frame = pd.DataFrame({"heater": ["1", "null", "1", "", "1"], "temp": pd.Series(cells, dtype=kind)})
        run = Recording.of(PLANT, frame)
        np.testing.assert_array_equal(run.y[:, 0], [34.5, np.nan, np.nan, np.nan, 34.25])
        np.testing.assert_array_equal(run.u[:, 0], [1, np.nan, 1, np.nan, 1])
        assert "one cell of column 'temp' holds an error of a spreadsheet" in " ".join(run.hints)
    stated = PLANT.replace(columns=with_format({}, {"thousands": "."}))
    frame = pd.DataFrame({"heater": 1.0, "temp": pd.Categorical(["34.900", "1.000"])})
    assert Recording.of(stated, frame).y[:, 0].tolist() == [34900, 1000]

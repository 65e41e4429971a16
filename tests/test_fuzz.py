"""Nothing that a user can give ends with exit code 70: files that are none, fields of every type, names of
every kind.

Most of it is refused before anything is compiled. Every refusal is one sentence of bearable length without
control characters.
"""

import os
import random
import tempfile
import zlib

import pytest

from jaxbound.cli import main
from jaxbound.models.modelfile import template

HEAD = "time,Pump [%],level,flow\n"
ROWS = "".join(f"{k},50,{1 + k / 100},{0.1 * k}\n" for k in range(6))
VALUES = [
    "0",
    "-1",
    "1.5",
    "nan",
    "-inf",
    "1e400",
    "1e-400",
    "9" * 400,
    "9" * 5000,
    "true",
    '""',
    '"x"',
    '"=1+1"',
    '"1/0"',
    "[]",
    "[[]]",
    "[[1, 2]]",
    "[[[1]]]",
    "[1]",
    "{}",
    "{name = 1}",
    '["a", "a"]',
    '[{name = "a"}]',
    "1979-05-27",
    "[[1], [1, 2]]",
    '"\\u001b[2J"',
    '"\\u0000"',
    '"$x_"',
    "0x10",
    '[["1", "x"]]',
    "[true]",
    '"' + "n" * 5000 + '"',
]
FIELDS = [
    "name",
    "dt",
    "horizon",
    "time",
    "where",
    "constant_tolerance",
    "states",
    "inputs",
    "outputs",
    "disturbances",
    "uncertainty",
    "decouple",
    "matrices",
    "provenance",
    "unknown",
]
INNER = [
    "name",
    "unit",
    "column",
    "offset",
    "tolerance",
    "noise",
    "resolution",
    "bound",
    "varying",
    "between",
    "A",
    "B",
    "C",
    "D",
    "G",
    "F",
    "D_v",
    "E",
]
BYTES = [
    b"",
    b"\0",
    b"\n\n\n",
    b"\xef\xbb\xbf",
    b"\xff\xfea\0",
    b"\xfe\xff\0a",
    b"PAR1",
    b"PAR1" + b"x" * 40 + b"PAR1",
    b"\x1f\x8b\x08",
    b"PK\x03\x04",
    b"time,level\r\r\n1\r2",
    b'"',
    b'"time',
    b'a,b\n"1,2\n3,4\n',
    b"\x80\x81\x82",
    b"time,level,flow,Pump [%]\n",
    b"sep=;\n",
    b"sep=;\ntime;level\n1;2",
    b",,,,\n1,2,3,4,5\n",
    b"level,level,flow,Pump [%]\n1,2,3,4\n1,2,3,4\n",
    b"1,2,3\n4,5,6\n",
    b"\n" * 300_000 + b"a,b\n1,2\n",
    b"x" * 300_000,
    b"=1+1,@x\n1,2\n3,4\n",
    b"\x1b[2Jtime,a\n1,2\n3,4\n",
    HEAD.encode() + b"0,1,2,3\n0,1,2,3\n",
    HEAD.encode() + b"0,1,2,3\n1,1,2," + b"9" * 100_000 + b"\n",
    HEAD.encode() + b"0,1,2,3\n1,1,2\n",
    HEAD.encode() + b"2017-01-01,1,2,3\n2017-13-41,1,2,3\n",
    HEAD.encode() + b"0,a,b,c\n1,d,e,f\n",
    HEAD.encode() + b"0,1,2,inf\n1,1,2,3\n",
    HEAD.encode() + b"0,,,\n1,,,\n",
    HEAD.encode().decode().encode("utf-16"),
    HEAD.encode() + b"\xff\xff\xff\n",
    HEAD.encode() + b"1e400,1,2,3\n2,1,2,3\n",
    HEAD.encode() + b"0,1,2," + b'"' + b"x" * 200_000 + b'"\n1,1,2,3\n',
    b"c" + b",c" * 50_000 + b"\n1" + b",1" * 50_000 + b"\n",
]


def refused(capsys, args):
    """Run a command; say that it ended in a sentence, or in a verdict."""
    code = main.main([os.fspath(a) for a in args])
    out, err = capsys.readouterr()
    assert code in (0, 1, 2, 3), (args, code, err)
    if code == 2:
        assert 10 < len(err) < 2300 and err.startswith("jaxbound: "), (args, err[:300])
    assert not any(ord(c) < 32 and c != "\n" or 127 <= ord(c) < 160 for c in out + err), (
        args,
        repr(err[:300]),
    )
    return code


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    (folder / "m.toml").write_text(template())
    (folder / "r.csv").write_text(HEAD + ROWS)
    return folder


@pytest.mark.parametrize("data", BYTES, ids=lambda b: f"{b[:12]!r}-{len(b)}")
def test_any_bytes_as_a_recording_are_refused_in_a_sentence(here, capsys, data):
    (here / "x.csv").write_bytes(data)
    assert refused(capsys, ["detect", here / "m.toml", here / "x.csv", "--out", here / "out"]) == 2
    assert (
        refused(
            capsys,
            [
                "fit",
                here / "x.csv",
                "--outputs",
                "level",
                "--recipe",
                "order=1,horizon=3",
                "--out",
                here / "f.toml",
            ],
        )
        == 2
    )


@pytest.mark.parametrize("data", BYTES[:20], ids=lambda b: f"{b[:12]!r}-{len(b)}")
def test_any_bytes_as_a_model_or_manifest_or_parquet_are_refused_in_a_sentence(here, capsys, data):
    for name in ("x.toml", "x.parquet", "manifest.csv"):
        (here / name).write_bytes(data)
    assert refused(capsys, ["info", here / "x.toml"]) == 2
    assert refused(capsys, ["detect", here / "m.toml", here / "x.parquet", "--out", here / "out"]) == 2
    assert refused(capsys, ["fleet", here / "manifest.csv", "--out", here / "out"]) == 2
    assert refused(capsys, ["fleet", here / "x.toml", "--out", here / "out"]) == 2


def models(seed, count):
    """Yield model files with one field, somewhere, of a type or size of its own."""
    draw = random.Random(seed)
    lines = template().split("\n")
    for _ in range(count):
        changed = list(lines)
        where = [i for i, line in enumerate(changed) if "=" in line and not line.startswith("#")]
        for _ in range(draw.choice((1, 1, 1, 2))):
            i = draw.choice(where)
            key = draw.choice((changed[i].split("=")[0].strip(), draw.choice(INNER), draw.choice(FIELDS)))
            changed[i] = f"{key} = {draw.choice(VALUES)}"
        yield "\n".join(changed)


def test_model_files_with_any_field_of_any_type_give_a_page_or_a_sentence(here, capsys, request):
    for text in models(zlib.crc32(request.node.name.encode()), 120):
        (here / "x.toml").write_text(text)
        refused(capsys, ["info", here / "x.toml"])


@pytest.mark.parametrize(
    "text", ["x = " + "[" * 2000, "a" + ".a" * 1000 + " = 1", "dt = " + "9" * 5000, "[" * 300, "dt = 1\n" * 2]
)
def test_model_files_nested_or_long_without_end_are_refused_in_a_sentence(here, capsys, text):
    (here / "x.toml").write_text(text)
    assert refused(capsys, ["info", here / "x.toml"]) == 2
    assert refused(capsys, ["fleet", here / "x.toml", "--out", here / "out"]) == 2


def parquet(path, columns):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table(columns), path)


def odd_columns():
    """Yield columns of 6 samples that are no plain numbers."""
    import datetime
    import decimal

    import pyarrow as pa

    yield "null", pa.nulls(6)
    yield "nested", pa.array([[1.0]] * 6)
    yield "struct", pa.array([{"a": 1}] * 6)
    yield "map", pa.array([[("a", 1)]] * 6, pa.map_(pa.string(), pa.int64()))
    yield "dictionary of texts", pa.array(["a", "b"] * 3).dictionary_encode()
    yield "dictionary of numbers", pa.array([1.0, 2.0] * 3).dictionary_encode()
    yield "decimal", pa.array([decimal.Decimal("1.5")] * 6)
    yield "decimal of 76 digits", pa.array([decimal.Decimal("9" * 60)] * 6, pa.decimal256(76, 2))
    yield "time stamps", pa.array([datetime.datetime(2020, 1, 1)] * 6)
    yield "date", pa.array([datetime.date(2020, 1, 1)] * 6)
    yield "time of day", pa.array([datetime.time(1)] * 6)
    yield "duration", pa.array([datetime.timedelta(1)] * 6)
    yield "bytes", pa.array([b"x"] * 6)
    yield "bool", pa.array([True, False] * 3)
    yield "half", pa.array([1.0] * 6).cast(pa.float16())
    yield "large whole numbers", pa.array([2**63 - 1] * 6)
    yield "unsigned", pa.array([2**64 - 1] * 6, pa.uint64())
    yield "texts", pa.array(["1", "2"] * 3)
    yield "large texts", pa.array(["1", "2"] * 3, pa.large_string())
    yield "infinite", pa.array([float("inf")] * 6)
    yield "missing", pa.array([float("nan")] * 6)


@pytest.mark.parametrize("role", ["time", "level", "Pump [%]"])
def test_parquet_with_columns_of_any_type_is_read_or_refused_in_a_sentence(here, role):
    from jaxbound.models.modelfile import load_model
    from jaxbound.recordings.read import read

    model, refused = load_model(here / "m.toml"), []
    for name, column in odd_columns():
        plain = {"time": list(range(6)), "Pump [%]": [50.0] * 6, "level": [1.0] * 6, "flow": [0.5] * 6}
        parquet(here / "odd.parquet", plain | {role: column})
        try:
            read(here / "odd.parquet", model)
        except ValueError as e:
            refused.append(name)
            assert 20 < len(str(e)) < 2000, name
    assert "bytes" in refused


def test_paths_that_are_no_files_are_refused_in_a_sentence(here, capsys):
    folder, file = here / "folder", here / "r.csv"
    folder.mkdir(exist_ok=True)
    m = here / "m.toml"
    strange = [
        folder,
        here / "none",
        file / "below",
        "/dev/null",
        "",
        "\0",
        here / b"\xff\xfe.csv".decode("utf-8", "surrogateescape"),
        "n" * 5000,
    ]
    for path in strange:
        for args in (
            ["info", path],
            ["detect", path, file, "--out", here / "o"],
            ["detect", m, path, "--out", here / "o"],
            ["fleet", path, "--out", here / "o"],
            ["tune", m, path, "--out", here / "t.toml"],
            ["tune", path, file, "--out", here / "t.toml"],
            ["explain", path, "--at", "1"],
            ["fit", path, "--outputs", "level", "--out", here / "f.toml"],
            ["study", path, "--faults", "y1:bias", "--out", here / "o"],
        ):
            assert refused(capsys, args) == 2, args


def test_options_of_any_size_are_refused_in_a_sentence(here, capsys):
    m, r, endless = here / "m.toml", here / "r.csv", "9" * 30
    for option in (["--test", f"horizon={endless}"], ["--chunk", endless], ["--alarm", f"hold={endless}"]):
        assert refused(capsys, ["detect", m, r, "--out", here / "o", *option]) == 2
    for option, value in (
        ("--test", f"horizon={endless}"),
        ("--steps", "x"),
        ("--safety", "nan"),
        ("--calibrate", "2"),
        ("--optimizer", endless),
    ):
        assert refused(capsys, ["tune", m, r, "--out", here / "t.toml", option, value]) == 2
    for option, value in (
        ("--recipe", f"order={endless}"),
        ("--recipe", f"horizon={endless}"),
        ("--dt", "-1"),
        ("--dt", "nan"),
        ("--safety", "inf"),
        ("--where", "(" * 300),
    ):
        assert refused(capsys, ["fit", r, "--outputs", "level", "--out", here / "f.toml", option, value]) == 2
    for option, value in (
        ("--scenario", f"samples={endless}"),
        ("--sizes", f"0:1:{endless}"),
        ("--test", f"horizon={endless}"),
        ("--scenario", "onset=nan:1"),
        ("--scenario", "input_range=inf:1"),
        ("--faults", "x" * 100_000),
        ("--scenario", "at=\x1b[2J"),
        ("--scenario", "hold=0"),
    ):
        assert (
            refused(capsys, ["study", m, "--faults", "level:bias", "--out", here / "s", option, value]) == 2
        )
    assert refused(capsys, ["info", m, "--test", f"horizon={endless}"]) == 2
    assert refused(capsys, ["explain", here, "--at", endless]) == 2
    assert refused(capsys, ["\x1b[2J" * 1000]) == 2


@pytest.mark.long(by_day="test_model_files_with_any_field_of_any_type_give_a_page_or_a_sentence")
def test_many_more_model_files_and_recordings_give_a_page_or_a_sentence(here, capsys, request):
    draw = random.Random(zlib.crc32(request.node.name.encode()))
    for text in models(draw.random(), 3000):
        (here / "x.toml").write_text(text)
        refused(capsys, ["info", here / "x.toml"])
    whole = (HEAD + ROWS).encode()
    for _ in range(3000):
        data = bytearray(whole)
        for _ in range(draw.randint(1, 20)):
            i = draw.randrange(len(data))
            data[i : i + draw.randint(0, 3)] = bytes(
                draw.choice((0, 9, 10, 13, 34, 44, 59, 61, draw.randrange(256)))
                for _ in range(draw.randint(0, 3))
            )
        with tempfile.NamedTemporaryFile(suffix=".csv") as f:
            f.write(data), f.flush()
            refused(capsys, ["detect", here / "m.toml", f.name, "--out", here / "out", "--test", "horizon=2"])

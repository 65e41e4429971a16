"""Model files: exact round trips, and a sentence for everything that is wrong."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from systems import paper

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.exact import linalg
from jaxbound.models.modelfile import load_model, number_text, save_model, template

GOOD = """
name = "tank"
dt = 0.5
states = ["level"]
[[inputs]]
name = "pump"
[[outputs]]
name = "height"
noise = 0.1
[matrices]
A = [[0.9]]
B = [[0.1]]
C = [[1]]
"""


def stated(field):
    """Return a table of a test with this field, and the head of the next table."""
    return f'[[test]]\nname = "slow"\n{field}\n[matrices]'


@pytest.fixture
def load(tmp_path):
    """Return a function that loads a model from text."""

    def loaded(text, data=None):
        path = tmp_path / "m.toml"
        path.write_bytes(text.encode() if data is None else data)
        return load_model(path)

    return loaded


numbers = st.one_of(
    st.fractions(),
    st.decimals(allow_nan=False, allow_infinity=False, places=9),
    st.floats(allow_nan=False, allow_infinity=False),
)
words = st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), min_size=1, max_size=12)
small = st.fractions(min_value=0, max_value=Fraction(999, 1000))


class TestRoundTrip:
    @given(numbers)
    def test_a_number_reads_back_exactly(self, x):
        exact = Fraction(repr(x)) if isinstance(x, float) else Fraction(x)
        assert Fraction(number_text(exact)) == exact

    @settings(deadline=None, max_examples=20)
    @given(st.data())
    def test_any_model_reads_back_exactly(self, tmp_path_factory, data):
        n, m, p, g = (data.draw(st.integers(low, 3)) for low in (1, 0, 1, 0))
        bound = lambda: data.draw(
            st.one_of(st.tuples(numbers, numbers).map(lambda b: sorted(b, key=linalg.rational)), small)
        )
        matrix = lambda rows, columns: [[data.draw(numbers) for _ in range(columns)] for _ in range(rows)]
        names = data.draw(st.lists(words, min_size=n + m + p, max_size=n + m + p, unique=True))
        inputs, outputs, states = names[:m], names[m : m + p], names[m + p :]
        about = lambda keys: {k: data.draw(words) for k in keys if data.draw(st.booleans())}
        model = jb.LinearSystem(
            matrix(n, n),
            matrix(n, m) if m else None,
            matrix(p, n),
            matrix(p, m) if m else None,
            data.draw(st.floats(1e-6, 1e6)),
            inputs=inputs,
            outputs=outputs,
            states=states,
            name=data.draw(words),
            tolerance=[data.draw(small) for _ in range(p)],
            noise=[abs(data.draw(numbers)) for _ in range(p)],
            resolution=[data.draw(small) for _ in range(p)],
            offset={"u": [data.draw(numbers) for _ in range(m)], "y": [data.draw(numbers) for _ in range(p)]},
            units=about(names),
            columns={k: c.replace("=", "-") for k, c in about([*inputs, *outputs, "time"]).items()},
            provenance=about(["model", "noise", "tolerance", "resolution", "disturbance"]),
            constant_tolerance=data.draw(st.booleans()),
            disturbance=(matrix(n, g), [bound() for _ in range(g)]) if g else None,
            horizon=data.draw(st.one_of(st.none(), st.integers(0, 99))),
        )
        path = tmp_path_factory.mktemp("model") / "m.toml"
        save_model(model, path)
        assert load_model(path) == model

    def test_the_paper_reads_back_exactly(self, tmp_path):
        save_model(paper(), tmp_path / "m.toml")
        assert load_model(tmp_path / "m.toml") == paper()

    def test_decimals_and_fractions_are_exact(self, load):
        m = load(
            GOOD.replace("A = [[0.9]]", 'A = [["1/3"]]').replace(
                "noise = 0.1", "noise = 0.1000000000000000000000000001"
            )
        )
        assert m.A == ((Fraction(1, 3),),) and m.noise == (Fraction(1, 10) + Fraction(1, 10**28),)


class TestTemplate:
    def test_underscores_of_toml_stand_in_its_numbers(self, load):
        m = load(GOOD.replace("A = [[0.9]]", "A = [[1_0.0_1]]").replace("noise = 0.1", "noise = 1_0"))
        assert m.A == ((Fraction(1001, 100),),) and m.noise == (10,)

    def test_loads_as_it_is(self, load):
        m = load(template())
        assert m.inputs == ("pump",) and m.column("pump") == "Pump [%]" and m.tolerance[0] == Fraction(1, 100)

    def test_mentions_every_field(self):
        for field in (
            "name",
            "dt",
            "horizon",
            "time",
            "states",
            "unit",
            "column",
            "offset",
            "tolerance",
            "noise",
            "resolution",
            "[matrices]",
            "D",
            "G",
            "[[disturbances]]",
            "bound",
            "[provenance]",
        ):
            assert field in template()

    def test_info_shows_its_disturbance_and_each_relation_once(self, tmp_path, monkeypatch, capsys):
        monkeypatch.setattr(main, "_configure", lambda: None)
        (tmp_path / "m.toml").write_text(template())
        assert main.main(["info", str(tmp_path / "m.toml"), "--test", "horizon=6"]) == 0
        out = " ".join(capsys.readouterr().out.split())
        assert (
            "disturbance w1 in [0, 0.001] (assumed)" in out and out.count("w1[") == 1 and "the 2 below" in out
        )

    def test_gives_relations(self, load):
        assert jb.parity_relations(load(template())).count > 0


class TestReading:
    def test_offsets_units_columns_and_time(self, load):
        text = GOOD.replace('name = "pump"', 'name = "pump"\nunit = "%"\noffset = 50\ncolumn = "Pump [%]"')
        m = load('time = "Zeit"\n' + text)
        assert (
            m.unit("pump") == "%"
            and m.offset["u"] == (50,)
            and m.column("pump") == "Pump [%]"
            and m.columns["time"] == "Zeit"
        )

    @pytest.mark.parametrize("horizon", ["1.5", "-1", '"15"', "true"])
    def test_a_horizon_is_a_whole_number(self, load, horizon):
        assert load("horizon = 15\n" + GOOD).horizon == 15
        with pytest.raises(ValueError, match=r"m.toml: horizon must be a whole number >= 0"):
            load(f"horizon = {horizon}\n" + GOOD)

    def test_ranges_of_inputs_are_kept_exactly(self, load, tmp_path):
        m = load(GOOD.replace('name = "pump"', 'name = "pump"\nrange = [0.1, "1/3"]'))
        assert (
            m.ranges == {"pump": (Fraction("0.1"), Fraction(1, 3))}
            and m.replace(noise=0.2).ranges == m.ranges
        )
        save_model(m, tmp_path / "again.toml")
        assert load_model(tmp_path / "again.toml") == m

    def test_states_may_have_units(self, load):
        assert load(GOOD.replace('["level"]', '[{name = "level", unit = "m"}]')).unit("level") == "m"

    def test_signals_may_go_unnamed(self, load):
        m = load("dt = 1\n[matrices]\nA = [[0.9]]\nB = [[1]]\nC = [[1]]\n")
        assert (m.inputs, m.outputs, m.states, m.name) == (("u1",), ("y1",), ("x1",), "model")

    def test_no_inputs(self, load):
        assert load("dt = 1\n[matrices]\nA = [[0.9]]\nC = [[1]]\n").m == 0

    def test_disturbances(self, load):
        text = GOOD.replace("A = [[0.9]]", 'A = [[0.9]]\nG = [[1, "1/3"]]')
        m = load(f"{text}\n[[disturbances]]\nbound = 0.1\n[[disturbances]]\nbound = [0, 0.25]\n")
        assert m.G == ((1, Fraction(1, 3)),) and m.disturbance == (
            (Fraction(-1, 10), Fraction(1, 10)),
            (0, Fraction(1, 4)),
        )

    def test_byte_order_mark_and_windows_lines(self, load):
        assert load("", b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode()).outputs == ("height",)

    def test_a_planned_field_may_say_no(self, load):
        assert load("constant_tolerance = false\ndecouple = []\n" + GOOD).n == 1


@pytest.mark.parametrize(
    "old, new, message",
    [
        ('name = "tank"', 'nmae = "tank"', "the model has the unknown field 'nmae'; did you mean 'name'?"),
        (
            "noise = 0.1",
            "constant_tolerance = true",
            "number 1 of outputs, 'height', has the unknown field 'constant_tolerance'",
        ),
        (
            "noise = 0.1",
            "nose = 0.1",
            "number 1 of outputs, 'height', has the unknown field 'nose'; did you mean 'noise'?",
        ),
        (
            'name = "pump"',
            'name = "pump"\ntolerance = 0.1',
            "number 1 of inputs, 'pump', has the unknown field 'tolerance'",
        ),
        (
            'name = "pump"',
            'name = "pump"\nrange = 3',
            r"range of number 1 of inputs, 'pump' must be \[lowest, highest\]",
        ),
        (
            'name = "pump"',
            'name = "pump"\nrange = [3, 2]',
            r"the range of 'pump' needs lo <= hi, not \[3, 2\]",
        ),
        ("C = [[1]]", "C = [[1]]\nH = [[1]]", r"\[matrices\] has the unknown field 'H'"),
        ("C = [[1]]", "C = [[1]]\nG = [[1]]", r"a disturbance needs both G .* the blocks are missing"),
        (
            "[matrices]",
            "[[disturbances]]\nbound = 1\n[matrices]",
            r"a disturbance needs both G .*: G is missing",
        ),
        ("[matrices]", "[[disturbances]]\n[matrices]\nG = [[1]]", "number 1 of disturbances needs a bound"),
        (
            "[matrices]",
            "[[disturbances]]\nbond = 1\n[matrices]\nG = [[1]]",
            "unknown field 'bond'; did you mean 'bound'",
        ),
        (
            "[matrices]",
            "[[disturbances]]\nbound = -1\n[matrices]\nG = [[1]]",
            "disturbance 1: the bound must be >= 0, not -1",
        ),
        (
            "[matrices]",
            "[[disturbances]]\nbound = [2, 1]\n[matrices]\nG = [[1]]",
            r"disturbance 1: lo must be <= hi, not \[2, 1\]",
        ),
        (
            "[matrices]",
            "[[disturbances]]\nbound = [1, 2, 3]\n[matrices]\nG = [[1]]",
            "disturbance 1: a bound is one number or a pair",
        ),
        (
            "[matrices]",
            "[[disturbances]]\nbound = nan\n[matrices]\nG = [[1]]",
            "disturbance 1: 'nan' is not a finite number",
        ),
        (
            "[matrices]",
            "[[disturbances]]\nbound = true\n[matrices]\nG = [[1]]",
            "bound of number 1 of disturbances must be a number",
        ),
        (
            "[matrices]",
            "[[disturbances]]\nbound = 1\n[matrices]\nG = [[1, 2]]",
            "one .* for each of 2 columns of G, not 1",
        ),
        (
            "[matrices]",
            "[[disturbances]]\nbound = 1\n[matrices]\nG = [[1], [2]]",
            r"G of the disturbance needs one row per state \(1\)",
        ),
        ("[matrices]", "[[disturbances]]\nbound = 1\n[matrices]\nG = [1]", "G must be a list of rows"),
        (
            "[matrices]",
            "[disturbances]\nbound = 1\n[matrices]\nG = [[1]]",
            r"disturbances must be a list: write \[\[disturbances\]\]",
        ),
        (
            "[matrices]",
            '[provenance]\nnoises = "x"\n[matrices]',
            r"\[provenance\] has the unknown field 'noises'; did you mean 'noise'",
        ),
        ("[matrices]", "[matrix]", r"unknown field 'matrix'; did you mean 'matrices'\?"),
        ("A = [[0.9]]", "A = [[0.9, 1]]", r"A must be square, one row per state: its shape is \(1, 2\)"),
        ("A = [[0.9]]", "A = [[0.9], [1, 2]]", "A: rows have different lengths"),
        ("A = [[0.9]]", "A = [0.9]", "A must be a list of rows"),
        ("A = [[0.9]]", "A = [[true]]", "A must be a number, not True"),
        ("A = [[0.9]]", 'A = [["fast"]]', "'fast' is not a finite number"),
        (
            "A = [[0.9]]",
            "A = [[1e999999999]]",
            "A is 1e999999999, which is too large or too small to compute with",
        ),
        ("A = [[0.9]]", "A = [[1e-330]]", "too large or too small to compute with"),
        ("A = [[0.9]]", "A = [[2e308]]", "too large or too small to compute with"),
        ("A = [[0.9]]", 'A = [["1/0"]]', "'1/0' is not a finite number"),
        ("A = [[0.9]]", "A = [[inf]]", "'inf' is not a finite number"),
        ("A = [[0.9]]", "", r"\[matrices\] needs A"),
        ("B = [[0.1]]", "B = [[0.1, 1]]", "inputs needs 2 names, one for each: 1 given"),
        ("B = [[0.1]]", "B = [[0.1], [1]]", r"B must have shape \(1, 1\)"),
        ("C = [[1]]", "C = []", "the model has no output"),
        ("C = [[1]]", "C = [[1, 2]]", r"C must have shape"),
        ("noise = 0.1", "noise = -0.1", "noise must be >= 0: output 'height' has -0.1"),
        ("noise = 0.1", "tolerance = 1.0", "tolerance is relative and must be below 1"),
        ("noise = 0.1", "noise = nan", "noise of 'height'.*not a finite number"),
        ("noise = 0.1", "noise = [0.1]", "noise of number 1 of outputs, 'height' must be a number"),
        ("noise = 0.1", "noise = 1979-05-27", "must be a number"),
        ("noise = 0.1", 'noise = "1_0"', "noise of 'height': '1_0' is not a finite number"),
        ("noise = 0.1", 'noise = "1e1_0"', "'1e1_0' is not a finite number"),
        ("noise = 0.1", 'noise = "\u0661\u0660"', "'\u0661\u0660' is not a finite number"),
        ("A = [[0.9]]", 'A = [["1/\u0663"]]', "A: '1/\u0663' is not a finite number"),
        ("dt = 0.5", 'dt = "\uff11"', "dt: '\uff11' is not a finite number"),
        ("[matrices]", stated("factor = true"), "factor of test 'slow' must be a number, not True"),
        ("[matrices]", stated('factor = "1_0"'), "factor of test 'slow': '1_0' is not a finite number"),
        ("[matrices]", stated(f"factor = {'9' * 400}"), "factor of test 'slow' is 9+, which is too large"),
        ("[matrices]", stated('observer = "joint"\nweight = [true]'), "weight .* a number, not True"),
        ("dt = 0.5", "dt = 0", "dt must be a positive number"),
        ("dt = 0.5", f"dt = {'9' * 400}", "dt is 9+, which is too large or too small"),
        ("dt = 0.5", "", "dt is missing"),
        ("dt = 0.5", "dt = 1 2", r"not valid TOML: .*line 3"),
        ("dt = 0.5", "dt = 0,5  # s", r"not valid TOML: .*line 3.*; write 0.5 with a point"),
        ('"tank"', '"tank', r"not valid TOML: .*line 2"),
        ('"tank"', "7", "name must be text in quotes, not 7"),
        ('name = "pump"', 'unit = "%"', "number 1 of inputs needs a name"),
        ("[[inputs]]", "[inputs]", r"inputs must be a list: write \[\[inputs\]\] above each"),
        ("[matrices]", "[[matrices]]", r"\[matrices\] must be a table"),
        ('states = ["level"]', 'states = ["level", "flow"]', "states needs 1 names, one for each: 2 given"),
        ('name = "height"', 'name = "pump"', "'pump' is used twice"),
    ],
)
def test_what_is_wrong_is_said(load, old, new, message):
    assert old in GOOD
    with pytest.raises(ValueError, match=message) as caught:
        load(GOOD.replace(old, new, 1))
    assert "m.toml: " in str(caught.value) and "\n" not in str(caught.value)


def test_files_that_are_none(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no model file"):
        load_model(tmp_path / "none.toml")
    with pytest.raises(IsADirectoryError, match="is a folder"):
        load_model(tmp_path)
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="not a text file in UTF-8"):
        load_model(tmp_path / "b.toml")


def test_save_needs_a_model(tmp_path):
    with pytest.raises(TypeError, match="save_model needs a LinearSystem, not ndarray"):
        save_model(np.eye(2), tmp_path / "m.toml")
    with pytest.raises(OSError):
        save_model(paper(), tmp_path / "none" / "m.toml")


def test_a_recording_in_place_of_a_model_is_told(tmp_path):
    for name, content in (("run.csv", b"t,u1\n0,1\n"), ("run.parquet", b"PAR1\xff\xfe")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match="it looks like a recording: the model comes first"):
            load_model(tmp_path / name)


def test_an_empty_recording_in_the_place_of_a_model_is_named_as_one(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("")
    with pytest.raises(ValueError, match="it looks like a recording: the model comes first"):
        jb.load_model(path)

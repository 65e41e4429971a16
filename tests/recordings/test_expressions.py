"""Expressions over columns: what they compute is what pandas computes, and they compute nothing else."""

import re
import warnings

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.recordings.expressions import expression, find_column, is_expression

ARITHMETIC = ["+", "-", "*", "/", "//", "%", "**"]
FUNCTIONS = ["abs", "sqrt", "exp", "log", "sin", "arctan", "floor"]


def term(rng, depth, columns):
    kind = rng.integers(4) if depth else 3
    if kind == 0:
        return f"({term(rng, depth - 1, columns)} {rng.choice(ARITHMETIC)} {term(rng, depth - 1, columns)})"
    if kind == 1:
        return f"{rng.choice(FUNCTIONS)}({term(rng, depth - 1, columns)})"
    if kind == 2:
        return f"(-{term(rng, depth - 1, columns)})"
    return rng.choice([*columns, "2.5", "3", "1e-1"])


def condition(rng, depth, columns):
    kind = rng.integers(4) if depth else 3
    if kind == 0:
        return (
            f"({condition(rng, depth - 1, columns)} {rng.choice(['and', 'or', '&', '|'])} "
            f"{condition(rng, depth - 1, columns)})"
        )
    if kind == 1:
        return f"(not {condition(rng, depth - 1, columns)})"
    if kind == 2:
        return f"({term(rng, 1, columns)} < {term(rng, 1, columns)} <= {term(rng, 1, columns)})"
    return (
        f"({term(rng, 1, columns)} {rng.choice(['<', '<=', '>', '>=', '==', '!='])} {term(rng, 1, columns)})"
    )


class TestValues:
    def test_arithmetic_and_conditions_are_those_of_pandas(self, rng):
        frame = pd.DataFrame(
            {name: np.round(rng.normal(size=40), 1) for name in ("a", "b c", "AHU: T [degF]")}
        )
        columns = {name: frame[name].to_numpy() for name in frame}
        drawn = (rng.choice([term, condition])(rng, 3, ["a", "`b c`", "`AHU: T [degF]`"]) for _ in range(60))
        of_columns = [text for text in drawn if {"a", "`"} & set(re.sub("[b-z]a|a[b-z]", "", text))]
        assert len(of_columns) > 40  # one without a column is refused
        for text in of_columns:
            with np.errstate(all="ignore"), warnings.catch_warnings():
                warnings.simplefilter(
                    "ignore", DeprecationWarning
                )  # pandas writes ~ for the not of a plain bool
                expected = np.broadcast_to(
                    np.asarray(frame.eval(text, engine="python", parser="pandas"), float), 40
                )
            expected = np.where(np.isfinite(expected), expected, np.nan)
            np.testing.assert_array_equal(expression(text).values(columns), expected, err_msg=text)

    def test_a_missing_column_makes_the_result_missing(self):
        x, gone = np.array([1.0, 2.0, 3.0]), np.array([1.0, np.nan, 3.0])
        for text in ("= x + gone", "gone > 2", "not (gone > 2)", "x > 0 or gone > 2", "gone"):
            assert np.isnan(expression(text).values({"x": x, "gone": gone})).tolist() == [
                False,
                True,
                False,
            ], text

    def test_what_is_no_finite_number_is_missing(self):
        assert np.isnan(expression("1 / x").values({"x": np.array([0.0, 1.0])})).tolist() == [True, False]
        assert np.isnan(expression("9**9**9 * x").values({"x": np.ones(2)})).all()

    def test_texts_and_times(self):
        mode = np.array(["on", "off", None], object)
        np.testing.assert_array_equal(expression("mode == 'on'").values({"mode": mode}), [1, 0, np.nan])
        time = np.array(["2017-09-19T23:59", "2017-09-20", "NaT"], "datetime64[ns]")
        np.testing.assert_array_equal(expression("t >= '2017-09-20'").values({"t": time}), [0, 1, np.nan])
        np.testing.assert_array_equal(expression("'2017-09-20' > t").values({"t": time}), [1, 0, np.nan])

    @pytest.mark.parametrize(
        "text, sentence",
        [
            ("mode < 'on'", "text has no order"),
            ("mode > 3", "'mode' holds text: compare it with text in quotes"),
            ("t > 3", "'t' is a time: compare it with a date in quotes"),
            ("t > 'noon'", "'noon' is no date: write it like '2017-09-20'"),
            ("x == 'on'", "'x' holds numbers: compare it with a number"),
        ],
    )
    def test_a_comparison_of_what_does_not_compare(self, text, sentence):
        columns = {
            "mode": np.array(["on"], object),
            "t": np.array(["2017-09-20"], "datetime64[ns]"),
            "x": np.ones(1),
        }
        with pytest.raises(ValueError, match=sentence):
            expression(text).values(columns)


class TestReading:
    def test_columns_in_order_each_once(self):
        e = expression("= `b c` - a + `b c` * exp(a)")
        assert e.columns == ("b c", "a") and e.text == "`b c` - a + `b c` * exp(a)"

    def test_a_backtick_inside_quotes_is_text(self):
        assert expression("mode == 'a`b`c'").columns == ("mode",)

    @pytest.mark.parametrize(
        "text, sentence",
        [
            ("fan = 1", "one = is no comparison, write =="),
            ("supply temp - 1", "stand in backticks, like `Supply Temp`"),
            ("`a - 1", "stand in backticks"),
            ("1 + 2", "names no column"),
            ("", "cannot be read"),
            ("a.real", "an attribute"),
            ("__import__('os')", "the function __import__"),
            ("a.__class__()", "the function a.__class__"),
            ("exp(a, a)", "gives exp 2 numbers"),
            ("exp(x=a)", "the function exp"),
            ("@a + 1", "cannot be read"),
            ("a @ a", "holds @"),
            ("a[0]", "Subscript"),
            ("[a for a in a]", "ListComp"),
            ("lambda: a", "Lambda"),
            ("(a := 1)", "NamedExpr"),
            ("'on' + a", "text can only be compared"),
            ("a + 1j", "holds 1j"),
            ("~a", "Invert"),
            ("(" * 300 + "a" + ")" * 300, "cannot be read"),
        ],
    )
    def test_everything_else_is_refused(self, text, sentence):
        with pytest.raises(ValueError, match=sentence):
            expression(text)

    def test_names_as_they_are_called_in_a_recording(self):
        e = expression("= `Heater 1` + a").among([" Heater 1", "a ", "b"])
        assert e.columns == (" Heater 1", "a ")
        np.testing.assert_array_equal(e.values({" Heater 1": np.ones(2), "a ": np.ones(2)}), [2, 2])
        with pytest.raises(ValueError, match="for 'x', has no column 'x'"):
            expression("x").among(["a"])
        with pytest.raises(ValueError, match="2 columns are called 'a'"):
            find_column("a", ["a", "a"], "the recording")
        assert is_expression(" = a") and not is_expression("a")


class TestModels:
    def test_a_model_refuses_what_cannot_be_read(self):
        for columns in ({"y1": "= a +"}, {"where": "a = 1"}):
            with pytest.raises(ValueError, match="cannot be read"):
                jb.LinearSystem([[0.5]], None, [[1]], noise=0.1, columns=columns)

    def test_a_frame_holds_the_columns_of_an_expression(self):
        m = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1, columns={"y1": "= a - `b c`"})
        frame = pd.DataFrame({"a": [2.0, 1.5, np.nan, 1.6], "b c": [1, 1, 1, 1]})
        res = jb.detect(jb.parity_relations(m), None, frame)
        np.testing.assert_array_equal(res.y[:, 0], [1, 0.5, np.nan, frame["a"][3] - 1])
        with pytest.raises(ValueError, match="has no column 'b c'"):
            jb.detect(jb.parity_relations(m), None, frame[["a"]])

    def test_the_condition_is_looked_at_in_frames(self):
        m = jb.LinearSystem(
            [[0.5]],
            [[0]],
            [[1]],
            dt=86400,
            noise=0.1,
            columns={"where": "fan > 0 and mode == 'on' and t < '2024-01-05'", "u1": "= -v"},
        )
        index = pd.date_range("2024-01-01", periods=6, freq="D", name="t")
        y = pd.DataFrame(
            {"y1": [1.0, 0.5, 0.25, 0.1, 0.05, 0.0], "fan": [1, 1, np.nan, 1, 1, 1], " mode": ["on"] * 6},
            index,
        )
        u = pd.DataFrame({"v": np.zeros(6)}, index)
        r = jb.parity_relations(m)
        res = jb.detect(r, u, y)
        np.testing.assert_array_equal(res.status, [0, 1, 0, 0, 0, 0])
        assert (
            res.aside == 4
            and res.starts == (2, 3, 4)
            and np.isnan(res.y[[2, 4, 5]]).all()
            and not np.isnan(res.y[[0, 1, 3]]).any()
        )
        np.testing.assert_array_equal(np.isnan(jb.margins(r, u, y)), res.status == 0)
        with pytest.raises(ValueError, match="has no column 'mode'"):
            jb.detect(r, u, y[["y1", "fan"]])
        np.testing.assert_array_equal(np.isnan(r.external(u, y)).all(-1), res.status == 0)
        assert jb.detect(r, np.zeros((2, 1)), [[1.0], [0.5]]).status[1] == jb.Status.CONSISTENT

    def test_a_frame_with_blanks_around_its_names(self):
        m = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1, columns={"y1": "Temperature 1"})
        assert (
            jb.detect(jb.parity_relations(m), None, pd.DataFrame({" Temperature 1": [1.0, 0.5]})).y[1] == 0.5
        )

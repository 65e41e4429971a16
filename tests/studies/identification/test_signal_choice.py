"""Inputs chosen by recordings that are left out."""

import json
import tomllib

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.cli.fit_summary import FitConclusion
from jaxbound.recordings.expressions import expression
from jaxbound.studies.identification import orders
from jaxbound.studies.identification.recipe import Recipe
from jaxbound.studies.identification.signal_choice import SignalProblem, chosen_signals, products
from jaxbound.studies.identification.training import Training
from jaxbound.text.quantities import plain

SHORT = Recipe(order=1, horizon=5)

ABOUT = dict(order=1, horizon=5, method="least squares", inputs=["valve", "lift"], outputs=["y"])
COLUMNS = {"valve": "Valve 1", "lift": "= T - Tmix"}


def recorded(rng, product, T=60):
    """A plant that valve, lift and, times `product`, their product move."""
    valve, lift, warm = rng.uniform(0, 1, T), rng.uniform(-1, 1, T), rng.uniform(20, 21, T)
    y = np.zeros(T)
    for k in range(1, T):
        y[k] = 0.7 * y[k - 1] + 0.5 * valve[k - 1] + 0.3 * lift[k - 1] + product * valve[k - 1] * lift[k - 1]
    y += rng.uniform(-0.02, 0.02, T)
    return pd.DataFrame({"Valve 1": valve, "T": lift + warm, "Tmix": warm, "y": y})


@pytest.fixture(scope="module")
def tables():
    rng = np.random.default_rng(7)
    return [recorded(rng, 0.8), recorded(rng, 0.8)]


@pytest.fixture(scope="module")
def model(tables):
    return jb.fit(tables, columns=COLUMNS, signals="auto", **ABOUT)


def test_the_product_that_the_plant_has_joins_the_inputs(model, tables):
    assert model.inputs == ("valve", "lift", "valve*lift")
    assert model.columns["valve*lift"] == "= `Valve 1` * (T - Tmix)"
    as_given = jb.fit(tables, columns=COLUMNS, **ABOUT)
    assert model.check.jump["y"] < as_given.check.jump["y"] / 3


def test_a_recording_is_read_by_the_expression(model, tables):
    unseen = recorded(np.random.default_rng(8), 0.8)
    assert jb.detect(jb.parity_relations(model), tables[0]).counts["FAULT"] == 0
    u = jb.Recording.of(model, unseen).u
    by_hand = unseen["Valve 1"] * (unseen["T"] - unseen["Tmix"])
    assert np.allclose(u[:, 2], by_hand, rtol=1e-12)


def test_what_was_tried_says_what_it_promises(model):
    tried = model.check.signals
    taken = [one for one in tried if one.taken]
    assert [one.change for one in taken] == ["as given", "with valve*lift"]
    assert {"without lift", "with valve**2", "with lift**2"} <= {one.change for one in tried}
    assert taken[1].jump["y"] == pytest.approx(model.check.jump["y"] / model.check.safety, rel=0.05)
    assert taken[1].factor == pytest.approx(model.check.factor, rel=1e-3)


def test_inputs_of_a_linear_plant_stay_as_given():
    rng = np.random.default_rng(9)
    records = []
    for _ in range(2):
        table = recorded(rng, 0.0)
        valve, lift = table["Valve 1"], table["T"] - table["Tmix"]
        u = np.stack([valve, lift, valve**2, lift**2, valve * lift], 1)
        records.append((u, table[["y"]].to_numpy(), np.zeros(0, int)))
    names = "valve", "lift", "valve**2", "lift**2", "valve*lift"
    problem = SignalProblem(Training(records, names, ("y",), 1.0, records, {}, {}, "plant"), SHORT)
    tried = chosen_signals(problem, ("valve", "lift"), lambda share: None)
    assert [one.change for one in tried if one.taken] == ["as given"]
    assert len(tried) == 6  # two are dropped, three products are added


def test_the_order_of_inputs_that_stay_is_chosen_once(monkeypatch):
    rng, calls = np.random.default_rng(9), []
    monkeypatch.setattr(orders, "_first_good", lambda found: calls.append(found) or 1)
    tables = [recorded(rng, 0.0), recorded(rng, 0.0)]
    model = jb.fit(tables, columns=COLUMNS, signals="auto", **(ABOUT | {"order": "auto"}))
    assert (model.inputs, model.check.order, len(calls)) == (("valve", "lift"), 1, 1)


def test_products_that_say_nothing_new_are_not_asked_for():
    rng = np.random.default_rng(10)
    valve, y = rng.uniform(1, 2, 60), rng.normal(size=(60, 1))
    u = np.stack([valve, np.ones(60), 3 * valve - 1, valve * rng.normal(size=60)], 1)
    records = [(u, y, np.zeros(0, int))]
    names = "valve", "still", "alike", "new"
    problem = SignalProblem(Training(records, names, ("y",), 1.0, records, {}, {}, "plant"), SHORT)
    assert problem.asked(("valve",)) == ["new"]


def test_products_are_computed_before_means_are_taken(tables):
    """The mean of a product is another number than the product of means."""
    model = jb.LinearSystem(
        [[0.5]], [[1]], [[1]], inputs=["p"], outputs=["y"], dt=2, noise=1,
        columns={"p": products(["valve", "lift"], COLUMNS)["valve*lift"], "every": "2s"},
    )  # fmt: skip
    table = tables[0].set_axis(pd.to_timedelta(np.arange(60), "s"))
    product = (table["Valve 1"] * (table["T"] - table["Tmix"])).to_numpy()
    assert np.allclose(jb.Recording.of(model, table).u[:, 0], product.reshape(30, 2).mean(1))


def test_a_product_names_its_columns_whatever_they_are_called():
    found = products(["a b", "lift", "c"], {"lift": "= x - `y z`", "c": "other"})
    assert list(found) == ["a b**2", "lift**2", "c**2", "a b*lift", "a b*c", "lift*c"]
    values = {
        name: np.array([number]) for name, number in {"a b": 2.0, "x": 5.0, "y z": 1.0, "other": 3.0}.items()
    }
    assert [float(expression(text).values(values)[0]) for text in found.values()] == [4, 16, 9, 8, 6, 12]
    with pytest.raises(ValueError, match="has a backtick"):
        products(["a"], {"a": "odd`name"})


@pytest.mark.parametrize(
    "recordings, options, words",
    [
        ([(np.ones((9, 1)), np.ones((9, 1)))], {}, "arrays have none"),
        ([jb.Recording(np.ones((9, 1)), np.ones((9, 1)), (), ("u",), ("y",))], {}, "a Recording keeps"),
        ([(np.ones((9, 1)), np.ones((9, 1)))], {"inputs": None}, "name the inputs to begin with"),
        ([(np.ones((9, 1)), np.ones((9, 1)))], {"signals": "all"}, "signals must be None or auto"),
    ],
)  # fmt: skip
def test_a_choice_that_cannot_be_made_is_refused(recordings, options, words):
    with pytest.raises(ValueError, match=words):
        jb.fit(recordings, **{"inputs": ["u"], "outputs": ["y"], "signals": "auto", **options})


def test_the_command_writes_the_choice_and_shows_what_was_tried(tables, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.chdir(tmp_path)
    for name, table in zip("ab", tables, strict=True):
        table.to_csv(f"{name}.csv", index=False)
    words = "fit a.csv b.csv --dt 1 --out m.toml".split()
    words += [
        "--recipe",
        "order=1,horizon=5,signals=auto,method=least squares",
        "--inputs",
        "valve=Valve 1,lift=T-Tmix",
        "--outputs",
        "y",
    ]
    assert main.main(words) == 0
    shown = capsys.readouterr().out
    assert "signals: with valve*lift" in shown and "taken: needs" in shown
    inputs = tomllib.loads((tmp_path / "m.toml").read_text())["inputs"]
    assert inputs[2]["column"] == "= `Valve 1` * (T-Tmix)"


def test_json_has_every_set_that_was_tried(model):
    found = plain(FitConclusion(model, ["a.csv", "b.csv"], written=["m.toml"]).plain())
    assert found["inputs"] == ["valve", "lift", "valve*lift"]
    assert len(found["signals"]) == len(model.check.signals)
    assert sum(one["taken"] for one in found["signals"]) == 2
    json.dumps(found, allow_nan=False)

"""Every verb with every family of tests: it works, or one sentence says what forbids it."""

import json
from functools import cache

import jax
import numpy as np
import pytest

import jaxbound as jb

SPEC = dict(
    A=[[0.5, 0.25], [0, 0.25]], B=[[0], [1]], C=[[1, 0], [1, 1]], noise=[0.1, 0.1], tolerance=[0.02, 0.02]
)
GAIN = dict(A=[[0.5]], B=[[1]], C=[[1]], noise=0.1)
METHODS = {
    "short": "joint",
    "box": "box",
    "long": "joint",
    "constant": "joint",
    "long constant": "joint",
    "uncertain": "joint",
    "bank": "joint",
    "residual": "joint",
}
RARELY = {"long": "long", "long constant": "long"}  # for the time that they take to compile
FAMILIES = [
    pytest.param(name, marks=getattr(pytest.mark, RARELY[name])) if name in RARELY else name
    for name in METHODS
]


@cache
def relations(name):
    if name == "residual":
        grow = lambda z, u, y: y[1, 0] - (0.5 + z[0]) * y[0, 0] - u[0, 0] - z[1]
        return jb.residual(grow, jb.interval([-0.05, -0.2], [0.05, 0.2]), 1, inputs=["u1"], outputs=["y1"])
    if name == "uncertain":
        return jb.parity_relations(
            jb.LinearSystem(**GAIN, uncertainties=[jb.Uncertainty("a", A=[[0.05]])]), 1
        )
    model = jb.LinearSystem(**SPEC, constant_tolerance="constant" in name)
    return (
        jb.structured_relations(model)
        if name == "bank"
        else jb.parity_relations(model, {"long": 9, "long constant": 20}.get(name, 1))
    )


@cache
def detected(name):
    """Return u, y and the Result: a healthy plant, a missing sample, then a jump of a sensor."""
    model = jb.LinearSystem(
        **(SPEC if relations(name).model.p == 2 else GAIN), constant_tolerance="constant" in name
    )
    rng = np.random.default_rng(7)
    u = rng.uniform(-1, 1, (40, 1))
    found = jb.simulate(model, u, jax.random.key(1))
    y = np.array(found.y)
    y[12, 0], y[30:, 0] = np.nan, y[30:, 0] + 5
    return u, y, jb.detect(relations(name), u, y, method=METHODS[name])


@pytest.mark.parametrize("name", FAMILIES)
def test_detect_proves_what_the_family_can(name):
    _, _, res = detected(name)
    assert res.counts["MISSING"] >= relations(name).horizon
    assert (res.status[:30] != jb.Status.FAULT).all() and (res.status[30:] == jb.Status.FAULT).any()


@pytest.mark.parametrize("name", FAMILIES)
def test_a_monitor_says_the_same_at_once_and_sample_by_sample(name):
    u, y, res = detected(name)
    mon = jb.Monitor(relations(name), METHODS[name])
    _, whole = mon.run(mon.init(), u, y)
    np.testing.assert_array_equal(whole.status, res.status)
    np.testing.assert_array_equal(whole.margin, res.exact)
    state, said = mon.init(), []
    for k in range(28, 34):
        state, verdict = mon.step(state, u[k], y[k])
        said.append(int(verdict.status))
    s = relations(name).horizon
    assert said[s:] == res.status[28 + s : 34].tolist()


@pytest.mark.parametrize("name", FAMILIES)
def test_a_fault_has_a_certificate_for_people_and_as_json(name):
    _, _, res = detected(name)
    at = int(np.argmax(res.status == jb.Status.FAULT))
    c = res.explain(at)
    document = json.loads(c.to_json())
    assert c.proves == jb.Status.FAULT and str(c) and isinstance(c.relation, str)
    assert (
        document["certificate"] == "FAULT" and document["statement"] and {"names", "numbers"} <= set(document)
    )
    with pytest.raises(ValueError, match="is MISSING: there is nothing to explain"):
        res.explain(0)


@pytest.mark.parametrize("name", FAMILIES)
def test_margins_are_given_or_a_sentence_says_why_not(name):
    u, y, res = detected(name)
    forbidden = {
        "constant": "whose gains are searched for",
        "long constant": "whose gains are searched for",
        "residual": "no common factor on half-widths",
    }
    if name in forbidden:
        with pytest.raises(NotImplementedError, match=forbidden[name]):
            jb.margins(relations(name), u, y)
        return
    margin = np.asarray(jb.margins(relations(name), u, y))
    s = relations(name).horizon
    assert margin.shape == res.status.shape and np.isnan(margin[:s]).all()
    proved = (
        np.isin(res.status, (jb.Status.CONSISTENT, jb.Status.FAULT))
        & ~np.isnan(margin)
        & (abs(margin) > 1e-6)
    )
    np.testing.assert_array_equal(margin[proved] < 0, res.status[proved] == jb.Status.FAULT)


def test_a_budget_is_that_of_a_window_whatever_stands_beside_it():
    """Hard windows among easy ones get no more, and none of theirs is taken."""
    u, y, _ = detected("uncertain")
    r = relations("uncertain")
    whole = jb.detect(r, u, y, budget=20).status
    alone = [
        int(jb.detect(r, u[k - 1 : k + 1], y[k - 1 : k + 1], budget=20).status[1]) for k in range(1, len(y))
    ]
    assert whole[1:].tolist() == alone


@pytest.mark.parametrize("name", FAMILIES)
def test_parquet_holds_the_same_verdicts(name, tmp_path):
    import pandas as pd

    u, y, res = detected(name)
    names = [f"u{i + 1}" for i in range(u.shape[1])] + [f"y{i + 1}" for i in range(y.shape[1])]
    pd.DataFrame(np.concatenate([u, y], 1), columns=names).to_parquet(tmp_path / "run.parquet")
    if name == "residual":
        with pytest.raises(TypeError, match="relations of a model, whose verdicts can be kept, not Residual"):
            jb.detect_dataset(relations(name), tmp_path / "run.parquet", tmp_path / "out")
        return
    found = jb.detect_dataset(
        relations(name), tmp_path / "run.parquet", tmp_path / "out", method=METHODS[name]
    )
    kept = pd.concat(
        pd.read_parquet(p)
        for p in sorted((tmp_path / "out" / "verdicts.parquet").iterdir())
        if p.suffix == ".parquet"
    )
    assert found.counts == res.counts and kept.status.tolist() == [jb.Status(int(k)).name for k in res.status]
    np.testing.assert_array_equal(kept.margin.to_numpy(float), res.reported)

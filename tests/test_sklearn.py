"""The detector that scikit-learn's users try first: what it says is what `detect` says, and it behaves as
their estimators do.
"""

import subprocess
import sys

import numpy as np
import pytest
from result_case import FAULT, biased
from systems import paper

import jaxbound as jb

pytest.importorskip("sklearn")

from sklearn.base import clone  # noqa: E402
from sklearn.pipeline import make_pipeline  # noqa: E402
from sklearn.preprocessing import FunctionTransformer  # noqa: E402
from sklearn.utils.estimator_checks import estimator_checks_generator  # noqa: E402

from jaxbound.sklearn import Detector  # noqa: E402

EXPECTED = {
    "check_methods_sample_order_invariance": "rows are samples in the order of time: a row is judged with "
    "those before it",
    "check_methods_subset_invariance": "the same: rows alone, or in pieces, have no samples before them",
    "check_outliers_train": "bounds that explain all rows they were fitted on leave no outlier among them, "
    "the check wants one",
    "check_outliers_fit_predict": "the same",
}
CHEAP = Detector(order=1, horizon=2, fitting="least squares", held_out=0)


@pytest.fixture(scope="module")
def run():
    res, _ = biased()
    return res, np.column_stack([res.u, res.y])


def test_a_given_model_says_what_detect_says(run):
    res, X = run
    found = Detector(paper()).fit(X)
    np.testing.assert_array_equal(found.predict(X) == -1, res.status == FAULT)
    score = found.decision_function(X)
    np.testing.assert_array_equal(score < 0, res.status == FAULT)
    np.testing.assert_array_equal(score[1:], res.margin[1:])
    assert score[0] == 0 and found.offset_ == 0 and found.n_features_in_ == 3
    np.testing.assert_array_equal(found.score_samples(X), score)
    assert found.detect(X).counts == res.counts


def test_all_tests_of_a_model_watch_unless_a_horizon_is_given(run):
    res, X = run
    tests = [{"name": "short", "horizon": 1}, {"name": "wide", "horizon": 2, "factor": 9}]
    model = paper().replace(tests=tests)
    found = Detector(model).fit(X)
    bank = jb.detect(jb.monitor(model), res.u, res.y)
    np.testing.assert_array_equal(found.predict(X) == -1, bank.status == FAULT)
    assert tuple(found.detect(X).tests) == ("short", "wide")
    assert isinstance(Detector(model, horizon=1).fit(X).relations_, jb.relations.ParityRelation)


def test_a_margin_below_zero_without_a_proof_is_no_outlier(run):
    _, X = run
    bank = Detector(paper(), method="box").fit(X)
    res = bank.detect(X)
    assert ((bank.predict(X) == -1) == (res.status == FAULT)).all() and np.isfinite(
        bank.decision_function(X)
    ).all()


def test_columns_are_taken_by_number_or_by_name(run):
    pd = pytest.importorskip("pandas")
    res, X = run
    said = Detector(paper()).fit(X).predict(X)
    np.testing.assert_array_equal(
        Detector(paper(), inputs=[2], outputs=[1, 0]).fit(X[:, ::-1]).predict(X[:, ::-1]), said
    )
    frame = pd.DataFrame(X, columns=["u1", "y1", "y2"])
    named = Detector(paper()).fit(frame)
    np.testing.assert_array_equal(named.predict(frame), said)
    assert list(named.feature_names_in_) == ["u1", "y1", "y2"]
    for given, X_, says in (
        (dict(inputs=["flow"]), frame, "no column 'flow'"),
        (dict(inputs=[5]), X, "columns 0 to 2, not 5"),
        (dict(model=paper()), X[:, :2], "X has 2 columns, the model 1 inputs and 2 outputs"),
    ):
        with pytest.raises(ValueError, match=says):
            Detector(**given).fit(X_)


def test_a_detector_without_a_model_learns_one_and_explains_what_it_learnt_from():
    rng = np.random.default_rng(0)
    m = jb.LinearSystem([["0.8"]], [["0.5"]], [[1]], noise="0.05")
    u, x = rng.normal(size=200), np.zeros(201)
    for k in range(200):
        x[k + 1] = 0.8 * x[k] + 0.5 * u[k]
    X = np.column_stack([u, x[:200] + rng.uniform(-0.05, 0.05, 200)])
    found = clone(CHEAP).set_params(inputs=[0]).fit(X)
    assert (found.predict(X) == 1).all() and abs(float(found.model_.A[0][0]) - float(m.A[0][0])) < 0.05
    X[150, 1] += 1
    assert list(np.flatnonzero(found.predict(X) == -1)) == [150, 151, 152]
    pipe = make_pipeline(FunctionTransformer(), clone(CHEAP).set_params(inputs=[0]))
    assert (pipe.fit(X[:140]).predict(X) == -1).any()


def test_without_scikit_learn_there_is_a_sentence():
    code = (
        "import sys; sys.modules['sklearn'] = None\ntry:\n    import jaxbound.sklearn\nexcept "
        "ImportError "
        "as why:\n    print(why)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "jaxbound.sklearn needs scikit-learn 1.6 or newer: pip install 'jaxbound[sklearn]'"


def checks():
    for estimator, check in estimator_checks_generator(CHEAP):
        yield pytest.param(estimator, check, id=getattr(check, "func", check).__name__)


FEW = (
    "check_no_attributes_set_in_init",
    "check_parameters_default_constructible",
    "check_estimator_tags_renamed",
    "check_do_not_raise_errors_in_init",
)


def _run(estimator, check):
    name = getattr(check, "func", check).__name__
    if name not in EXPECTED:
        return check(estimator)
    with pytest.raises(AssertionError):  # one that begins to pass must leave the list
        check(estimator)


@pytest.mark.parametrize("estimator, check", [c for c in checks() if c.id in FEW])
def test_it_is_an_estimator(estimator, check):
    _run(estimator, check)


@pytest.mark.parametrize("estimator, check", list(checks()))
@pytest.mark.filterwarnings("ignore")  # of scikit-learn's own checks
def test_scikit_learns_checks_pass_but_for_those_that_cannot(estimator, check):
    _run(estimator, check)

"""Work that takes long says so by itself; whoever gave a function is told all the way."""

import logging

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.exact import linalg
from jaxbound.text import progress
from jaxbound.text.progress import in_part, reporter


@pytest.fixture
def clock(monkeypatch):
    """Return a clock [seconds] that stands still until somebody moves it."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_nobody_is_told_of_short_work_and_everybody_of_long_work(clock, caplog):
    report = reporter(None, "fit")
    with caplog.at_level(logging.WARNING, logger="jaxbound"):
        for second, share in enumerate(np.linspace(0, 0.9, 150)):
            clock[0] = float(second)
            report(share)
        clock[0] = 150.0
        report(0.99)
    said = [record.getMessage() for record in caplog.records]
    assert said[0] == "fit: 3 % done after 5 s, about 3 minutes to go"
    assert len(said) == 3, "one after five seconds, then one a minute, and none just before the end"


def test_what_comes_before_the_first_share_is_not_expected_again(clock, caplog):
    report = reporter(None, "detect")
    with caplog.at_level(logging.WARNING, logger="jaxbound"):
        for second, share in ((12.0, 0.01), (13.0, 0.02), (14.0, 0.03)):
            clock[0] = second
            report(share)
    assert [record.getMessage() for record in caplog.records] == [
        "detect: 2 % done after 13 s, about 98 seconds to go"
    ]


def test_work_that_ends_soon_or_was_asked_about_is_not_spoken_of(clock, caplog):
    told = []
    with caplog.at_level(logging.WARNING, logger="jaxbound"):
        for report in (reporter(None), reporter(told.append)):
            clock[0] += 9.0
            report(0.0)
            report(0.8)
    assert not caplog.records and told == [0.0, 0.8]


def system(n, p, **more):
    """Return a model of n states with p outputs."""
    rng = np.random.default_rng(n)
    A = np.round(rng.normal(size=(n, n)) * 0.3 / np.sqrt(n) + np.diag(rng.uniform(0.3, 0.9, n)), 2)
    C = np.round(rng.normal(size=(p, n)), 2)
    return jb.LinearSystem(A.tolist(), None, C.tolist(), noise=0.1, **more)


def shares_of(work):
    """Return the shares that work reports: ascending, to 1 at most."""
    shares = []
    work(shares.append)
    assert shares == sorted(shares) and 0 <= shares[0] and shares[-1] <= 1 + 1e-9
    return [0.0, *shares]


@pytest.mark.parametrize("n, p, horizon", [(8, 3, 12), (6, 2, 20)])
def test_relations_of_many_states_report_all_the_way(n, p, horizon):
    """No stretch without a word, but for the last few percent."""
    shares = shares_of(lambda told: jb.parity_relations(system(n, p), horizon, progress=told))
    assert max(np.diff(shares)) < 0.25 and shares[-1] == 1


def test_the_search_of_relations_with_uncertain_parameters_reports():
    poles = []
    for i in range(3):
        poles.append(jb.Uncertainty(f"p{i}", A=(np.diag(np.eye(4)[i]) * 0.05).tolist()))
    model = system(4, 2, uncertainties=poles)
    assert len(shares_of(lambda told: jb.parity_relations(model, 2, progress=told))) > 5


def test_a_monitor_reports_within_its_tests():
    model = system(6, 2, tests=[{"name": "short", "horizon": 8}, {"name": "long", "horizon": 16}])
    shares = shares_of(lambda told: jb.monitor(model, progress=told))
    assert len([share for share in shares if 0 < share < 0.5]) > 3


def test_errors_of_signals_are_worked_out_one_by_one_and_once():
    model = jb.LinearSystem([[0.5]], [[1, 1]], [[1], [1]], noise=0.1)
    y = np.zeros((9, 2))
    y[5:, 0] = 3
    alone, told = (jb.detect(jb.parity_relations(model, 2), np.zeros((9, 2)), y).explain(5) for _ in range(2))
    assert shares_of(told.work_out) == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert told.errors == alone.errors and told.candidates == alone.candidates
    assert told._scale.error(0) is told._scale.error(0)


def test_rows_of_minimal_span_are_those_of_the_plain_search():
    """The first two rows that end alike, again and again: whichever way they are looked for."""
    rng = np.random.default_rng(3)
    for _ in range(30):
        a = linalg.matrix(rng.integers(-2, 3, (rng.integers(1, 7), rng.integers(1, 9))).tolist())
        rows, shares = list(linalg.row_reduce(a)[0]), []
        while True:
            ends = [max(j for j, x in enumerate(row) if x) for row in rows]
            pairs = [(i, k) for i in range(len(rows)) for k in range(i + 1, len(rows)) if ends[i] == ends[k]]
            if not pairs:
                break
            i, k = pairs[0]
            rows[i] = linalg.add_multiple(rows[i], -rows[i][ends[i]] / rows[k][ends[k]], rows[k])
        assert linalg.minimal_span(a, shares.append) == tuple(map(linalg.primitive, rows))
        assert shares == sorted(shares) and (not shares or shares[-1] == 1)


def test_a_part_of_the_work_is_reported_as_a_part():
    told = []
    in_part(told.append, 0.5, 0.25, 0.5)
    assert told == [0.625]

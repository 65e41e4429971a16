"""Sentences on what the data of a fit do not carry."""

import jaxbound as jb
from jaxbound.studies.identification.advice import blind, data_limits
from jaxbound.studies.identification.fit_result import FitCheck, PartLeftOut


def said(**sizes):
    """Return the sentences on an output that moved by 10, of a fit for an observer."""
    parts = (PartLeftOut(50, 1.0, ""),) * 2
    recordings = ({"samples": 50, "windows": 50, "used": 0.5},) * 2
    about = dict(method="windows", order=1, delay=1, factor=1.0, safety=1.25, smallest={"T": 1.0}, steady={})
    about |= dict(left_out=parts, recordings=recordings, moved={"T": 10.0})
    check = FitCheck(held_out=None, used=(), held_out_used=(), **about, **sizes)
    model = jb.LinearSystem([["0.5"]], None, [[1]], noise=1, outputs=["T"])
    return [*data_limits(model, check, 0.3), *blind(model, check)]


def test_a_sharp_observer_is_blind_only_where_no_test_could_see_a_jump():
    assert said(jump={"T": 25.0}, hidden={"T": 6.0}) == []
    (sentence,) = said(jump={"T": 25.0}, hidden={"T": 12.0})
    assert "blind for T: no jump below 12 is sure to be seen" in sentence


def test_an_observer_of_zonotopes_is_blind_where_these_are():
    (sentence,) = said(jump={"T": 25.0})
    assert "no jump below 25" in sentence
    (sentence,) = said(jump={"T": float("inf")})
    assert "no jump however large" in sentence

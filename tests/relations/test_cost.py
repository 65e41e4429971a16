"""What would not end is refused before it begins, and what is short is found out before relations are
made.
"""

from fractions import Fraction

import numpy as np
import pytest
from counted_calls import TooManyCalls, at_most

import jaxbound as jb
from jaxbound.estimation.zonotope_begin import left_inverse
from jaxbound.exact import linalg
from jaxbound.exact.circuits import circuits
from jaxbound.exact.price import refuse_or_say
from jaxbound.models.modelfile import save_model
from jaxbound.models.plant import Plant
from jaxbound.relations.cost import affordable, relation_cost

FEW, MANY = 200_000, 5_000_000  # calls of functions: less than a tenth of a second, and some seconds
CHAIN = jb.LinearSystem([[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]], noise=0.1)
DISTURBED = jb.LinearSystem([[0.5]], [[1]], [[1], [2]], noise=0.1, disturbance=([[1]], 0.1))
UNCERTAIN = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1, uncertainties=[jb.Uncertainty("a", A=[[0.1]])])
UNKNOWN = jb.LinearSystem([[0.5]], [[1]], [[1], [2]], noise=0.1, unknown_inputs=[[1]])


def dense(n, p, rng):
    """Return a model without zeros, with numbers of two digits."""
    numbers = lambda rows, columns: [
        [str(x) for x in row] for row in np.round(rng.uniform(-1, 1, (rows, columns)) / n**0.5, 2)
    ]
    return jb.LinearSystem(numbers(n, n), numbers(n, 1), numbers(p, n), noise=0.1)


@pytest.mark.parametrize("model", [CHAIN, DISTURBED, UNCERTAIN, UNKNOWN])
@pytest.mark.parametrize("horizon", [10**9, 10**400])
def test_an_endless_horizon_is_refused_at_once_with_the_longest_that_will_do(model, horizon):
    with at_most(FEW), pytest.raises(ValueError, match="too long: .* choose a horizon of at most"):
        jb.parity_relations(model, horizon)


@pytest.mark.parametrize(
    "ask",
    [
        lambda: jb.detectable(CHAIN, "y1", horizon=10**9),
        lambda: jb.unknown_inputs(UNKNOWN, np.zeros((9, 1)), np.zeros((9, 2)), horizon=10**9),
        lambda: jb.validate(CHAIN, np.zeros((9, 1)), np.zeros((9, 2)), horizon=10**9),
    ],
)
def test_every_other_door_refuses_an_endless_horizon_at_once(ask):
    with at_most(FEW), pytest.raises(ValueError, match="horizon"):
        ask()


def wide(n, q, rng):
    """Return a zonotope of n coordinates whose q generators have all digits."""
    return jb.sets.zonotope(np.zeros(n), rng.normal(size=(n, q)))


@pytest.mark.parametrize(
    "ask, sentence",
    [
        (
            lambda rng: jb.sets.strips(wide(8, 24, rng)),
            r"346104 subsets of 24 generators would take about 14 minutes .* ask `membership`",
        ),
        (
            lambda rng: jb.sets.minkowski_difference(wide(7, 20, rng), wide(7, 2, rng)),
            "generators in 20 directions, in 7 dimensions",
        ),
        (
            lambda rng: jb.observer(dense(80, 2, rng)),
            r"how 80 states follow from 40 samples would take about \d+ minutes .* reduce the model",
        ),
        (
            lambda rng: jb.observer(dense(12, 2, rng), horizon=10**9),
            "how 12 states follow from 1000000001 samples would take more than a year",
        ),
    ],
)
def test_what_would_take_minutes_is_refused_at_once_with_what_to_do(ask, sentence, rng):
    with at_most(MANY), pytest.raises(ValueError, match=sentence):
        ask(rng)


def test_what_takes_more_than_a_minute_is_said_first():
    with pytest.warns(
        UserWarning, match=r"^strips take about 2 minutes in exact numbers; if that is too long, ask$"
    ):
        refuse_or_say(120, "strips", "ask")
    with pytest.raises(ValueError, match="^strips would take about 17 minutes in exact numbers: ask$"):
        refuse_or_say(1000, "strips", "ask")
    refuse_or_say(50, "strips", "ask")


def test_an_observer_of_many_states_is_made_in_few_calls(rng):
    """A left inverse by one elimination, and what acts at each step from the step behind it: 24 states took
    minutes before.
    """
    with at_most(MANY // 10):
        watch = jb.observer(dense(12, 2, rng))
    assert watch.horizon == 5


def test_code_that_calls_more_than_it_may_is_stopped():
    with pytest.raises(TooManyCalls, match="more than 9 calls"), at_most(9):
        sum(abs(k) for k in range(10**9))
    with at_most(30) as calls:
        sum(abs(k) for k in range(9))
    assert calls() >= 9


@pytest.mark.parametrize("m, n, places", [(4, 4, ()), (5, 3, ()), (8, 5, (2,)), (6, 1, ()), (7, 4, (0, 3))])
def test_a_left_inverse_is_that_of_the_normal_equations(m, n, places, rng):
    """Exactly, whatever the weights."""
    O = linalg.matrix(rng.integers(-99, 100, (m, n)).tolist())
    thin = [[x for j, x in enumerate(row) if j not in places] for row in O]
    for noise in (np.ones(m), rng.choice([0.25, 0.5, 1], m), np.zeros(m)):
        weight = [
            Fraction(1 / max(x / noise.max(), 1e-6) ** 2) if noise.any() else Fraction(1)
            for x in noise.tolist()
        ]
        across = linalg.transpose([[x * v for x in row] for row, v in zip(thin, weight, strict=True)])
        wanted = linalg.matmul(linalg.inverse(linalg.matmul(across, thin)), across)
        found = left_inverse(O, noise, [j for j in range(n) if j not in places])
        assert [row for j, row in enumerate(found) if j not in places] == list(wanted)
        assert all(not any(found[j]) for j in places)


def test_the_longest_horizon_that_is_named_will_do():
    with pytest.raises(ValueError, match="at most") as e:
        affordable(CHAIN, 10**9)
    longest = int(str(e.value).rsplit(" ", 1)[1])
    affordable(CHAIN, longest)
    with pytest.raises(ValueError):
        affordable(CHAIN, longest + 1)


@pytest.mark.parametrize("sizes", [(2, 2, 0), (40, 2, 0), (3, 1, 2)])
def test_a_longer_window_never_costs_less(sizes, rng):
    n, p, g = sizes
    model = dense(n, p, rng)
    model = jb.LinearSystem(model.A, model.B, model.C, disturbance=([[1] * g] * n, 1) if g else None)
    costs = [relation_cost(model, s) for s in (0, 1, 5, 20, 50, 200, 10**9)]
    assert costs == sorted(costs) and [size for _, size in costs] == sorted(size for _, size in costs)


def test_a_model_of_too_many_states_is_refused_at_once():
    n = 1000
    model = jb.LinearSystem.__new__(
        jb.LinearSystem
    )  # as the door leaves it: reading a million numbers is not what is asked here
    row = (Fraction(1, 10),) * n
    none = ((),) * n
    plant = Plant(
        A=(row,) * n,
        B=none,
        C=(row,),
        D=((),),
        G=none,
        disturbance=(),
        F=none,
        D_v=((),),
        uncertainties=(),
        dt=1.0,
    )
    vars(model).update(plant=plant, horizon=None, lags=None, averages=())
    with at_most(2 * MANY), pytest.raises(ValueError, match="a model of 1000 states is too large"):
        jb.parity_relations(model)


def test_few_relations_of_many_states_take_no_minors_of_their_size(rng):
    a = linalg.matrix(rng.integers(-99, 100, (33, 30)))
    with at_most(MANY):  # by minors of 30 rows: minutes
        found = circuits(a)
    assert len(found) == 33 * 32 // 2 and all(not any(x) for x in linalg.matmul(found, a))


@pytest.mark.parametrize("shape", [(6, 2), (6, 4), (7, 5), (5, 4), (5, 5)])
def test_circuits_have_minimal_supports_whichever_way_they_are_found(shape, rng):
    a = linalg.matrix(rng.integers(-1, 2, shape))
    found = circuits(a)
    supports = [frozenset(i for i, x in enumerate(h) if x) for h in found]
    assert len(set(supports)) == len(found) and not any(x < y for x in supports for y in supports)
    null = linalg.left_null_space(a)
    assert bool(found) == bool(null)
    if found:
        assert all(not any(x) for x in linalg.matmul(found, a)) and linalg.rank(found) == len(null)


def test_relations_of_long_windows_are_those_of_their_definition(rng):
    """W Y = K U for every trajectory, with disturbances: W of the outputs alone annihilates the state."""
    from jaxbound.models import window

    model = jb.LinearSystem(
        [[0.5, 0.1], [0.2, -0.3]], [[1], [2]], [[1, 0], [1, 1]], [[1], [0]], disturbance=([[1], [1]], 1)
    )
    r, s = jb.parity_relations(model, 6), 6
    O, H = window.first_form(model, s)
    V = window.disturbance_form(model, s)
    outputs = tuple(row[: (s + 1) * 2] for row in r.W)
    assert not any(x for row in linalg.matmul(outputs, O) for x in row)
    assert linalg.matmul(outputs, H) == r.K
    assert linalg.matmul(outputs, V) == tuple(tuple(-x for x in row[(s + 1) * 2 :]) for row in r.W)
    assert linalg.rank(outputs) == r.count == (s + 1) * 2 - 2


def test_progress_of_relations_rises_to_the_end():
    told = []
    jb.parity_relations(CHAIN, 30, progress=told.append)
    assert len(told) > 3 and told == sorted(told) and told[-1] == 1


def test_a_recording_too_short_is_found_out_before_relations_are_made(tmp_path, capsys, monkeypatch):
    from jaxbound.cli import main as cli
    from jaxbound.cli import window

    save_model(CHAIN, tmp_path / "m.toml")
    (tmp_path / "r.csv").write_text("u1,y1,y2\n" + "0,0,0\n" * 201)
    monkeypatch.setattr(window, "parity_relations", lambda *a, **k: pytest.fail("relations were made"))
    for horizon in ("1000", "1" + "0" * 15):
        args = [
            "detect",
            str(tmp_path / "m.toml"),
            str(tmp_path / "r.csv"),
            "--out",
            str(tmp_path / "out"),
            "--test",
            f"horizon={horizon}",
        ]
        assert cli.main(args) == 2
        assert "the recording has 201 samples, one window needs" in capsys.readouterr().err


def test_info_of_many_states_says_what_it_leaves_out(rng):
    from jaxbound.cli.model_summary import isolation_text

    text = isolation_text(dense(60, 2, rng), 30)
    assert "not worked out" in text and "would take about" in text

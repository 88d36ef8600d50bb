import numpy as np
import pytest

from surctl.control import load_gains
from surctl.errors import InputError
from surctl.simulation import load_scenario, simulate
from surctl.tuning import DISK_FLOOR, Axis, Flight, sweep
from surctl.tuning import sweep as sweep_function
from surctl.tuning.sweep import MEASURED, _judged, _pick
from surctl.vehicle import load_vehicle

GAINS = load_gains("default")


def flight(name="pool-behind", seed=0):
    scenario = load_scenario(name)
    return Flight(scenario, load_vehicle(scenario.vehicle), seed)


def test_a_point_is_what_the_single_run_measures():
    axes = (Axis("lookahead", (0.6, 1.0)), Axis("k_v", (1.2, 1.8)))
    done = sweep(GAINS, axes, flights=[flight()], workers=1)
    one = flight()
    run = simulate(one.scenario, one.vehicle, gains=GAINS.with_values({"lookahead": 1.0, "k_v": 1.2}))
    assert done.column("time_s")[1, 0] == run.metrics.time_s
    assert done.column("min_clearance_m")[1, 0] == run.metrics.min_clearance_m
    assert done.column("deviation_m")[1, 0] == run.metrics.deviation_m
    i, j = done.picked
    assert done.gains["lookahead"] == axes[0].values[i]
    assert done.gains["k_v"] == axes[1].values[j]
    assert "picked by a grid sweep" in done.gains.provenance


def table(**columns):
    base = {name: np.ones((2, 2)) for name in MEASURED}
    return _judged({**base, **{name: np.array(values) for name, values in columns.items()}})


def test_the_least_score_among_the_feasible_is_picked():
    judged = table(strayed=[[0.1, 0.2], [0.3, 0.4]], arrived=[[0, 1], [1, 1]])
    assert _pick(judged) == (0, 1)
    judged = table(strayed=[[0.1, 0.2], [0.3, 0.4]], min_clearance_m=[[0.1, -0.01], [0.1, 0.1]])
    assert _pick(judged) == (0, 0)
    judged = table(disk_margin=[[DISK_FLOOR, 0.1], [0.1, 0.1]], path_error_m=[[np.nan, 1], [1, 1]])
    assert _pick(judged) == (0, 0)
    assert _pick(table(arrived=np.zeros((2, 2)))) is None


def test_nothing_feasible_keeps_the_gains():
    axes = (Axis("k_v", (0.01, 0.02)), Axis("lookahead", (0.8, 1.0)))
    done = sweep(GAINS, axes, flights=[flight()], workers=1)
    assert done.picked is None
    assert done.gains == GAINS


def test_the_store_resumes_its_own_request_only(tmp_path):
    store = tmp_path / "deep" / "sweep.csv"
    axes = (Axis("lookahead", (0.6, 1.0)), Axis("k_v", (1.2, 1.8)))
    told = []
    first = sweep(GAINS, axes, flights=[flight()], workers=1, store=store)
    again = sweep(GAINS, axes, flights=[flight()], workers=1, store=store, progress=lambda *n: told.append(n))
    assert told == [(4, 4)]
    for name in first.columns:
        assert np.array_equal(first.column(name), again.column(name), equal_nan=True)
    told.clear()
    sweep(GAINS, axes, flights=[flight(seed=1)], workers=1, store=store, progress=lambda *n: told.append(n))
    assert told[0] == (0, 4)


@pytest.mark.parametrize("rubbish", [b"", b"\xff\xfe\x00", b"# another file\n1,2,3\n", b"i,j\n"])
def test_a_foreign_store_is_not_trusted(tmp_path, rubbish):
    store = tmp_path / "sweep.csv"
    store.write_bytes(rubbish)
    axes = (Axis("lookahead", (0.6, 1.0)), Axis("k_v", (1.2, 1.8)))
    if rubbish.startswith(b"\xff"):
        with pytest.raises(InputError, match=r"sweep\.csv"):
            sweep(GAINS, axes, flights=[flight()], workers=1, store=store)
        return
    told = []
    sweep(GAINS, axes, flights=[flight()], workers=1, store=store, progress=lambda *n: told.append(n))
    assert told[0] == (0, 4)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Axis("kv", (1, 2)), "kv.*k_v"),
        (lambda: Axis("k_v", (1,)), "two values"),
        (lambda: Axis("k_v", (2, 1)), "ascending"),
        (lambda: Axis("k_v", (float("nan"), 1)), "ascending"),
        (lambda: sweep_function(GAINS, (Axis("k_v", (1, 2)), Axis("k_v", (1, 2))), flights=[flight()]), "twice"),
        (
            lambda: sweep_function(GAINS, (Axis("k_v", (0, 2)), Axis("k1", (1, 2))), flights=[flight()]),
            "greater than 0",
        ),
        (lambda: sweep_function(GAINS, (Axis("k_v", (1, 2)), Axis("k1", (1, 2))), flights=[]), "nothing to fly"),
    ],
)
def test_mistakes_are_named(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_unknown_column():
    axes = (Axis("lookahead", (0.6, 1.0)), Axis("k_v", (1.2, 1.8)))
    done = sweep(GAINS, axes, flights=[flight()], workers=1)
    with pytest.raises(InputError, match="score"):
        done.column("scor")

"""The verdicts of flights come from the numbers: here the numbers are made up."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.cli.reproduce import row_lines
from surctl.marine.reproduction import Row, Simulations
from surctl.marine.reproduction.reproduction import avoidances, instant_items
from surctl.marine.reproduction.scenarios import (
    hull_items,
    limit_items,
    position_items,
    scenario_items,
    scenario_names,
    time_verdict,
)
from surctl.marine.simulation import METRICS, BatchResult


def batch(**columns: float | list[float]) -> BatchResult:
    """Runs of 45 s that all arrive, with these columns instead."""
    usual = {"reached": 1.0, "time_s": 45.0, "min_clearance_m": 0.1, "path_error_m": 0.02, "length_m": 9.2}
    values = {**dict.fromkeys(METRICS, 0.0), **usual, **columns}
    return BatchResult(
        np.column_stack(np.broadcast_arrays(*(np.array([values[name]]).ravel() for name in METRICS))), "c"
    )


def flights(**batches: BatchResult) -> Simulations:
    """Flights of every scenario, those named as given."""
    made = Simulations(4)
    for name in scenario_names():
        for sensing in ("truth", "sonar"):
            made._batches[name, sensing, "", ()] = batches.get(name.replace("-", "_"), batch())
    return made


def row(name: str, **batches: BatchResult) -> Row:
    made = flights(**batches)
    return next(i for i in [*scenario_items(made), *position_items(made)] if i.id == name).row()


def test_every_scenario_has_a_row_for_each_way_of_sensing() -> None:
    ids = {item.id for item in scenario_items(Simulations(1))}
    assert ids == {name + ending for name in scenario_names() for ending in ("", "-sonar")}
    assert len(scenario_names()) == 14
    assert {item.expected for item in scenario_items(Simulations(1))} == {None}


def test_about_is_eight_percent_and_less_than_is_strict() -> None:
    assert time_verdict(44.5 * 1.079, 44.5, "about")[0] and time_verdict(44.5 * 0.921, 44.5, "about")[0]
    assert not time_verdict(44.5 * 1.081, 44.5, "about")[0] and not time_verdict(44.5 * 0.919, 44.5, "about")[0]
    assert time_verdict(44.99, 45.0, "less than")[0] and not time_verdict(45.0, 45.0, "less than")[0]
    assert "10.0 % below" in time_verdict(40.5, 45.0, "about")[1]


def test_a_collision_or_a_run_that_does_not_arrive_is_not_as_expected() -> None:
    for columns in ({"reached": [1.0, 0.0], "collided": [0.0, 1.0]}, {"reached": [1.0, 0.0]}):
        found = row("tank-static", tank_static=batch(**columns))
        assert not found.as_expected and found.result.word == "differs"
    assert (
        "1 of 2 runs collided" in row("tank-static", tank_static=batch(reached=[1, 0], collided=[0, 1])).result.verdict
    )
    assert row("tank-static").as_expected


def test_a_time_that_differs_is_told_with_its_reason_and_does_not_count() -> None:
    slow = row("tank-speed-015", tank_speed_015=batch(time_s=[60.0, 62.0]))
    assert slow.as_expected
    words = "differs: 61.00 s is 37.1 % above 44.5 s: the robot moved 9.20 m at 0.151 m/s"
    assert slow.result.verdict.startswith(words)
    assert "61.00 ± 1.00 s" in slow.result.ours
    assert row("tank-speed-015", tank_speed_015=batch(time_s=46.0)).result.verdict == "agrees"


def test_the_time_is_the_one_that_the_paper_speaks_of() -> None:
    # of every run of the series
    assert row("tank-speed-010", tank_speed_010=batch(time_s=[40.0, 44.9])).result.word == "agrees"
    assert row("tank-speed-010", tank_speed_010=batch(time_s=[40.0, 45.1])).result.word == "differs"
    # the mean of the two speeds below 0.20 m/s
    fast, slow = batch(time_s=14.0), batch(time_s=17.0)
    assert row("pool-speed-015", pool_speed_010=fast, pool_speed_015=slow).result.word == "agrees"
    assert row("pool-speed-015", pool_speed_010=batch(time_s=15.5), pool_speed_015=slow).result.word == "differs"
    # a run that does not arrive has no time
    assert (
        row("tank-speed-010", tank_speed_010=batch(time_s=[40.0, 1.0], reached=[1, 0])).result.numbers["time_s"] == 40.0
    )


def test_the_position_error_is_that_of_every_run_that_arrived() -> None:
    assert row("position-error-pool").result.word == "agrees"
    assert row("position-error-pool", pool_ahead=batch(path_error_m=[0.01, 0.081])).result.word == "differs"
    assert "pool-ahead" in row("position-error-pool", pool_ahead=batch(path_error_m=[0.01, 0.081])).result.verdict
    lost = batch(path_error_m=[0.01, 0.9], reached=[1.0, 0.0])
    assert row("position-error-pool", pool_ahead=lost).result.word == "agrees"
    assert row("position-error-pool", pool_ahead=batch(path_error_m=[np.nan, 0.01])).result.word == "agrees"
    assert row("position-error-tank", tank_moving=batch(path_error_m=0.043)).result.word == "agrees"  # about 0.04
    assert row("position-error-tank", tank_moving=batch(path_error_m=0.044)).result.word == "differs"


def test_an_avoidance_ends_with_a_second_without() -> None:
    time = np.arange(0, 10, 0.05)
    avoiding = ((time > 2) & (time < 3)) | ((time > 3.4) & (time < 4)) | (time > 6)
    run = SimpleNamespace(record=SimpleNamespace(time=time), telemetry=lambda name: avoiding.astype(float)[:, None])
    assert avoidances(run) == pytest.approx([2.05, 6.05])


def test_every_instant_of_the_library_has_a_row() -> None:
    ids = {item.id for item in instant_items(Simulations(1))}
    assert ids == {"pool-ahead-detected", "pool-behind-detected", "tank-moving-passed", "tank-static-transients"}


def test_the_printed_hull_in_the_pool_is_reported_and_decides_nothing() -> None:
    made = Simulations(4)
    assert len(hull_items(made)) == 7
    item = next(item for item in hull_items(made) if item.id == "pool-static-printed-hull")
    made._batches["pool-static", "truth", "sur540-flooded", ()] = batch(reached=[1, 0], collided=[0, 1])
    assert item.row().as_expected and item.row().result.verdict.startswith("differs: 1 of 2 runs collided and 0")
    made._batches["pool-static", "truth", "sur540-flooded", ()] = batch()
    assert item.row().result.verdict == "agrees"


def test_what_decides_the_time_is_what_shortens_it_most() -> None:
    made = Simulations(4)
    for factors, seconds in (((), 40.0), ((("radius", 0.7),), 33.0), ((("m11", 0.5), ("m22", 0.5)), 30.0)):
        made._batches["pool-static", "sonar", "", factors] = batch(time_s=seconds)
    for name in ("Fu_max", "Xu"):
        known = {"Fu_max": 2.0, "Fv_max": 2.0} if name == "Fu_max" else dict.fromkeys(("Xu", "Yv", "Xuu", "Yvv"), 0.5)
        made._batches["pool-static", "sonar", "", tuple(known.items())] = batch(time_s=41.0)
    found = limit_items(made)[0].row().result
    assert found.verdict.endswith("with half the mass it takes 10.0 s less") and found.safe is None
    assert found.numbers["a_hull_of_0.7_its_radius_s"] == 33.0


def test_a_changed_vehicle_is_flown_as_one() -> None:
    made = Simulations(2)
    usual, narrow = made.batch("pool-behind", "truth"), made.batch("pool-behind", "truth", "", (("radius", 0.7),))
    assert np.all(narrow.column("min_clearance_m") > usual.column("min_clearance_m"))


def test_no_seeds_is_a_mistake() -> None:
    with pytest.raises(InputError, match="at least 1"):
        Simulations(0)


@pytest.mark.parametrize(("lost", "good"), [(0.0, True), (1.0, False)])
def test_runs_with_the_echoes_of_webots_stand_beside_those_with_sonars(
    monkeypatch: pytest.MonkeyPatch, lost: float, good: bool
) -> None:
    other = batch(reached=[1.0, 1.0 - lost], collided=[0.0, lost], time_s=[50.0, 54.0])
    monkeypatch.setattr(Simulations, "in_webots", lambda self, name: other)
    made = replace(flights(), webots=True)
    found = {item.id: item.row() for item in scenario_items(made) if item.id.startswith("tank-static")}
    assert found["tank-static-sonar"].as_expected is good and not found["tank-static"].result.webots
    told = found["tank-static-sonar"].to_dict()["webots"]
    assert told == (
        "2 of 2 arrived, 0 collided, 52.00 ± 2.00 s" if good else "1 of 2 arrived, 1 collided, 50.00 ± 0.00 s"
    )
    assert row_lines(found["tank-static-sonar"])[3] == f"       Webots  {told}"

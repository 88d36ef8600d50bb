"""Campaigns: the same whatever they are cut into, counted right, and judged by what was assumed."""

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.simulation import METRICS, STOPS
from surctl.marine.simulation.campaign.campaign import run_campaign
from surctl.marine.simulation.campaign.summary import RunTable, summarise
from tests.simulation.campaign.test_draws import plan


def test_chunks_and_threads_change_no_byte():
    drawn = plan("tank-moving", law="closed_form", seconds=10.0)
    whole = run_campaign(drawn, runs=24)
    for chunk, threads in ((7, 3), (24, 2), (1000, 1)):
        other = run_campaign(drawn, runs=24, chunk=chunk, threads=threads)
        assert repr(other.table.columns()) == repr(whole.table.columns())
        assert [r.to_toml() for r in other.worst(4)] == [r.to_toml() for r in whole.worst(4)]
    first = {name: column[:10] for name, column in whole.table.columns().items()}
    assert repr(run_campaign(drawn, runs=10).table.columns()) == repr(first)


def test_a_campaign_needs_runs():
    with pytest.raises(InputError, match="runs = 0"):
        run_campaign(plan("tank-static"), runs=0)


def table(*rows):
    """Rows of (why it stopped, time, clearance, broken)."""
    figures = np.zeros((len(rows), len(METRICS)))
    for k, (reason, time, clearance, _) in enumerate(rows):
        told = {
            "reached": reason == "reached",
            "collided": reason == "collision",
            "time_s": time,
            "min_clearance_m": clearance,
            "stopped": STOPS.index(reason),
        }
        for name, value in told.items():
            figures[k, list(METRICS).index(name)] = value
    return RunTable(np.arange(len(rows)) + 10, figures, {}, tuple(row[3] for row in rows))


MIXED = table(
    ("reached", 50.0, 0.3, ()),
    ("standstill", 90.0, 0.2, ()),
    ("collision", 20.0, -0.001, ("thrust", "range")),
    ("reached", 60.0, 0.1, ()),
    ("collision", 30.0, -0.002, ()),
    ("time limit", 150.0, 0.05, ()),
)


def test_the_worst_come_first():
    assert MIXED.worst(10) == [4, 2, 5, 1, 3, 0]
    assert MIXED.worst(2) == [4, 2] and MIXED.worst(0) == []


def test_a_summary_counts():
    told = summarise(MIXED)
    counts = {reason: share.count for reason, share in told.stopped.items()}
    assert counts == {"time limit": 1, "reached": 2, "collision": 2, "fault": 0, "standstill": 1, "dead end": 0}
    assert told.time_s[0] == 50.0 and told.time_s[50] == 55.0 and told.time_s[100] == 60.0
    assert told.clearance_m[0] == -0.002 and told.clearance_m[100] == 0.3
    assert told.broken == {"thrust": 1, "range": 1, "none": 1}
    assert (told.inside.count, told.inside.runs) == (1, 5)
    assert told.to_dict()["collisions_within_assumptions"]["at_most_95"] == told.inside.at_most()
    assert any("1 of 5 collided" in line for line in told.lines())
    assert told.to_dict()["stopped"]["collision"]["at_most_95"] == told.stopped["collision"].at_most() > 2 / 6


def test_nothing_to_be_clear_of_has_no_percentiles():
    free = summarise(table(("time limit", 9.0, np.inf, ())))
    assert free.clearance_m == free.time_s == {}


def test_a_row_tells_all_and_so_does_a_line():
    row = MIXED.row(2)
    assert (row["seed"], row["stopped_because"], row["collided"], row["reached"]) == (12, "collision", True, False)
    assert row["broken_assumptions"] == ["thrust", "range"] and "stopped" not in row
    columns = MIXED.columns()
    assert columns["min_clearance_m"][2] == -0.001 and columns["broken_assumptions"][2] == "thrust; range"
    assert (columns["collided"][2], columns["stopped_because"][2]) == (1, "collision")


def test_a_collision_names_what_was_not_assumed():
    quick = plan("pool-behind")  # the overtaker goes 0.2 m/s, and more in some draws
    flown = run_campaign(quick, runs=40)
    hit = flown.table.column("collided") > 0.5
    assert 0 < hit.sum() < 40
    assert all("obstacle speed" in names for names, is_hit in zip(flown.table.broken, hit, strict=True) if is_hit)
    assert flown.summary.broken["obstacle speed"] == hit.sum()
    still = run_campaign(plan("tank-static"), runs=5).table.broken
    assert {name for names in still for name in names} <= {"margin"}  # nothing moves


def test_where_every_run_breaks_something_nothing_is_said_of_the_rest():
    told = summarise(table(("reached", 9.0, 0.1, ("margin",))))
    assert told.inside is None and told.to_dict()["collisions_within_assumptions"] is None
    lines = told.lines()
    assert "  every run violates an assumption of the no-contact claim" in lines
    violated = "margin, braking needs more than the gain margin (1 runs)"
    assert f"  violated assumptions of the no-contact claim: {violated}" in lines
    assert told.to_dict()["runs_by_broken_assumption"] == {"margin": 1}

"""What a run's levels gave up, against the decisions solved again one by one, and against known mixtures."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from surctl.marine.cli.runs import RunOutput
from surctl.marine.control import build_law, load_gains
from surctl.marine.report.signals import plot_priority, relaxation_text
from surctl.marine.simulation import Run, explain, load_scenario, priority_timeline, simulate
from surctl.marine.vehicle import load_vehicle
from surctl.priority import PriorityTimeline
from surctl.priority.solving import NOTICEABLE
from tests.pictures import blank_pictures


@cache
def flight(law: str = "guarded", mode: str = "lexicographic") -> Run:
    scenario = load_scenario("pool-behind")
    built = build_law(law, mode=mode)
    return simulate(scenario, load_vehicle(scenario.vehicle), gains=load_gains("default"), law=built)


@pytest.mark.parametrize(("law", "mode"), [("guarded", "lexicographic"), ("guarded", "nsb"), ("paper", "nsb")])
def test_every_tick_is_the_decision_solved_again(law: str, mode: str) -> None:
    run = flight(law, mode)
    found, record = priority_timeline(run), run.record
    assert found.levels == tuple(name for name, _, _ in run.law.levels)
    for k in range(0, len(record.time), 53):
        answer = run.law.explained(record.law_state[k], record.law_input[k], record.law_parameters)
        total = found.to_levels[k] + found.to_rows[k]
        assert total == pytest.approx([answer.residuals[name] for name in found.levels], abs=1e-12)
        assert {row for row, on in zip(found.rows, found.binding[k], strict=True) if on} == {
            r for r, _ in answer.binding
        }
        for row, by in answer.relaxed.items():
            assert by <= NOTICEABLE or found.missed[k, found.rows.index(row)] == by


def test_who_gave_up_what_to_which_row() -> None:
    run = flight()
    found = priority_timeline(run)
    lost = found.to_rows[:, 0] > NOTICEABLE
    assert found.eventful and lost.any() and not lost.all() and not (found.to_rows[:, 1:] > NOTICEABLE).any()
    # only a level that gave something up has rows to blame, and they are in the words of the explanations
    assert (found.causes.any(axis=2) == (found.to_rows > NOTICEABLE)).all()
    blamed = {row for k, row in enumerate(found.rows) if found.causes[:, 0, k].any()}
    told = " ".join(one.text for one in explain(run))
    assert blamed and all(f"`{row}`" in told for row in blamed)
    words = relaxation_text(found)
    assert words.startswith(f"velocity gave up at most {found.to_rows[:, 0].max():.2g} m/s because of contact_0")
    assert "depth gave up" not in words


def test_the_printed_stack_loses_to_levels_above_and_the_closed_form_nothing() -> None:
    paper = priority_timeline(flight("paper", "nsb"))
    assert paper.rows == () and paper.eventful
    words = relaxation_text(paper)
    assert "velocity gave up at most" in words and "because of the levels above it" in words
    quiet = priority_timeline(flight("closed_form", "nsb"))
    assert not quiet.eventful and relaxation_text(quiet) == "no level gave up anything"


def test_a_tick_that_the_law_refused_is_left_out() -> None:
    run = flight()
    status = run.record.status.copy()
    status[:3] = -1
    found = priority_timeline(replace(run, record=replace(run.record, status=status)))
    assert len(found.time) == len(run.record.time) - 3 and found.time[0] == run.record.time[3]
    refused = replace(run, record=replace(run.record, status=np.full_like(status, -1)))
    nothing = priority_timeline(refused)
    assert not nothing.eventful and nothing.to_rows.shape == (0, 3)
    plot_priority(nothing)


def test_the_picture_has_a_lane_a_level_and_bars_where_rows_hold_back() -> None:
    run = flight()
    found = priority_timeline(run)
    *levels, rows = plot_priority(found).axes
    assert [ax.get_ylabel().split(" [")[0] for ax in levels] == ["1 velocity", "2 depth", "3 heading"]
    assert [label.get_text() for label in rows.get_yticklabels()] == list(found.rows)
    drawn = [path.get_extents() for bars in rows.collections for path in bars.get_paths()]
    begins = found.time[np.argmax(found.binding.any(axis=1) | (found.missed > NOTICEABLE).any(axis=1))]
    assert min(box.x0 for box in drawn) == pytest.approx(begins)
    assert all(min(bars.get_linewidths()) >= 1.0 for bars in rows.collections)  # a bar of one period is seen
    assert [ax.texts[0].get_text() for ax in levels if ax.texts] == ["no residual"] * 2


def test_only_the_rows_that_matter_longest_are_drawn() -> None:
    count = 12
    held = np.tril(np.ones((count, count), dtype=bool))  # row k holds back in the last ticks from k on
    found = PriorityTimeline(
        time=np.arange(float(count)), levels=("a",), units=("m/s",), to_levels=np.zeros((count, 1)),
        to_rows=np.ones((count, 1)), rows=tuple(f"r{k}" for k in range(count)), binding=held,
        missed=np.zeros((count, count)), causes=held[:, None, :],
    )  # fmt: skip
    rows = plot_priority(found).axes[-1]
    assert [label.get_text() for label in rows.get_yticklabels()] == [f"r{k}" for k in range(8)]
    assert rows.texts[-1].get_text() == "4 more rows"
    some = "r0, r1, r2, r3 and 8 more rows"
    assert relaxation_text(found) == f"a gave up at most 1 m/s because of {some}, for 12 s in total"


def test_explained_runs_are_drawn_as_well(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blank_pictures(monkeypatch)
    result: dict[str, object] = {}
    lines = RunOutput(tmp_path, explained=True).further(flight(), result)
    (file,) = tmp_path.glob("*-priority.png")
    assert lines[-1] == f"  {file}" and result["explanations"]

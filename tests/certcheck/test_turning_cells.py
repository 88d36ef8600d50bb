"""Cells of headings of a turning cruise: each condition, and each largest value of several, decides alone."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from surctl.certcheck import turning_cells
from surctl.certcheck.document import Rejected
from surctl.certcheck.region_claim import triangle
from surctl.certcheck.turning_cells import Trim, _axis, _commanded, _fastest, _lack, _positive, check_shell, steady
from surctl.certcheck.turning_claim import TurningClaim, read_claim
from surctl.certcheck.turning_form import Form, Phase, axes_of
from surctl.certcheck.turning_terms import UP

F = Fraction
STORED: dict[str, Any] = json.loads((Path(__file__).parent / "region-turning-20.json").read_text())
CLAIM: TurningClaim = read_claim(STORED["claim"])
NONE = (F(0), F(0))


@cache
def setting() -> tuple[Trim, turning_cells.Cells, Form]:
    trim = steady(CLAIM, NONE)
    return trim, turning_cells.heading_cells(CLAIM, trim, 4), Form(triangle(STORED["proof"]["P"], 4, "P"))


@pytest.mark.parametrize(
    ("rows", "positive"),
    [([2, 1, 2], True), ([-1, 0, 1], False), ([1, 0, -1], False), ([1, 2, 1], False), ([1, 0, np.nan], False)],
)
def test_every_pivot_must_be_positive(rows: list[float], positive: bool) -> None:
    entries = dict(zip(((0, 0), (1, 0), (1, 1)), (np.array([1.0, x]) for x in rows), strict=True))
    entries[1, 0][0] = 0.0
    assert _positive(entries) is positive


def test_the_steady_command_stays_between_0_and_the_cap() -> None:
    assert steady(CLAIM, NONE).command == (CLAIM.cruise, CLAIM.cruise)
    fast, slow = replace(CLAIM, cap=F(99)), replace(CLAIM, cap=CLAIM.cruise + F(1, 1000))
    for claim, slopes in ((fast, (F(10), F(0))), (slow, (F(1, 10), F(0)))):
        with pytest.raises(Rejected, match="leaves the range from 0 to the speed cap"):
            steady(claim, slopes)


def test_the_largest_gain_of_the_current_counts() -> None:
    claim, one = replace(CLAIM, current=F(1, 1000)), F(1)
    found = steady(claim, NONE, ((one, one), (one, one), NONE))
    most = 1 + (max(claim.drag_factor) - 1)
    assert found.across == most / 1000 and found.moved == (-most / 1000, most / 1000)


def test_the_largest_change_of_speed_counts() -> None:
    trim, cells, _ = setting()
    one, other = (_lack(CLAIM, replace(trim, omega=ends), cells.share) for ends in ((F(-1), F(2)), (F(2), F(2))))
    assert np.array_equal(one, other) and not np.array_equal(one, _lack(CLAIM, trim, cells.share))
    assert _fastest(replace(trim, omega=(F(-3), F(1))))[0] == 3 * UP


def region(x: Fraction, y: Fraction) -> Any:
    return SimpleNamespace(exact=[[x * x, F(0)], [F(0), y * y]])


def test_the_law_has_one_form_in_the_region() -> None:
    trim, small = setting()[0], F(1, 1000)
    _commanded(CLAIM, trim, region(small, small), F(1))
    with pytest.raises(Rejected, match="the speed cap is below the steady command"):
        _commanded(CLAIM, trim, region(small, F(100)), F(1))
    with pytest.raises(Rejected, match="would command backward motion"):
        _commanded(CLAIM, trim, region(2 * CLAIM.cruise / CLAIM.k1, small), F(1))
    moved = replace(trim, moved=(-F(1, 10), small))
    wait = 2 * (small + F(1, 10) / CLAIM.k1)  # up to rounding
    _commanded(replace(CLAIM, wait=wait * F(101, 100)), moved, region(small, small), F(1))
    with pytest.raises(Rejected, match="the path's target waits"):
        _commanded(replace(CLAIM, wait=wait * F(99, 100)), moved, region(small, small), F(1))


def axis(claim: TurningClaim, trim: Trim) -> np.ndarray:
    _, cells, form = setting()
    plans = [np.eye(2)]
    return _axis(claim, trim, form, 0, axes_of(cells.corners[1])[0], cells.share[1, 0], plans, 1.0)


def test_an_axis_has_thrust_left_and_a_command_across_adds_to_its_speed() -> None:
    trim = setting()[0]
    with pytest.raises(Rejected, match="needs all the thrust of an axis"):
        axis(replace(CLAIM, thrust=(F(1, 10**6),) * 2), trim)
    strong = replace(CLAIM, thrust=(F(10**6),) * 2)
    still, drifting = axis(strong, trim), axis(strong, replace(trim, across=F(1, 100)))
    assert drifting[:, 0].max() > still[:, 0].max()


def shell(monkeypatch: pytest.MonkeyPatch, claim: TurningClaim = CLAIM, **patches: Any) -> list[Any]:
    """What bounds the disturbance in each cell of a shell."""
    trim, cells, form = setting()
    met: list[Any] = []
    monkeypatch.setattr(turning_cells, "_commanded", lambda *_: ([0.1, 0.2], [0.1, 0.2]))
    monkeypatch.setattr(turning_cells, "decays", lambda *words: met.append(words[8]) or True)
    for name, value in patches.items():
        monkeypatch.setattr(turning_cells, name, value)
    check_shell(claim, trim, cells, form, F(1, 2), F(1), F(0), NONE, Phase())
    return met


def test_every_cell_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    trim, cells, form = setting()
    assert len(shell(monkeypatch)) == 4
    for k in range(4):
        left = iter(range(4))
        monkeypatch.setattr(turning_cells, "decays", lambda *_, k=k, left=left: next(left) != k)
        with pytest.raises(Rejected, match="near a heading of"):
            check_shell(CLAIM, trim, cells, form, F(1, 2), F(1), F(0), NONE, Phase())


def test_a_force_accelerates_the_lightest_mass_most(monkeypatch: pytest.MonkeyPatch) -> None:
    masses = [(1.0, 2.0, 0.0), (3.0, 1.0, -1.0), (1.0, 1.0, 0.5)]
    met = shell(monkeypatch, outer_force=lambda *_: 1.0, inverse_masses=lambda *_: masses)
    assert met[0].stray == pytest.approx(4.0)


def test_with_held_commands_each_axis_is_free_or_at_its_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    both = np.array([[1.0, 1.0, 1.0, 1.0], [0.5, 0.5, 1.0, 0.0]])
    held = replace(CLAIM, period=F(1, 20))
    met = shell(monkeypatch, held, _axis=lambda *_: both.copy())
    assert [one.moves for one in met] == 4 * [(1, 1), (1, 0), (0, 1), (0, 0)]
    trim, cells, form = setting()
    weak = replace(held, thrust=(F(30),) * 2)
    rows = _axis(weak, trim, form, 0, axes_of(cells.corners[1])[0], cells.share[1, 0], [np.eye(2)], 1.0)
    free = rows[rows[:, 3] == 1]
    gain = float(weak.mass[0] * weak.k_v)
    assert len(rows) == 10 and len(free) == 4 and np.all(free[:, 1] == gain)
    assert rows[:, 1].min() < gain and np.all(rows[rows[:, 1] < gain, 3] == 0)
    assert len(_axis(replace(weak, lag=(F(1), F(1))), trim, form, 0, axes_of(cells.corners[1])[0], cells.share[1, 0],
                     [np.eye(2)], 1.0)) == 12  # fmt: skip


def test_a_limited_command_acts_at_the_end_of_a_period(monkeypatch: pytest.MonkeyPatch) -> None:
    trim, cells, form = setting()
    met: list[Any] = []
    both = np.array([[1.0, 1.0, 1.0, 1.0], [0.5, 0.5, 1.0, 0.0]])
    monkeypatch.setattr(turning_cells, "_axis", lambda *_: both.copy())
    monkeypatch.setattr(turning_cells, "_commanded", lambda *_: ([0.1, 0.2], [0.1, 0.2]))
    monkeypatch.setattr(turning_cells, "decays", lambda *words: met.append(words[4]) or True)
    check_shell(replace(CLAIM, period=F(1, 20)), trim, cells, form, F(1, 2), F(1), F(0), NONE, Phase(begins=False))
    assert len(met) == 4 and all(pair.tolist() == [[0.5, 0.5, 1.0]] for pairs in met for pair in pairs)

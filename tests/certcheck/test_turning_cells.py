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
from surctl.certcheck.region_exact import inverse
from surctl.certcheck.turning import triangle
from surctl.certcheck.turning_cells import Setting, Trim, _lack, check_shell, steady
from surctl.certcheck.turning_claim import TurningClaim, read_claim
from surctl.certcheck.turning_form import Extent, Form, Phase, axes_of
from surctl.certcheck.turning_matrix import Inclusion, indefinite

F = Fraction
STORED: dict[str, Any] = json.loads((Path(__file__).parent / "region-turning-20.json").read_text())
CLAIM: TurningClaim = read_claim(STORED["claim"])
NONE = (F(0), F(0))


@cache
def setting() -> tuple[Trim, turning_cells.Cells, Form, Extent]:
    trim, p = steady(CLAIM, NONE), triangle(STORED["proof"]["P"], 4, "P")
    return trim, turning_cells.heading_cells(CLAIM, trim, 4), Form.of(p), Extent.of(inverse(p))


@pytest.mark.parametrize(
    ("rows", "positive"),
    [([2, 1, 2], True), ([-1, 0, 1], False), ([1, 0, -1], False), ([1, 2, 1], False), ([1, 0, np.nan], False)],
)
def test_every_pivot_must_be_positive(rows: list[float], positive: bool) -> None:
    entries = dict(zip(((0, 0), (1, 0), (1, 1)), (np.array([1.0, x]) for x in rows), strict=True))
    entries[1, 0][0] = 0.0
    assert indefinite(entries).tolist() == [False, not positive]


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
    trim, cells, _, extent = setting()
    one, other = (_lack(CLAIM, replace(trim, omega=ends), cells.share) for ends in ((F(-1), F(2)), (F(2), F(2))))
    assert np.array_equal(one, other) and not np.array_equal(one, _lack(CLAIM, trim, cells.share))
    held = replace(CLAIM, period=F(1, 20))
    low, high, small = (
        Setting(held, replace(trim, omega=ends), cells).bounds(extent, F(1), NONE).base.late
        for ends in ((F(-3), F(1)), (F(-1), F(3)), (F(-1), F(1)))
    )
    assert np.array_equal(low, high) and np.all(low > small)


def region(x: Fraction, y: Fraction) -> Any:
    return SimpleNamespace(size=lambda k, _: (x, y)[k])


def test_the_law_has_one_form_in_the_region() -> None:
    trim, cells, small = *setting()[:2], F(1, 1000)
    own = Setting(CLAIM, trim, cells)
    own.commanded(region(small, small), F(1))
    with pytest.raises(Rejected, match="the speed cap is below the steady command"):
        own.commanded(region(small, F(100)), F(1))
    with pytest.raises(Rejected, match="would command backward motion"):
        own.commanded(region(2 * CLAIM.cruise / CLAIM.k1, small), F(1))
    moved = replace(own, trim=replace(trim, moved=(-F(1, 10), small)))
    wait = 2 * (small + F(1, 10) / CLAIM.k1)  # up to rounding
    replace(moved, claim=replace(CLAIM, wait=wait * F(101, 100))).commanded(region(small, small), F(1))
    with pytest.raises(Rejected, match="the path's target waits"):
        replace(moved, claim=replace(CLAIM, wait=wait * F(99, 100))).commanded(region(small, small), F(1))


def axis(claim: TurningClaim, trim: Trim) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
    _, cells, _, extent = setting()
    axes = axes_of(cells.corners)[0][0]
    led = extent.largest(np.eye(2)[None], np.zeros((2, 2)), axes, 1.0)
    return Setting(claim, trim, cells).loops(extent, 0, axes, np.eye(2)[None], led, 1.0)


def test_an_axis_has_thrust_left_and_a_command_across_adds_to_its_speed() -> None:
    trim = setting()[0]
    with pytest.raises(Rejected, match="needs all the thrust of an axis"):
        axis(replace(CLAIM, thrust=(F(1, 10**6),) * 2), trim)
    strong = replace(CLAIM, thrust=(F(10**6),) * 2)
    still, drifting = axis(strong, trim), axis(strong, replace(trim, across=F(1, 100)))
    assert still[1] is None and np.all(drifting[0][1:, :, 0].max(axis=1) > still[0][1:, :, 0].max(axis=1))


ONES = {(0, 0): np.ones(1)}


def shell(
    monkeypatch: pytest.MonkeyPatch, claim: TurningClaim = CLAIM, phase: Phase | None = None, **patches: Any
) -> list[Any]:
    """The vertices of each cell of a shell."""
    trim, cells, form, extent = setting()
    met: list[Any] = []
    monkeypatch.setattr(Setting, "commanded", lambda *_: ([0.1, 0.2], [0.1, 0.2]))
    monkeypatch.setattr(Inclusion, "losses", lambda self, *_: met.append(self) or ONES)
    for name, value in patches.items():
        monkeypatch.setattr(turning_cells, name, value)
    own = Setting(claim, trim, cells)
    check_shell(own, own.bounds(extent, F(1), NONE), form, phase or Phase(), (F(1, 2), F(1), F(0), F(0)))
    return met


def test_every_cell_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(shell(monkeypatch)) == 4
    trim, cells, form, extent = setting()
    own = Setting(CLAIM, trim, cells)
    bounds = own.bounds(extent, F(1), NONE)
    for k in range(4):
        left = iter(range(4))
        bad = {(0, 0): np.array([1.0, -1.0])}
        monkeypatch.setattr(Inclusion, "losses", lambda *_, k=k, left=left, bad=bad: bad if next(left) == k else ONES)
        with pytest.raises(Rejected, match="near a heading of"):
            check_shell(own, bounds, form, Phase(), (F(1, 2), F(1), F(0), F(0)))


def test_a_force_accelerates_the_lightest_mass_most(monkeypatch: pytest.MonkeyPatch) -> None:
    masses = [(1.0, 2.0, 0.0), (3.0, 1.0, -1.0), (1.0, 1.0, 0.5)]
    met = shell(monkeypatch, outer_force=lambda *_: 1.0, inverse_masses=lambda *_: masses)
    assert met[0].stray == pytest.approx(4.0)


FREE, LIMITED = np.ones((4, 1, 3)), np.full((4, 1, 3), 0.5)
HELD = replace(CLAIM, period=F(1, 20))


def test_with_held_commands_each_axis_is_free_or_at_its_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    trim = setting()[0]
    weak = replace(HELD, thrust=(F(30),) * 2)
    free, limited, active = axis(weak, trim)
    gain = float(weak.mass[0] * weak.k_v)
    assert limited is not None and active.any() and free.shape[1] == 4 and limited.shape[1] == 6
    assert np.all(free[:, :, 1] == gain) and limited[active, :, 1].min() < gain
    late = axis(replace(weak, lag=(F(1), F(1))), trim)[1]
    assert late is not None and late.shape[1] == 8
    monkeypatch.setattr(Setting, "loops", lambda *_: (FREE, LIMITED, np.array([True, True, True, False])))
    met = shell(monkeypatch, HELD, Phase(split=1.0, fall=1.0))
    moved = [(tuple(one.moves[:, 0]), [float(loops[0, 0, 0]) for loops in one.loops]) for one in met]
    assert moved == [
        *4 * [((1, 1), [1.0, 1.0])], *3 * [((1, 0), [1.0, 0.5])], *3 * [((0, 1), [0.5, 1.0])],
        *3 * [((0, 0), [0.5, 0.5])],
    ]  # fmt: skip


def test_a_limited_command_acts_at_the_end_of_a_period(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Setting, "loops", lambda *_: (FREE, LIMITED, np.full(4, True)))
    met = shell(monkeypatch, HELD, Phase(fall=1.0, begins=False))
    assert len(met) == 4 and all(np.all(loops == 0.5) for one in met for loops in one.loops)

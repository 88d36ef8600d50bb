from __future__ import annotations

import numpy as np
import pytest

from surctl.marine.report.margin_plots import plot_locus
from surctl.marine.verification.linear_table import Locus

VALUES = np.array([1.0, 2.0, 3.0])


def locus(fast: float) -> Locus:
    """A pair that gets faster, a real pole, and three that are the delay's."""
    pair = -0.5 * VALUES + 1j * VALUES
    still = np.full(3, -fast + 0j)
    return Locus("k_v", VALUES, np.column_stack([pair, pair.conj(), -0.1 * VALUES, still, still, still]))


@pytest.mark.parametrize(("fast", "edge"), [(60.0, 1.15 * np.hypot(1.5, 3.0)), (5.0, 1.15 * 5.0)])
def test_the_poles_of_the_delay_are_left_out_where_a_gap_parts_them(fast: float, edge: float) -> None:
    ax = plot_locus(locus(fast), unit="1/s", picked=2.1)
    assert ax.get_xlim()[0] == pytest.approx(-edge) and ax.get_ylim() == pytest.approx((-edge, edge))


def test_every_pole_is_a_point_and_start_and_pick_are_marked() -> None:
    ax = plot_locus(locus(60.0), picked=2.1)
    assert [len(points.get_offsets()) for points in ax.collections] == [18]
    marks = {line.get_label(): line.get_xydata() for line in ax.lines}
    assert [-0.5, 1.0] in marks["start: 1"].tolist() and [-1.0, 2.0] in marks["picked: 2"].tolist()

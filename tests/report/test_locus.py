"""The root locus of any loops: every pole, and those that are marked."""

from __future__ import annotations

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.report import plot_locus
from surctl.system import LinearLoop, linearise
from surctl.testing import cart_system
from surctl.tuning.loop_responses import rates

VALUES = [1.0, 2.0, 4.0]


def test_every_pole_is_a_point_and_start_and_pick_are_marked() -> None:
    loops = [linearise(cart_system(k)) for k in VALUES]
    ax = plot_locus(loops, VALUES, "k", unit="1/s", picked=2.1)
    marks = {line.get_label(): line.get_xydata() for line in ax.lines}
    [points] = ax.collections
    places = [np.column_stack([rates(loop).real, rates(loop).imag]) for loop in loops]
    np.testing.assert_array_equal(points.get_offsets(), np.concatenate(places))
    np.testing.assert_array_equal(points.get_array(), np.repeat(VALUES, [len(place) for place in places]))
    np.testing.assert_array_equal(marks["start: 1"], places[0])
    np.testing.assert_array_equal(marks["picked: 2"], places[1])


@pytest.mark.parametrize("loops", [[], [linearise(cart_system(1.0))]])
def test_a_value_for_each_loop(loops: list[LinearLoop]) -> None:
    with pytest.raises(InputError, match="give one for each loop"):
        plot_locus(loops, VALUES[: 2 * len(loops)], "k")


def test_without_a_choice_only_the_start_is_marked() -> None:
    ax = plot_locus([linearise(cart_system(k)) for k in VALUES], VALUES, "k")
    assert [line.get_label() for line in ax.lines] == ["start: 1", "stability boundary"]
    low, high = ax.get_xlim()
    assert low < min(rates(linearise(cart_system(4.0))).real) and high > 0

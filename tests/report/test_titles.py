"""Titles stay inside their pictures."""

import pytest
from matplotlib.figure import Figure

from surctl.report.theme import dress, new_axes

LONG = "tank-speed-025: my-vehicle-of-2026, law surctl_guarded (lexicographic), sonar, seed 4294967295"


@pytest.mark.parametrize(
    ("width", "height", "reach"), [(7.0, 4.5, (8.0, 3.0)), (7.0, 4.5, (3.0, 8.0)), (9.5, 3.0, (10, 1))]
)
def test_a_long_title_of_a_plan_view_is_broken_and_not_clipped(width, height, reach) -> None:
    ax = dress(new_axes(width, height), title=LONG, x="x [m]", y="y [m]")
    ax.plot([0, reach[0]], [0, reach[1]])
    ax.set_aspect("equal")
    figure = ax.figure
    assert isinstance(figure, Figure)
    figure.draw_without_rendering()
    figure.draw_without_rendering()
    box = ax._left_title.get_window_extent()
    assert box.x0 >= 0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1

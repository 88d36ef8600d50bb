"""Titles and labels stay inside their pictures."""

from dataclasses import replace

import pytest
from matplotlib.figure import Figure

from surctl.report import margin_slice, plot_slice
from surctl.report.theme import dress, head, new_axes, new_figure
from tests.report.data import verdict

LONG = "tank-speed-025: my-vehicle-of-2026, law surctl_guarded (lexicographic), sonar, seed 4294967295"


def outside(figure: Figure) -> list[str]:
    """Titles, axis labels and legend texts of a figure that stick out of it."""
    figure.draw_without_rendering()
    texts = [*figure.texts]
    for ax in figure.axes:
        texts += [ax.title, ax._left_title, ax._right_title, ax.xaxis.label, ax.yaxis.label]
        texts += ax.get_legend().get_texts() if ax.get_legend() else []
    found = []
    for text in texts:
        box = text.get_window_extent()
        inside = box.x0 >= -1 and box.x1 <= figure.bbox.x1 + 1 and box.y0 >= -1 and box.y1 <= figure.bbox.y1 + 1
        if text.get_text() and not inside:
            found.append(text.get_text())
    return found


@pytest.mark.parametrize("more", ["", " $", " $a$ and $b$"])
@pytest.mark.parametrize(
    ("width", "height", "reach"), [(7.0, 4.5, (8.0, 3.0)), (7.0, 4.5, (3.0, 8.0)), (9.5, 3.0, (10, 1))]
)
def test_a_long_title_of_a_plan_view_is_broken_and_not_clipped(width, height, reach, more) -> None:
    ax = dress(new_axes(width, height), title=LONG + more, x="x [m]", y="y [m]")
    ax.plot([0, reach[0]], [0, reach[1]])
    ax.set_aspect("equal")
    figure = ax.figure
    assert isinstance(figure, Figure)
    figure.draw_without_rendering()
    assert outside(figure) == []


@pytest.mark.parametrize("more", ["", " $a$ and $b$"])
def test_a_long_title_of_a_figure_and_long_labels_are_not_clipped(more: str) -> None:
    figure = new_figure(6.0, 3.0)
    head(figure, LONG + more)
    dress(figure.add_subplot(), x=LONG, y=LONG[:60])
    figure.draw_without_rendering()
    assert outside(figure) == []


def test_the_scale_of_a_claim_with_a_long_unit_is_not_clipped() -> None:
    found = verdict("v1-printed")
    ax = plot_slice(margin_slice(replace(found, claim=replace(found.claim, unit="kg m^2/s^3 for each metre of depth"))))
    assert isinstance(ax.figure, Figure)
    assert outside(ax.figure) == []

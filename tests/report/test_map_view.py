"""The map of a run, unrolled from its torus, and its picture."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import QuadMesh

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.report import map_view, plot_map, plot_maps
from surctl.marine.sensing import LocalMap
from surctl.marine.simulation import Run, Sensing, load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from surctl.marine.world import Heights
from tests.tools import need_compiler


@cache
def _run(sensing: Sensing = "sonar") -> Run:
    scenario = load_scenario("pool-behind")
    return simulate(scenario, load_vehicle(scenario.vehicle), gains=load_gains("default"), sensing=sensing, seed=0)


def drawn(ax: Axes) -> Axes:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        FigureCanvasAgg(ax.figure.figure).draw()
    return ax


@given(
    st.integers(1, 4), st.integers(1, 3), st.tuples(st.integers(-30, 30), st.integers(-30, 30)), st.integers(0, 10_000)
)
def test_a_cell_is_found_where_it_lies(blocks: int, block: int, corner: tuple[int, int], seed: int) -> None:
    side = blocks * block
    cells = np.random.default_rng(seed).random(side * side)
    laid, _, _ = LocalMap(dt=0.05, blocks=blocks, block=block).view(cells, np.array(corner, dtype=float))
    for row in range(side):
        for column in range(side):
            x, y = (corner[0] + column) % side, (corner[1] + row) % side  # where on the torus
            at = ((y // block) * blocks + x // block) * block * block + (y % block) * block + x % block
            assert laid[row, column] == cells[at]


def test_the_window_lies_around_the_robot_and_its_hull_is_free() -> None:
    run = _run()
    for tick in (20, 100, 200):  # the first fix has arrived
        view = map_view(run, tick)
        side = len(view.kinds)
        at = run.record.eta[tick, :2]
        # in the middle of it, but where it would look beyond a wall
        room = np.maximum(np.array(run.scenario.site[:2]) - view.edge * side, 0.0)
        low = np.clip(at - view.edge * side / 2, 0.0, room)
        np.testing.assert_allclose(view.corner, low, atol=view.edge + 0.05)
        assert view.edge == pytest.approx(run.vehicle["radius"] / 4)
        x, y = (view.corner[k] + view.edge * (np.arange(side) + 0.5) for k in (0, 1))
        gap = np.hypot(*np.meshgrid(x - at[0], y - at[1]))
        assert np.all(view.kinds[gap < run.vehicle["radius"] - 0.05] == 1)
        assert view.time == pytest.approx(0.05 * tick) and len(view.track) == tick + 1


def test_what_is_free_lies_within_the_walls() -> None:
    """A cell at the wrong side of the torus, or x for y, would lie beyond them."""
    run = _run()
    view = map_view(run, 200)
    side = len(view.kinds)
    x, y = (view.corner[k] + view.edge * (np.arange(side) + 0.5) for k in (0, 1))
    length, width, _ = run.scenario.site
    within = (
        (x > -view.edge)[None, :] & (x < length + view.edge) & ((y > -view.edge) & (y < width + view.edge))[:, None]
    )
    assert np.all(view.kinds[~within] == 0) and (~within).sum() > 100
    assert (view.kinds[within] == 1).mean() > 0.5


def test_a_map_is_drawn_where_it_lies() -> None:
    run = _run()
    view = map_view(run, 150)
    ax = drawn(plot_map(run, view))
    (mesh,) = (c for c in ax.collections if isinstance(c, QuadMesh))
    corners = mesh.get_coordinates()
    np.testing.assert_allclose(corners[0, 0], view.corner)
    np.testing.assert_allclose(corners[-1, -1], view.corner + view.edge * len(view.kinds))
    np.testing.assert_array_equal(np.asarray(mesh.get_array()).reshape(view.kinds.shape), view.kinds)
    assert ax.get_aspect() == 1.0


def test_several_maps_share_a_title_and_a_legend() -> None:
    run = _run()
    first = drawn(plot_maps(run, [map_view(run, k) for k in (10, 60, 110)]))
    figure = first.figure.figure
    shown = [ax for ax in figure.axes if ax.axison]
    assert [ax.get_title(loc="left") for ax in shown] == ["0.5 s", "3.0 s", "5.5 s"]
    assert "pool-behind" in figure.get_suptitle()
    words = {text.get_text() for text in figure.legends[0].get_texts()}
    assert words >= {"map: unknown", "map: free", "map: marked", "true moving obstacle"}
    with pytest.raises(InputError, match="at least"):
        plot_maps(run, [])


def test_what_has_no_map_is_refused() -> None:
    with pytest.raises(InputError, match="has no map"):
        map_view(_run("truth"), 0)
    run = _run()
    for tick in (-1, len(run.record.time) - 1):
        with pytest.raises(InputError, match="step"):
            map_view(run, tick)


def test_what_is_passed_over_is_dotted_and_told() -> None:
    need_compiler()
    flown = _run()
    low = [[replace(b, moving=False, heights=Heights(top=-1.0)) for b in bodies] for bodies in flown.record.obstacles]
    over = replace(
        flown,
        record=replace(flown.record, obstacles=low),
        scenario=replace(flown.scenario, depths=(-0.9, 0.0)),
    )
    views = [map_view(flown, 40)]
    ax = drawn(plot_maps(over, views))
    assert {p.get_linestyle() for p in ax.patches} >= {":"} and f"z {flown.record.eta[40, 2]:.2f} m" in ax.get_title(
        loc="left"
    )
    told = [text.get_text() for text in ax.figure.figure.legends[0].get_texts()]
    assert "passed above or below" in told
    plain = drawn(plot_maps(flown, views))
    assert ":" not in {p.get_linestyle() for p in plain.patches}
    assert "passed above or below" not in [text.get_text() for text in plain.figure.figure.legends[0].get_texts()]

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle, Wedge

from surctl.errors import InputError
from surctl.lyapunov import Dynamics, State
from surctl.marine.control import build_law
from surctl.marine.guidance import Path as Route
from surctl.marine.report import plot_run, save_run
from surctl.marine.report.signals import plot_run_signals, spans
from surctl.marine.simulation import Run, load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import law_loop
from surctl.report import margin_slice, plot_counterexample, plot_heat_map, plot_motion, plot_parallel, plot_slice
from surctl.report.evidence import _sense, plot_replay
from surctl.report.page_parts import plot_tightest
from surctl.report.system_plots import plot_sobol_indices
from surctl.report.theme import BAD, printable, save_figure
from surctl.tuning import SobolIndices, SweepTable
from surctl.verification import evaluate, replay, system_margins
from surctl.verification.formula import parse, variable
from tests.pictures import rendered
from tests.report.data import GAINS, report, run, sweep, swept, vehicle, verdict


def first_tick(flown: Run) -> Run:
    """A run that ended where it began."""
    r = flown.record
    short = {k: v[:1] for k, v in vars(r).items() if k != "law_parameters" and v is not None}
    metrics = replace(flown.metrics, time_s=0.0, length_m=0.0, reached=False, stopped_because="fault")
    return replace(flown, record=replace(r, **short), metrics=metrics)


def odd(flown: Run) -> Run:
    return replace(flown, scenario=replace(flown.scenario, name="$\\frac{$ 潜水 \t<b>", title="$"))


RUNS = {
    "boxes": lambda: run("tank-static", limit=3.0),
    "drifting": lambda: run("pool-static", "sonar", 4.0),
    "first tick, sonar, odd names": lambda: odd(first_tick(run(sensing="sonar"))),
    "no obstacle": lambda: simulate(
        replace(load_scenario("pool-behind"), obstacles=(), time_limit=1.0), run().vehicle, gains=GAINS
    ),
}


@pytest.mark.parametrize("name", RUNS)
def test_runs_are_drawn_without_a_warning(name: str) -> None:
    flown = RUNS[name]()
    plan = plot_run(flown)
    rendered(plan)
    assert plan.get_position().width > 0.75  # wide sites fill the width
    rendered(plot_run_signals(flown))


def test_the_plan_view_holds_what_was_flown() -> None:
    flown = run(sensing="sonar")
    ax = plot_run(flown)
    assert ax.get_aspect() == 1.0
    hulls = [p for p in ax.patches if isinstance(p, Circle) and p.get_radius() == pytest.approx(0.2)]
    middles = np.array([h.get_center() for h in hulls])
    assert np.any(np.all(np.isclose(middles, flown.record.eta[0, :2]), axis=1))
    assert np.any(np.all(np.isclose(middles, flown.record.eta[-1, :2]), axis=1))
    assert sum(isinstance(p, Wedge) for p in ax.patches) == 4
    assert not any(isinstance(p, Wedge) for p in plot_run(run()).patches)
    way = np.concatenate([s for c in ax.collections for s in c.get_segments()])
    assert len(way) == 2 * (len(flown.record.time) - 1)


def test_the_legend_names_only_what_is_drawn() -> None:
    near = replace(load_scenario("tank-speed-010"), obstacles=(), time_limit=2.0)
    for flown, present in ((run(), True), (simulate(near, vehicle(), gains=GAINS), False)):
        legend = plot_run(flown).get_legend()
        assert legend is not None
        assert ("obstacle" in {text.get_text() for text in legend.get_texts()}) == present
        assert ("avoiding" in {text.get_text() for text in legend.get_texts()}) == present


def test_the_picture_of_a_region_has_its_name() -> None:
    names = {name: variable(name) for name in ("x", "y")}
    states = (State("x", -0.1, 0.1, "m/s"), State("y", -3.0, 3.0, "m"))
    loop = Dynamics("spring", "continuous", states, (parse("-x - y", names), names["x"]))
    figure = plot_motion(loop, parse("x^2 + y^2", names), level=0.005)
    assert figure.get_suptitle() == "spring: certified region"
    assert len(figure.axes[0].get_xticks()) <= 8


def test_the_plan_view_says_where_the_depth_was_changed() -> None:
    scenario = load_scenario(str(Path(__file__).parents[1] / "simulation" / "scenarios" / "tank-sill.toml"))
    near = replace(scenario, path=Route(np.array([[4.0, 2.5], [9.5, 2.5]])), time_limit=80.0)
    flown = simulate(near, vehicle(), gains=GAINS.with_values({"patience": 5.0}))
    ax = plot_run(flown)
    rendered(ax)
    texts = {text.get_text() for text in ax.texts}
    assert {"to z -1.41", "to z -2.00", "sill, below z -1.8 m"} <= texts
    legend = ax.get_legend()
    assert legend is not None and "at another depth" in {text.get_text() for text in legend.get_texts()}
    white = [c for c in ax.collections if isinstance(c, LineCollection) and np.all(c.get_colors() == 1.0)]
    level = np.abs(flown.telemetry("depth_reference")[:-1, 0] + 2.0) > 1e-9
    assert [len(c.get_segments()) for c in white] == [np.count_nonzero(level)]


def test_given_axes_are_used_and_nothing_global_is_touched() -> None:
    before = dict(mpl.rcParams)
    figure = Figure()
    ax = figure.add_subplot()
    assert plot_run(run(), ax) is ax
    six = Figure().subplots(3, 2).ravel().tolist()
    assert plot_run_signals(run(), six) is six[0].figure
    assert dict(mpl.rcParams) == before


def test_the_signals_show_limits_and_avoidance() -> None:
    flown = run("tank-static", limit=3.0)
    clearance, _, _, _, force, _ = plot_run_signals(flown).axes
    levels = {round(float(np.ravel(line.get_ydata())[0]), 9) for line in force.lines if len(line.get_xdata()) == 2}
    assert {5.0, -5.0} <= levels
    shown = next(line for line in clearance.lines if line.get_label() == "true")
    np.testing.assert_array_equal(shown.get_ydata(), flown.record.clearance)


def test_the_limit_ahead_is_not_the_one_astern() -> None:
    flown = replace(run(), vehicle=load_vehicle("otter"))
    lines = [line for line in plot_run_signals(flown).axes[4].lines if line.get_color() == BAD]
    levels = {round(float(np.ravel(line.get_ydata())[0]), 3) for line in lines}
    assert levels == {-133.416, 0.0, 239.364, -0.0}


def test_spans_last_until_the_next_tick() -> None:
    time = np.array([0.0, 1.0, 2.0, 3.0])
    assert spans(time, np.array([True, False, True, True])) == [(0.0, 1.0), (2.0, 3.0)]
    assert spans(time, np.zeros(4, dtype=bool)) == []
    assert spans(time, np.ones(4, dtype=bool)) == [(0.0, 3.0)]


def test_what_the_font_lacks_is_replaced() -> None:
    assert printable("η\tν 潜\n√") == "η ν ? √"


def test_the_tightest_loops_are_drawn() -> None:
    (loop,) = report().loops.values()
    delays = {m.name: m.delay_margin_s for m in system_margins(loop)}
    figures = plot_tightest(report().loops)
    for opening, group in zip(figures, (loop.names.commands, loop.names.outputs), strict=True):
        assert opening in group and delays[opening] <= min(delays[name] for name in group) * 1.01
        assert any(f"opened at {opening}" in ax.get_title("left") for ax in rendered(figures[opening]).axes)
    fast = law_loop(build_law("guarded"), vehicle(), GAINS.with_values({"k_psi": 60.0}), cruise=0.15).linear
    lines = {ax.get_title("left"): ax.lines for ax in plot_tightest({"fast": fast})["surge"].axes}
    assert lines["Poles of the closed loop"] and not lines["Sensitivity |S|"]


def test_the_heat_map_marks_and_hatches_the_right_cells() -> None:
    ax = plot_heat_map(sweep(picked=(2, 1)), "score")
    rendered(ax)
    frames = [p for p in ax.patches if isinstance(p, Rectangle)]
    assert [p.get_xy() for p in frames if p.get_hatch()] == [(-0.5, 0.5)]
    assert {p.get_xy() for p in frames if not p.get_hatch()} == {(1.5, 0.5)}
    np.testing.assert_array_equal(ax.images[0].get_array(), sweep(picked=(2, 1)).column("score").T)
    assert [t.get_text() for t in ax.get_xticklabels()] == ["0.6", "0.9", "1.2"]
    assert ax.get_xlabel() == "lookahead [m]" and ax.get_ylabel() == "k_v [1/s]"


def test_the_heat_map_takes_what_is_not_a_number() -> None:
    assert "–" in [t.get_text() for t in plot_heat_map(sweep(), "path_error_m").texts]
    assert "∞" in [t.get_text() for t in plot_heat_map(sweep(), "delay_margin_s").texts]
    nothing = sweep(picked=None)
    for value in (np.nan, 1.0):
        columns = {"score": np.full(nothing.shape, value), "feasible": nothing.column("feasible")}
        rendered(plot_heat_map(swept({"lookahead": (0.6, 0.9, 1.2), "k_v": (1.0, 2.0)}, columns), "score"))
    with pytest.raises(InputError, match="score"):
        plot_heat_map(sweep(), "scores")


def cube() -> SweepTable:
    """Three axes; the score is least at (1, 0, 2)."""
    axes = {"lookahead": (0.6, 0.9, 1.2), "k_v": (1.0, 2.0), "vehicle.m11": (40.0, 50.0, 60.0, 70.0)}
    score = np.arange(24.0).reshape(3, 2, 4) + 1
    score[1, 0, 2] = 0.5
    return swept(axes, {"score": score, "feasible": np.ones((3, 2, 4))})


def test_the_heat_map_of_a_cost_frames_the_least() -> None:
    cost = np.array([[3.0, np.inf], [1.0, 2.0], [np.nan, 4.0]])
    ax = plot_heat_map(swept({"k_p": (1, 2, 4), "k_d": (0.5, 1.5)}, {"settling": cost}), "settling")
    drawn = ax.images[0].get_array()
    assert drawn.shape == (2, 3) and [drawn[0, 0], drawn[1, 2]] == [3.0, 4.0] and bool(drawn.mask[0, 2])
    assert [text.get_text() for text in ax.texts] == ["3", "1", "–", "∞", "2", "4"]
    assert {patch.get_xy() for patch in ax.patches} == {(0.5, -0.5)}
    nothing = swept({"k_p": (1,), "k_d": (1,)}, {"settling": np.array([[np.nan]])})
    assert not plot_heat_map(nothing, "settling").patches


def test_the_heat_map_cuts_a_grid_of_three_axes_at_the_picked_value() -> None:
    table = cube()
    score = table.column("score")
    ax = plot_heat_map(table, "score")
    np.testing.assert_array_equal(ax.images[0].get_array(), score[:, :, 2].T)
    assert "vehicle.m11 = 60" in ax.get_title(loc="left")
    ax = plot_heat_map(table, "score", over=("vehicle.m11", "lookahead"))
    np.testing.assert_array_equal(ax.images[0].get_array(), score[:, 0, :])
    assert {p.get_xy() for p in ax.patches if isinstance(p, Rectangle)} == {(1.5, 0.5)}
    for over, word in ((("k_v", "k_v"), "both axes"), (("kv", "lookahead"), "'k_v'")):
        with pytest.raises(InputError, match=word):
            plot_heat_map(table, "score", over=over)


def test_parallel_coordinates_are_the_points() -> None:
    points = {"lookahead": (0.6, 1.2, 0.9), "k_v": (1.0, 3.0, 2.0)}
    columns = {"score": np.array([3.0, 1.0, np.inf]), "feasible": np.array([1.0, 1.0, 0.0])}
    table = swept(points, columns, design="lhs")
    ax = plot_parallel(table, ["score"])
    rendered(ax)
    bad, good, picked = (c for c in ax.collections if isinstance(c, LineCollection))
    np.testing.assert_allclose(picked.get_segments(), [[[0, 1], [1, 1], [2, 0]]])
    np.testing.assert_allclose(good.get_segments(), [[[0, 0], [1, 0], [2, 1]], [[0, 1], [1, 1], [2, 0]]])
    np.testing.assert_allclose(bad.get_segments()[0], [[0, 0.5], [1, 0.5]])  # a line ends where there is not a number
    texts = [t.get_text() for t in ax.get_xticklabels()]
    assert texts[0].split() == ["lookahead", "[m]"] and texts[1].split() == ["k_v", "[1/s]"]
    whole = plot_parallel(cube(), ["score"])
    assert sum(len(c.get_paths()) for c in whole.collections) == 25
    with pytest.raises(InputError, match="heat map"):
        plot_heat_map(table, "score")


def test_bars_of_sensitivity_have_their_intervals() -> None:
    spans = ((0.1, 0.3), (0.5, 0.7))
    ax = SobolIndices("time_s", ("k_v", "plant.m11"), (0.2, 0.6), (0.3, 0.9), spans, spans, False, 64).plot()
    rendered(ax)
    assert [b.get_width() for b in ax.patches[:4]] == [0.2, 0.6, 0.3, 0.9]
    assert [t.get_text() for t in ax.get_yticklabels()] == ["k_v", "plant.m11"]
    none = ((0.0, 0.0),) * 2
    flat = SobolIndices("time_s", ("k_v", "k_r"), (0.0, 0.0), (0.0, 0.0), none, none, True, 64)
    assert "constant" in plot_sobol_indices(flat).get_title(loc="left")


@pytest.mark.usefixtures("blank")
def test_pictures_on_disk_stay_in_their_folder(tmp_path: Path) -> None:
    evil = replace(run(), scenario=replace(run().scenario, name="../../a b"))
    path = save_run(evil, tmp_path)
    assert path.parent == tmp_path and path.read_bytes().startswith(b"\x89PNG")
    figure = plot_heat_map(sweep(), "score")
    assert save_figure(figure, tmp_path / "new", ("a/b", "..")).relative_to(tmp_path).as_posix() == "new/a-b-x.png"
    with pytest.raises(InputError, match="cannot be written"):
        save_figure(figure, tmp_path / "new" / "a-b-x.png", ("score",))


def test_a_counterexample_is_replayed_where_it_moves_and_sliced_where_not() -> None:
    moving = rendered(plot_counterexample(verdict("v1-printed"))).axes[0]
    assert "time" in moving.get_xlabel() and moving.get_ylabel() == "V1 [m^2]"
    assert "x_e" in rendered(plot_counterexample(verdict("m-norm-printed"))).axes[0].get_xlabel()
    with pytest.raises(InputError, match="no counterexample"):
        plot_counterexample(verdict("v1-corrected"))
    with pytest.raises(InputError, match="no counterexample"):
        margin_slice(verdict("v1-corrected"))
    still = verdict("m-norm-printed")
    assert still.counterexample is not None
    with pytest.raises(InputError, match="no motion"):
        plot_replay(still, replay(still.claim, still.counterexample))


@pytest.mark.parametrize(("name", "sense"), [("v1-printed", 1), ("course-printed", 1), ("clearance-printed", -1)])
def test_the_allowed_curve_is_on_the_right_side(name: str, sense: int) -> None:
    found = verdict(name)
    assert found.counterexample is not None
    assert _sense(found.claim, found.claim.point(found.counterexample.values)) == sense
    lines = {line.get_label(): line.get_ydata() for line in plot_counterexample(found).lines}
    bound = next(y for label, y in lines.items() if "allows" in str(label))
    flown = next(y for label, y in lines.items() if "replayed" in str(label))
    assert sense * (np.asarray(flown)[-1] - np.asarray(bound)[-1]) > 0


@pytest.mark.parametrize("name", ["v1-printed", "v2-printed", "v2-obstacle"])
def test_a_slice_holds_the_claims_margin(name: str) -> None:
    found = verdict(name)
    cut = margin_slice(found)
    rendered(plot_slice(cut))
    assert found.counterexample is not None
    for i, j in ((0, 0), (60, 30), (120, 120)):
        values = {**found.counterexample.values, cut.one.name: cut.x[j], cut.other.name: cut.y[i]}
        margin, inside = evaluate(found.claim, values)
        if inside:
            assert cut.margin[i, j] == pytest.approx(margin)
        else:
            assert np.isnan(cut.margin[i, j])


def test_the_slice_takes_the_variables_that_matter() -> None:
    cut = margin_slice(verdict("v2-printed"))
    assert (cut.one.name, cut.other.name) == ("e2", "delta")  # E11: δ and the side of the circle


def test_a_claim_in_one_variable_has_no_slice() -> None:
    found = verdict("v2-printed")
    assert found.counterexample is not None
    held = {k: (v, v) for k, v in found.counterexample.values.items() if k != "e2"}
    with pytest.raises(InputError, match="fewer than two"):
        margin_slice(replace(found, claim=found.claim.on(held)))

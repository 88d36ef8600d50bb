"""Control: commands leave the margins of a user's own law out, and a steered craft in front of what moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from surctl.control import build_law, courses, in_real
from surctl.ir import replay
from surctl.own_code import own_file
from surctl.priority.solver.fallback import RELAXED
from surctl.sensing import Equipment
from surctl.simulation import Case, simulate_batch
from tests.control import test_baselines, test_layers, test_own_laws, test_steered, test_stored
from tests.control.test_own_laws import law as law
from tests.control.test_own_laws import mission as mission
from tests.control.test_own_laws import surctl
from tests.control.test_routines import tried
from tests.control.test_steered import files as files
from tests.control.test_steered import gains, radius_of, run
from tests.control.test_steered_courses import EXACT, numbers, rebuilt
from tests.craft import CRUISE, craft, factor, scaled
from tests.craft import mission as written
from tests.tools import need_compiler


def test_every_baseline_is_built_with_sonars() -> None:
    for name in test_baselines.BASELINES:
        assert build_law(name, sonar=True).perception is not None


def test_a_default_thrust_flies_alike_in_both_loops(law: str, mission: Path) -> None:
    test_own_laws.test_both_loops_fly_an_own_law_alike(law, mission, "wall", "projected")


def test_a_sweep_prints_no_margin_of_another_law(law: str, mission: Path, tmp_path: Path) -> None:
    ran = surctl("sweep", "stand_off=0.8,0.9", "--scenario", mission, "--law", own_file(law), "--out", tmp_path / "s")
    assert "disk_margin=nan" in ran.output
    assert "surctl verify" not in ran.output


def test_tuning_judges_no_margin_of_another_law(law: str, mission: Path, tmp_path: Path) -> None:
    study = tmp_path / "study.toml"
    study.write_text(
        'kind = "study"\nname = "mine"\nvehicle = "sur540-flooded"\nlaw = "my_law.py:wall"\n[[runs]]\n'
        'scenario = "water.toml"\n'
    )
    tuned = surctl("tune", study, "--trust", "--trials", 2, "--rounds", 1, "--monte-carlo", 1, "--out", tmp_path / "t")
    assert "goal disk margin is not judged: tune has no linear model of law my_law.py:wall" in tuned.output
    goals = [line.split()[0] for line in tuned.output.splitlines() if " hard " in line]
    assert goals
    assert "disk" not in goals
    commands = [line for line in tuned.output.splitlines() if line.lstrip().startswith("surctl ")]
    assert len(commands) == 2
    assert all(f"--law {own_file(law)}" in command for command in commands)


@pytest.mark.parametrize(("start", "end"), [((36, 20), (10, 20))])  # head on
def test_moving_obstacles_are_evaded(start: tuple[float, float], end: tuple[float, float]) -> None:
    r, vehicle = radius_of("otter"), craft("otter")
    mover = {
        "name": "M",
        "shape": "moving",
        "centre_m": [r * x for x in start],
        "to_m": [r * x for x in end],
        "speed_m_per_s": 0.3,
        "radius_m": vehicle["radius"],
    }
    scenario = written(
        [[20 * r, 20 * r], [36 * r, 20 * r]], "otter", size=(60 * r, 40 * r), time=60 * r, obstacles=[mover]
    )
    batch = simulate_batch(Case(scenario, vehicle, gains()))
    assert batch.column("reached")[0] == 1 and batch.column("min_clearance_m")[0] > 0.05


def test_with_the_tolerances_of_doubles_a_search_in_floats_goes_down_the_ladder() -> None:
    law, given = tried()
    J, wanted, rows, box = (part.astype(np.float32) for part in replay(law.stages.pre, *given)[:4])
    ticks = [
        next(step.block for step in made.block.steps if step.block.name == "projected_step")
        for made in (law, in_real(law, "float32"))
    ]
    coarse, fine = (replay(tick, J, wanted, wanted, rows, box, real=np.float32) for tick in ticks)
    assert coarse[5].mean() > 2 * max(1.0, fine[5].mean())  # iterations
    held = replay(ticks[0], *(part.astype(float) for part in (J, wanted, wanted, rows, box)))[4] < RELAXED
    assert held.mean() > 0.5 and (fine[4][held] < RELAXED).all()


def test_an_unfinished_search_goes_on_in_the_next_step(monkeypatch: pytest.MonkeyPatch) -> None:
    p, chosen = numbers(brake=0.1), []
    # a row of discs across the path, so that only a course far aside is clear
    across = np.zeros((8, 6))
    across[:5, :2] = [[24.0, 30.0 + 3.0 * k] for k in range(-2, 3)]
    across[:5, 2], across[:5, 5] = 1.5, 1.0
    for budget in (EXACT, 2 * courses.STEPS):
        monkeypatch.setattr(courses, "BUDGET", budget)
        law = rebuilt()
        x = law.initial_state()
        x[law.state.slice("progress")] = 15.0
        u = law.inputs.pack({"eta": [12.0, 30.0, 0.0, 0.0], "nu": [0.7, 0.0, 0.0, 0.0], "contacts": across})
        begun = x.copy()
        for _ in range(20):
            step = law.step(x, u, p)
            x = begun.copy()  # the craft stays where it is; only the search goes on
            for name in ("offset", "share", "skipped"):
                x[law.state.slice(name)] = step.x_next[law.state.slice(name)]
            chosen.append([float(x[law.state.slice(name)][0]) for name in ("offset", "share", "skipped")])
    exact, partial = chosen[:20], chosen[20:]
    assert exact[0][0] != 0 and exact[0] == exact[-1] and exact[0][2] == 0
    assert partial[0][2] > 0  # the first search did not end
    assert exact[0][:2] in [one[:2] for one in partial] and partial[-1][:2] == exact[0][:2]


def test_the_map_is_not_forgotten_before_another_depth_is_reached() -> None:
    test_layers.test_the_map_is_forgotten_once_another_depth_is_reached(1.0, False)


def test_corners_are_visited_without_crabbing() -> None:
    test_steered.test_two_legs_are_followed_without_crabbing("otter", "visit")


def test_a_sweep_without_a_feasible_point_sets_an_earlier_gain_file_aside(mission: Path, tmp_path: Path) -> None:
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "gains.toml").write_text("of before")
    ran = surctl("sweep", "k_v=0.01,0.02", "--scenario", mission, "--law", "closed_form", "--out", tmp_path / "s")
    assert "the gain file of an earlier sweep is now" in ran.output
    assert not (tmp_path / "s" / "gains.toml").exists()
    assert (tmp_path / "s" / "gains-before.toml").read_text() == "of before"


def test_export_agrees_with_python_at_more_thrust_than_it_has_astern(files: Path) -> None:
    need_compiler()
    file = files / "otter.toml"
    weaker = '[thrust]\nFu_reverse = { value = 45.0, unit = "N", provenance = "chosen" }\n'
    file.write_text(file.read_text().replace("[thrust]\n", weaker, 1))
    assert craft("otter")["Xu"] * CRUISE["otter"] > 45.0  # the drag at the cruise speed
    words = (
        "--vehicle",
        "otter.toml",
        "--scenario",
        "way.toml",
        "--sensing",
        "truth",
        "--out",
        str(files / "firmware"),
    )
    exported = run(files, "export", *words)
    assert exported.exit_code == 0, exported.output
    assert "thrust 0.0e+00, state 0.0e+00, telemetry 0.0e+00" in exported.output and "reached" in exported.output
    assert "| `ahead_limit` | 133.0 | N | largest surge thrust ahead | 0 to 133 |" in (
        (files / "firmware" / "README.md").read_text()
    )


def test_the_tank_scaled_to_the_craft_without_collision() -> None:
    k = factor(craft("otter"), radius_of("otter"))
    case = Case(scaled("tank-moving", k, "otter"), craft("otter"), gains())
    assert case.law == "steered"
    batch = simulate_batch(case)
    assert batch.column("reached")[0] == 1 and batch.column("min_clearance_m")[0] > 0.5
    assert 0 < batch.column("peak_thrust_share")[0] <= 1  # not NaN on the axes without thrust


def test_a_law_with_sonars_and_depths_is_read_as_it_was_written() -> None:
    options = {"sonar": True, "depths": True, "equipment": Equipment(own=None)}
    test_stored.test_what_is_read_is_what_was_written(options)

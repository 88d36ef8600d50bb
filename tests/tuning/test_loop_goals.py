"""Goals about the loop: each number is python-control's own, and a file says the same as Python."""

from __future__ import annotations

from pathlib import Path

import control
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.marine.control import load_gains
from surctl.marine.simulation import load_scenario
from surctl.marine.tuning import Goal, build_cases, case_loop, conditions, evaluate, load_goals
from surctl.system import Action, Controller, LinearLoop, Plant, System, linearise
from surctl.tuning import (
    LOOP_GOAL_KEYS,
    Effort,
    LoopGoal,
    LoopShape,
    Margins,
    MaxGain,
    Overshoot,
    Poles,
    Rejection,
    SensitivityBound,
    Settling,
    StepRejection,
    StepTracking,
    Tracking,
    judge_loops,
    load_loop_goals,
    operating_loops,
    tune_system,
)
from surctl.tuning.loop_goals import Profile
from surctl.tuning.outcome import goal_rows
from tests.cli.test_systems import complaint, run

SPEED, PLACE = Port("speed", (1,), "m/s", "of the cart"), Port("place", (1,), "m", "of the cart")
FORCE, TARGET = Port("force", (1,), "m/s^2", "over the mass"), Port("target", (1,), "m", "desired place")
MODEL = control.tf([4.0], [1.0, 2.4, 4.0])


def cart() -> System:
    plant = Plant(
        "cart", Layout((PLACE, SPEED)), Layout((FORCE,)), disturbances=Layout((Port("wind", (1,), "m/s^2", "push"),)),
        parameters=Layout((Port("mass", (1,), "1", "relative", 1.0),)),
        ode=lambda x, f, d, p: {"place": x["speed"], "speed": (f["force"] + d["wind"]) / p["mass"]},
    )  # fmt: skip

    def law(x, u, p):
        error = u["target"] - u["place"]
        force = p["k_p"] * error - p["k_d"] * u["speed"] + p["k_i"] * x["sum"]
        return Action(force, {"sum": x["sum"] + 0.05 * error})

    gains = [
        Port("k_p", (1,), "1/s^2", "", 4.0),
        Port("k_d", (1,), "1/s", "", 3.0),
        Port("k_i", (1,), "1/s^3", "", 1.0),
    ]
    return System(
        plant,
        Controller(
            "pid", 0.05, Layout((PLACE, SPEED, TARGET)), Layout((FORCE,)), law,
            state=Layout((Port("sum", (1,), "m s", "of the error"),)), gains=Layout(tuple(gains)),
        ),
    )  # fmt: skip


SYSTEM = cart()


@pytest.fixture(scope="module")
def loop() -> LinearLoop:
    return linearise(SYSTEM)


def closed(loop: LinearLoop, source: str, end: str) -> tuple[np.ndarray, control.StateSpace]:
    system = loop.transfer(source, end)
    return np.arange(4000) * loop.dt, system


def test_steps_are_those_of_step_info(loop: LinearLoop) -> None:
    time, system = closed(loop, "target", "measured.place")
    known = control.step_info(system, T=time)
    over = Overshoot(name="o", source="target", end="place", at_most=0.05).judge(loop)
    assert over.value == pytest.approx(known["Overshoot"] / 100, rel=1e-6)
    assert over.normalised == pytest.approx(over.value / 0.05) and not over.met
    settled = Settling(name="s", source="target", end="place", at_most=8.0).judge(loop)
    assert settled.value == pytest.approx(known["SettlingTime"])
    time, system = closed(loop, "wind", "place")
    response = control.step_response(system, time).outputs
    peak = StepRejection(name="p", source="wind", end="place", at_most=1.0).judge(loop)
    assert peak.value == pytest.approx(np.abs(response).max())
    late = Settling(name="s", source="wind", end="place", at_most=8.0).judge(loop)  # returns to 0 by integral action
    assert np.abs(response[time >= late.value]).max() < 0.02 * peak.value <= np.abs(response[time == late.value - 0.05])


def test_margins_are_those_of_stability_margins(loop: LinearLoop) -> None:
    gain, phase, *_ = control.stability_margins(loop.loop("force"))
    judged = Margins(name="m", at="force", phase_deg=60.0).judge(loop)
    assert judged.value == pytest.approx(phase, rel=1e-6) and judged.normalised == pytest.approx(60 / phase, rel=1e-6)
    low = 1 / gain if gain < 1 else gain
    assert Margins(name="m", at="force", gain=2.0).judge(loop).value == pytest.approx(low, rel=1e-5)
    disk = Margins(name="m", at="force", disk=0.5).judge(loop).value
    omega = np.geomspace(0.01, np.pi / loop.dt, 4000)
    L = loop.loop("force")(np.exp(1j * omega * loop.dt))
    assert disk == pytest.approx(np.min(2 * np.abs(1 + L) / np.abs(1 - L)), rel=1e-4)


def test_frequency_goals_are_responses_of_python_control(loop: LinearLoop) -> None:
    omega = np.geomspace(0.01, 0.99 * np.pi / loop.dt, 3000)
    L = loop.loop("force")
    S = control.feedback(control.ss([], [], [], 1, loop.dt), L)
    size = np.abs(S(np.exp(1j * omega * loop.dt)))
    assert SensitivityBound(name="s", at="force", at_most=2.0).judge(loop).value == pytest.approx(size.max(), rel=1e-3)
    low = Profile((0.05, 0.5), (50.0, 2.0))
    inside = (omega >= 0.05) & (omega <= 0.5)
    rejected = Rejection(name="r", at="force", attenuation=low).judge(loop)
    assert rejected.normalised == pytest.approx(np.max((size * low(omega))[inside]), rel=1e-3)
    K = loop.transfer("measured.place", "command.force")
    effort = Effort(name="e", source="measured.place", end="command.force", at_most=20.0, unit="1/s^2").judge(loop)
    assert effort.value == pytest.approx(np.abs(K(np.exp(1j * omega * loop.dt))).max(), rel=1e-3)
    T = loop.transfer("target", "place")(np.exp(1j * omega * loop.dt))
    assert MaxGain(name="t", source="target", end="place", at_most=1.5).judge(loop).value == pytest.approx(
        np.abs(T).max(), rel=1e-3
    )
    s, w = 1j * omega, 2 / 1.5
    bound = np.abs((1.3 * s + 0.01 * w) / (s + w))
    tracked = Tracking(name="t", source="target", end="place", response_s=1.5, peak_error=1.3).judge(loop)
    assert tracked.normalised == pytest.approx(np.max(np.abs(1 - T) / bound), rel=1e-3)
    target = Profile((0.1, 10.0), (400.0, 0.3))
    shape = LoopShape(name="l", at="force", target=target, band_db=6.0).judge(loop)
    inside = (omega >= 0.1) & (omega <= 10.0)
    off = 20 * np.abs(np.log10(np.abs(L(np.exp(1j * omega * loop.dt))) / target(omega)))[inside]
    assert shape.value == pytest.approx(off.max(), rel=5e-3)
    halves = [LoopShape(name="l", at="force", target=target, band_db=6.0, side=side) for side in ("above", "below")]
    assert max(one.judge(loop).value for one in halves) == pytest.approx(shape.value)
    as_system = SensitivityBound(name="s", at="force", at_most=control.tf([2.0, 0.0], [1.0, 1.0])).judge(loop)
    assert as_system.normalised == pytest.approx(np.max(size / np.abs(2 * s / (s + 1))), rel=2e-2)


def test_poles_and_a_reference_model(loop: LinearLoop) -> None:
    natural, damping, _ = control.damp(loop.closed(), doprint=False)
    judged = Poles(name="p", decay_per_s=0.1, damping=0.9).judge(loop)
    assert judged.value == pytest.approx(damping.min()) and judged.normalised == pytest.approx(0.9 / damping.min())
    assert Poles(name="p", decay_per_s=0.5).judge(loop).value == pytest.approx(np.min(natural * damping))
    assert Poles(name="p", fastest_rad_per_s=9.0).judge(loop).value == pytest.approx(natural.max())
    tracking = StepTracking(name="m", source="target", end="place", model=MODEL, at_most=0.5).judge(loop)
    time, system = closed(loop, "target", "place")
    y, reference = (control.step_response(one, time).outputs for one in (system, MODEL))
    gap = np.linalg.norm(y - reference) / np.linalg.norm(1 - reference)
    assert tracking.value == pytest.approx(gap, rel=1e-3)


def test_an_unstable_loop_meets_no_goal() -> None:
    loop = linearise(SYSTEM, {"k_p": -1.0})
    for goal in (Margins(name="m", at="force", gain=2.0), Poles(name="p", damping=0.1)):
        judged = goal.judge(loop)
        assert judged.normalised == np.inf and judged.where == "the loop is unstable"


FILE = """kind = "goals"
name = "cart"

[[points]]
name = "light"
values = { "plant.mass" = 0.5 }

[[points]]
name = "heavy"
values = { "plant.mass" = 2 }

[[goals]]
name = "shape"
type = "loop_shape"
at = "force"
frequency_rad_per_s = [0.1, 10]
gain_db = [52.0, -10.0]
band_db = 6.0

[[goals]]
name = "sensitivity"
type = "sensitivity"
at = ["force"]
at_most = { value = 2, unit = "1" }
kind = "hard"

[[goals]]
name = "rejection"
type = "rejection"
at = "force"
frequency_rad_per_s = [0.05, 0.5]
attenuation = [50, 2]

[[goals]]
name = "gain"
type = "gain"
from = "target"
to = "place"
at_most = { value = 1.5, unit = "1" }

[[goals]]
name = "effort"
type = "effort"
from = "measured.place"
to = "command.force"
at_most = { value = 20, unit = "1/s^2" }

[[goals]]
name = "tracking"
type = "tracking"
from = "target"
to = "place"
response_s = 1.5
peak_error = 1.3

[[goals]]
name = "overshoot"
type = "overshoot"
from = "target"
to = "place"
at_most = "25 percent"
points = ["light"]

[[goals]]
name = "settling"
type = "settling"
from = "target"
to = "place"
at_most = { value = 8000, unit = "ms" }

[[goals]]
name = "step tracking"
type = "step_tracking"
from = "target"
to = "place"
natural_frequency_rad_per_s = 2.0
damping = 0.6
at_most = { value = 0.5, unit = "1" }

[[goals]]
name = "step rejection"
type = "step_rejection"
from = "wind"
to = "place"
at_most = { value = 1, unit = "m" }

[[goals]]
name = "poles"
type = "poles"
decay_per_s = 0.1
damping = 0.5

[[goals]]
name = "margins"
type = "margins"
at = "force"
gain_margin = 2
phase_margin_deg = 40
"""
IN_PYTHON: tuple[LoopGoal, ...] = (
    LoopShape(
        name="shape", at="force", target=Profile((0.1, 10.0), (10**2.6, 10**-0.5)), band_db=6.0
    ),
    SensitivityBound(name="sensitivity", at="force", at_most=2.0, kind="hard"),
    Rejection(name="rejection", at="force", attenuation=Profile((0.05, 0.5), (50.0, 2.0))),
    MaxGain(name="gain", source="target", end="place", at_most=1.5),
    Effort(name="effort", source="measured.place", end="command.force", at_most=20.0, unit="1/s^2"),
    Tracking(name="tracking", source="target", end="place", response_s=1.5, peak_error=1.3),
    Overshoot(name="overshoot", source="target", end="place", at_most=0.25, points=("light",)),
    Settling(name="settling", source="target", end="place", at_most=8.0),
    StepTracking(name="step tracking", source="target", end="place", model=MODEL, at_most=0.5),
    StepRejection(name="step rejection", source="wind", end="place", at_most=1.0, unit="m"),
    Poles(name="poles", decay_per_s=0.1, damping=0.5),
    Margins(name="margins", at="force", gain=2.0, phase_deg=40.0),
)  # fmt: skip


def test_a_file_says_what_python_says(tmp_path: Path) -> None:
    file = tmp_path / "cart.toml"
    file.write_text(FILE)
    goals, points = load_loop_goals(file)
    assert {goal.TYPE for goal in goals} == set(LOOP_GOAL_KEYS)
    loops = operating_loops(SYSTEM, points)
    told, known = (judge_loops(one, loops) for one in (goals, IN_PYTHON))
    assert [(s.goal.name, s.goal.kind, s.point) for s in told.scores] == [
        (s.goal.name, s.goal.kind, s.point) for s in known.scores
    ]
    assert len(told.scores) == 2 * len(goals) - 1  # one goal is judged at one point
    for one, other in zip(told.scores, known.scores, strict=True):
        assert one.judgement.normalised == pytest.approx(other.judgement.normalised, rel=1e-9)
    worst = {score.goal.name: score.point for score in told.worst()}
    assert set(worst.values()) == {"light", "heavy"}
    assert told.met == all(s.judgement.met for s in told.scores if s.goal.kind == "hard")


MISTAKES = {
    "no such signal": (('from = "wind"', 'from = "winds"'), "goals.step rejection.signal = 'winds'"),
    "no such opening": (('at = "force"\ngain', 'at = "forces"\ngain'), "goals.margins.opening = 'forces'"),
    "no such type": (('type = "poles"', 'type = "pole"'), "goals.poles.type = 'pole': is not a type of goal"),
    "a key of another type": (("decay_per_s = 0.1", "response_s = 0.1"), "is not a key of a goal of type poles"),
    "no bound": (('at_most = { value = 2, unit = "1" }', ""), "goals.sensitivity.at_most: needs one bound"),
    "a bound of 0": (("value = 8000", "value = 0"), "goals.settling.at_most = 0"),
    "another unit": (('8000, unit = "ms"', '8000, unit = "m"'), "goals.settling.at_most.unit"),
    "no such point": (('points = ["light"]', 'points = ["lite"]'), "goals.overshoot.points = 'lite'"),
    "no model": (("damping = 0.6", ""), "goals.step tracking.time_constant_s: needs one reference model"),
    "a metric": (('type = "poles"\ndecay_per_s = 0.1\ndamping = 0.5', 'metric = "time_s"'), "is about a run"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_in_a_file_is_one_line(case: str, tmp_path: Path) -> None:
    (old, new), problem = MISTAKES[case]
    assert old in FILE
    file = tmp_path / "cart.toml"
    file.write_text(FILE.replace(old, new))
    with pytest.raises(InputError) as raised:
        goals, points = load_loop_goals(file)
        judge_loops(goals, operating_loops(SYSTEM, points))
    assert problem in str(raised.value) and "\n" not in str(raised.value)


def test_a_search_minimises_the_worst_soft_goal_and_keeps_the_hard_ones() -> None:
    goals = (
        Settling(name="soon", source="target", end="place", at_most=4.0),
        Overshoot(name="calm", source="target", end="place", at_most=0.1),
        SensitivityBound(name="robust", at="force", at_most=1.6, kind="hard"),
    )
    points = {"light": {"plant.mass": 0.7}, "heavy": {"plant.mass": 1.4}}
    ranges = {"k_p": (1.0, 30.0), "k_d": (1.0, 12.0), "k_i": (0.05, 4.0)}
    tuned = tune_system(SYSTEM, 0.0, ranges, trials=75, goals=goals, points=points)
    rows = [row for row in goal_rows(tuned.tuning) if row["kind"] == "soft"]
    assert tuned.unmet == () and {row["name"] for row in rows} == {"soon", "calm"}
    worst, before = (max(row[f"normalised_{which}"] for row in rows) for which in ("tuned", "hand"))
    assert worst < 1 < before and rows[0]["worst_point"] in points
    (line,) = [line for line in tuned.tuning.request.scores(tuned.gains) if "soon (soft)" in line]
    assert line.startswith("met ") and f"{rows[0]['normalised_tuned']:.3f}" in line


def test_the_same_goals_judge_a_law_of_the_robot(tmp_path: Path) -> None:
    (case,) = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
    file = tmp_path / "robot.toml"
    file.write_text(
        'kind = "goals"\nname = "robot"\n[[goals]]\nname = "back"\ntype = "settling"\nfrom = "y"\nto = "y"\n'
        'at_most = { value = 30, unit = "s" }\nplants = "nominal"\ncruise_m_per_s = [0.05, 0.15]\n'
    )
    (goal,) = load_goals(str(file))
    assert isinstance(goal, Goal) and goal.loop is not None and goal.linear
    runs = conditions([case], seeds=[0])
    found = evaluate([goal], runs, {"lookahead": np.array([0.4, 0.8])})
    known = [
        goal.loop.judge(case_loop(case, case.gains.with_values({"lookahead": v}), cruise=0.05)) for v in (0.4, 0.8)
    ]
    assert found.normalised[:, 0] == pytest.approx([one.normalised for one in known])
    assert found.place[:, 0].tolist() == [0.05, 0.05]
    file.write_text(file.read_text() + 'points = ["a"]\n')
    with pytest.raises(InputError, match="use cruise_m_per_s"):
        load_goals(str(file))


def test_the_command_tunes_a_system_to_goals(tmp_path: Path) -> None:
    (tmp_path / "cart.toml").write_text(FILE)
    (tmp_path / "mine.py").write_text(
        "from tests.tuning.test_loop_goals import cart\n\ndef build():\n    return cart()\n"
    )
    words = (f"{tmp_path / 'mine.py'}:build", "--goals", str(tmp_path / "cart.toml"), "--out", str(tmp_path / "out"))
    done = run("tune", *words, "--trials", "12")
    assert "least " not in done.output and "sensitivity (hard)" in done.output and "gains " in done.output
    bad = tmp_path / "cart.toml"
    bad.write_text(FILE.replace('at = "force"\ngain', 'at = "forces"\ngain'))
    assert "goals.margins.opening = 'forces'" in complaint("tune", *words, "--trials", "12")

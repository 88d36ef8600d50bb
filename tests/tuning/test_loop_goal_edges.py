"""Goals about the loop at their edges: extreme time scales, notches, slow models, and goals that mean nothing."""

from __future__ import annotations

from pathlib import Path

import control
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.system import LinearLoop, from_control, linearise
from surctl.tuning import (
    Effort,
    LoopShape,
    Poles,
    SensitivityBound,
    Settling,
    StepRejection,
    StepTracking,
    load_loop_goals,
    tune_system,
)
from surctl.tuning.loop_goals import Profile
from tests.tuning.test_loop_goals import SYSTEM


@pytest.fixture(scope="module")
def loop() -> LinearLoop:
    return linearise(SYSTEM)


@pytest.mark.parametrize(("dt", "w"), [(1e-4, 0.01), (3600.0, 1e-6)])
def test_a_slow_resonance_counts_however_fast_the_controller_is(dt: float, w: float) -> None:
    lag = control.tf([0.1 * w, w**2], [1 / (100 * w), 1.0])
    loop = linearise(from_control(control.tf([1.0], [1.0, 0.0, 0.0]), lag, dt=dt))
    L = loop.loop("u")(np.exp(1j * np.geomspace(w / 2, 2 * w, 2000) * dt))
    judged = SensitivityBound(name="s", at="u", at_most=2.0).judge(loop)
    assert judged.value == pytest.approx(np.abs(1 / (1 + L)).max(), rel=1e-3) and judged.value > 11


def test_a_notch_of_the_loop_gain_counts() -> None:
    plant = control.zpk([-2e-4 + 2j, -2e-4 - 2j], [0.0, -1.0, -50.0], 1.0)
    loop = linearise(from_control(control.tf(plant), control.tf([20.0], [1.0]), dt=0.01))
    size = np.abs(loop.loop("u")(np.exp(1j * np.linspace(1.99, 2.01, 2001) * 0.01))).min()
    goal = LoopShape(name="l", at="u", target=Profile((1.5, 3.0), (1e-3, 1e-3)), side="above")
    assert goal.judge(loop).value == pytest.approx(-20 * np.log10(size / 1e-3), abs=0.1)


def test_a_slow_reference_model_is_followed_to_its_end() -> None:
    loop = linearise(from_control(control.tf([1.0], [1.0, 0.0]), control.tf([50.0], [1.0]), dt=0.01))
    model, time = control.tf([1.0], [4.0, 1.0]), np.arange(0.0, 60.0, 0.01)
    y, reference = (control.step_response(one, time).outputs for one in (loop.transfer("ref_y", "y"), model))
    gap = np.linalg.norm(y - reference) / np.linalg.norm(1 - reference)
    judged = StepTracking(name="m", source="ref_y", end="y", model=model).judge(loop)
    assert judged.value == pytest.approx(gap, rel=1e-4)


def test_signals_without_effect_settle_at_once() -> None:
    plant = control.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)), outputs=["y", "w"])
    loop = linearise(from_control(plant, control.ss([], [], [], np.eye(2), 0.05)))
    assert Settling(name="s", source="ref_y", end="w", at_most=2.0).judge(loop).value == 0
    with pytest.raises(InputError, match="opened twice"):
        SensitivityBound(name="s", at=("y", "y"), at_most=2.0).judge(loop)


def test_a_bound_may_be_a_system_with_the_control_period_only(loop: LinearLoop) -> None:
    whole = control.tf([2.0, 0.0], [1.0, 1.0])
    one, other = (
        SensitivityBound(name="s", at="force", at_most=bound).judge(loop).normalised
        for bound in (whole, control.sample_system(whole, loop.dt, "tustin"))
    )
    assert other == pytest.approx(one, rel=0.01)


WRONG = {
    "control period": (
        lambda: SensitivityBound(name="g", at="force", at_most=control.tf([1], [1, 0.5], 0.3)),
        "period",
    ),
    "entries": (lambda: SensitivityBound(name="g", at="force", at_most=control.ss(-1, [[1, 1]], 1, 0)), "2 entries"),
    "text": (lambda: SensitivityBound(name="g", at="force", at_most="2"), "g.at_most = '2': is not a number"),
    "float32": (lambda: SensitivityBound(name="g", at="force", at_most=np.float32(-2)), "greater than 0"),
    "side": (lambda: LoopShape(name="g", at="force", target=1.0, side="over"), "g.side = 'over': is not a side"),
    "damping": (lambda: Poles(name="g", damping=1.5), "g.damping = 1.5: is greater than 1"),
    **{
        problem: (lambda model=model: StepTracking(name="g", source="target", end="place", model=model), problem)
        for problem, model in {
            "is not a model": 5,
            "is unstable": control.tf([1.0], [1.0, -1.0]),
            "has no state": control.tf([1.0], [1.0]),
            "has 1 inputs and 2": control.ss(-1, 1, [[1], [1]], [[0], [0]]),
            "has the gain 2 at": control.tf([2.0], [1.0, 1.0]),
            "in discrete time": control.tf([0.5], [1.0, -0.5], 0.05),
        }.items()
    },
}


@pytest.mark.parametrize("case", WRONG)
def test_a_goal_that_means_nothing_is_one_line(case: str, loop: LinearLoop) -> None:
    build, problem = WRONG[case]
    with pytest.raises(InputError) as raised:
        build().judge(loop)
    assert problem in str(raised.value) and "\n" not in str(raised.value)


def test_bounds_count_in_their_units(loop: LinearLoop) -> None:
    one, other = (
        StepRejection(name="p", source="wind", end="place", at_most=bound, unit=unit).judge(loop)
        for bound, unit in ((0.5, "m"), (50.0, "cm"))
    )
    assert other.normalised == pytest.approx(one.normalised) and other.value == pytest.approx(100 * one.value)
    assert (
        other.unit == "cm" and StepRejection(name="p", source="wind", end="place", at_most=1.0).judge(loop).unit == "m"
    )
    noise = Effort(name="e", source="measured.place", end="command.force", at_most=0.2, unit="m/s^2/cm").judge(loop)
    own = Effort(name="e", source="measured.place", end="command.force", at_most=20.0).judge(loop)
    assert noise.normalised == pytest.approx(own.normalised) and own.unit == "(m/s^2)/(m)"
    for goal in (
        StepRejection(name="p", source="wind", end="place", at_most=1.0, unit="deg"),
        Effort(name="p", source="measured.place", end="command.force", at_most=1.0, unit="N/m"),
    ):
        with pytest.raises(InputError, match=r"goals\.p\.at_most\.unit = .*: wrong unit; give it in"):
            goal.judge(loop)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('type = "poles"\ndamping = 0.5\n[[goals]]\nname = "g"\ntype = "poles"\ndamping = 0.5\n', "of two goals"),
        ('type = "sensitivity"\nat = "force"\nfrequency_rad_per_s = [1, 2]\nat_most = "2"\n', "needs one bound"),
        ('type = "gain"\nfrom = "wind"\nto = "place"\nfrequency_rad_per_s = [1, 2]\ngain = [1, 2]\ngain_db = [1, 2]\n',
         r"goals\.g\.gain: is given twice"),
        ('type = "loop_shape"\nat = "force"\nfrequency_rad_per_s = [1, 2]\ngain = [1, 2]\ngain_db = [1, 2]\n',
         r"goals\.g\.gain: is given twice"),
        ('type = "loop_shape"\nat = "force"\n', r"goals\.g\.gain: is missing; give frequency_rad_per_s with gain"),
    ],
)  # fmt: skip
def test_contradictions_in_a_file_are_one_line(tmp_path: Path, text: str, problem: str) -> None:
    file = tmp_path / "cart.toml"
    file.write_text(f'kind = "goals"\nname = "cart"\n[[goals]]\nname = "g"\n{text}')
    with pytest.raises(InputError, match=problem):
        load_loop_goals(file)


def test_an_operating_point_does_not_set_a_searched_gain() -> None:
    goals = [Poles(name="p", damping=0.5)]
    with pytest.raises(InputError, match="point a = 'k_p': is searched"):
        tune_system(SYSTEM, 0.1, {"k_p": (1.0, 2.0)}, trials=12, goals=goals, points={"a": {"k_p": 1.5}})

import casadi as ca
import control
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.signal import tf2ss

from surctl.errors import InputError
from surctl.marine.control import build_law, load_gains
from surctl.marine.control.closing import velocity_control
from surctl.marine.control.paper import DAMPING
from surctl.marine.guidance.tracking import along_command, tracking_velocity
from surctl.marine.vehicle import load_vehicle, planar_rotation
from surctl.marine.verification import cruise_loop, law_corners, law_loop
from surctl.marine.verification.corners import corners
from surctl.marine.verification.cruise_loop import POSE, THRUSTS
from surctl.marine.verification.law_loop import cruise_motion
from surctl.verification import system_margins
from surctl.verification.loops import BrokenLoop, LoopMargins, crossings_of

GAINS = {"k1": 0.3, "k2": 0.3, "k_psi": 0.6, "k_r": 1.5, "k_v": 1.5, "lookahead": 1.2}
VEHICLE = load_vehicle("sur540-flooded")
LOOPS = [*THRUSTS, *POSE]


def of(numerator: list[float], denominator: list[float]) -> LoopMargins:
    a, b, c, _ = tf2ss(numerator, denominator)
    loop = BrokenLoop(np.linalg.eigvals(a - b @ c)[None].astype(complex), np.linalg.eigvals(a)[None].astype(complex))
    found = crossings_of(loop, np.geomspace(1e-4, 1e3, 800))
    return LoopMargins("test", True, **{name: float(value[0]) for name, value in found.items()})


def loop_margins(*args: object, **about: object) -> tuple[LoopMargins, ...]:
    return system_margins(cruise_loop(*args, **about), *LOOPS)  # type: ignore[arg-type]


def test_an_integrator_has_no_gain_margin_and_ninety_degrees() -> None:
    m = of([2.0], [1.0, 0.0])
    assert m.gain_margin == np.inf and m.phase_margin_deg == pytest.approx(90, abs=1e-6)
    assert m.crossover_rad_s == pytest.approx(2, rel=1e-6)
    assert m.delay_margin_s == pytest.approx(np.pi / 4, rel=1e-6)
    assert m.disk_margin == pytest.approx(2, rel=1e-6)


def test_three_lags_have_gain_margin_eight() -> None:
    m = of([4.0], [1.0, 3.0, 3.0, 1.0])
    cross = np.sqrt(4 ** (2 / 3) - 1)
    assert m.gain_margin == pytest.approx(2, rel=1e-5)
    assert m.crossover_rad_s == pytest.approx(cross, rel=1e-5)
    assert m.phase_margin_deg == pytest.approx(180 - 3 * np.rad2deg(np.arctan(cross)), rel=1e-4)


def test_a_margin_against_less_gain_is_not_a_margin_against_more() -> None:
    # 4 (s + 2)²/s³ crosses −180° at 2 rad/s with |L| = 4: it is lost at a quarter of its gain, at no larger gain
    m = of([4.0, 16.0, 16.0], [1.0, 0.0, 0.0, 0.0])
    assert m.gain_margin == np.inf and m.least_gain == pytest.approx(0.25, rel=1e-6)


@pytest.mark.parametrize(
    ("numerator", "denominator", "least", "most"),
    [
        ([4.0], [1.0, -1.0], 0.25, np.inf),  # 4/(s − 1): a pole at 1 − 4 k
        ([-0.5], [1.0, 1.0], 0.0, 2.0),  # it feeds back with the wrong sign: a pole at −1 + 0.5 k
        ([4.0, 8.0], [1.0, -1.0, 0.0], 0.25, np.inf),  # 4 (s + 2)/(s (s − 1)): damping 4 k − 1
        (
            [30.0],
            np.polymul([1.0, -1.0], np.polymul([0.1, 1.0], [0.01, 1.0])),
            1 / 30,
            3.267,
        ),  # Routh
        ([2.0], [1.0, 0.0], 0.0, np.inf),
        ([4.0], [1.0, 3.0, 3.0, 1.0], 0.0, 2.0),
    ],
)
def test_gain_margins_to_both_sides(numerator, denominator, least, most) -> None:
    m = of(numerator, denominator)
    assert m.least_gain == pytest.approx(least, rel=1e-4) and m.gain_margin == pytest.approx(most, rel=1e-4)
    # at the factor itself a pole of the closed loop is on the axis
    for factor in (f for f in (least, most) if 0 < f < np.inf):
        closed = np.roots(np.polyadd(denominator, factor * np.asarray(numerator)))
        assert np.min(np.abs(closed.real)) < 2e-3


def test_the_delay_margin_is_the_least_over_all_crossings() -> None:
    # a resonance crosses 1 again, at a higher frequency with less time to spare
    damping, natural = 0.001, 10.0
    numerator = [0.3 * natural**2]
    denominator = np.polymul([1.0, 0.0], [1.0, 2 * damping * natural, natural**2])
    m = of(numerator, denominator)
    assert m.crossover_rad_s > 9
    assert m.delay_margin_s < m.phase_margin_deg / 180 * np.pi / 0.3


def test_heave_of_a_vehicle_without_drag_and_lag_is_a_double_integrator() -> None:
    # held over a period T and one period late: L = k_v (T/(z − 1) + k2 T² (z + 1)/(2 (z − 1)²))/z
    free = VEHICLE.with_values({"thrust_lag": 0.0, "Zw": 0.0})
    dt, k_v, k2 = 0.05, GAINS["k_v"], GAINS["k2"]

    def loop(omega: float) -> complex:
        z = np.exp(1j * omega * dt)
        return complex(k_v * (dt / (z - 1) + k2 * dt**2 * (z + 1) / (2 * (z - 1) ** 2)) / z)

    cross = brentq(lambda omega: abs(loop(omega)) - 1, 0.1, 10.0)
    phase = np.angle(-loop(cross))
    heave = {m.name: m for m in loop_margins(free, GAINS, cruise=0.15, dt=dt)}["heave"]
    assert heave.crossover_rad_s == pytest.approx(cross, rel=1e-5)
    assert heave.phase_margin_deg == pytest.approx(np.rad2deg(phase), rel=1e-4)
    assert heave.delay_margin_s == pytest.approx(phase / cross, rel=1e-4)


@pytest.mark.parametrize("k_i", [0.0, 0.2])
def test_poles_cross_when_the_delay_margin_of_the_tightest_thrust_is_used_up(k_i: float) -> None:
    # m11 = m22: yaw is by itself, so delaying every thrust is delaying that loop
    gains = {**GAINS, "k_i": k_i}
    dt = 0.05
    margins = loop_margins(VEHICLE, gains, cruise=0.15, dt=dt)
    least = min(m.delay_margin_s for m in margins[:4])
    before = cruise_loop(VEHICLE, gains, cruise=0.15, dt=dt + 0.97 * least / 1.5).rates
    after = cruise_loop(VEHICLE, gains, cruise=0.15, dt=dt + 1.03 * least / 1.5).rates
    assert before[0].real < 0 < after[0].real


def test_gain_margin_of_heading_is_where_its_poles_cross() -> None:
    heading = loop_margins(VEHICLE, GAINS, cruise=0.15, dt=0.05)[7]
    assert heading.name == "psi"
    for factor, stable in ((0.98, True), (1.02, False)):
        gains = {**GAINS, "k_psi": GAINS["k_psi"] * heading.gain_margin * factor}
        assert cruise_loop(VEHICLE, gains, cruise=0.15, dt=0.05).stable is stable


@pytest.mark.parametrize("name", ["sur540-flooded", "sur400", "bluerov2-vonbenzon"])
def test_the_controller_is_the_derivative_of_the_laws_own_expressions(name: str) -> None:
    vehicle, cruise, k_i = load_vehicle(name), 0.15, 0.2
    y, xi = ca.SX.sym("y", 8), ca.SX.sym("xi", 4)
    along = along_command(
        y[0],
        y[1],
        speed=ca.SX(cruise),
        k1=ca.SX(GAINS["k1"]),
        lookahead=ca.SX(GAINS["lookahead"]),
        maximum=None,
    )
    world = tracking_velocity(along, y[1], ca.SX([1, 0]), ca.SX(GAINS["lookahead"]))
    wanted = ca.vertcat(planar_rotation(y[3]).T @ world, -GAINS["k2"] * y[2], -GAINS["k_psi"] * y[3])
    nu = y[4:] + ca.SX([cruise, 0, 0, 0])
    model = {
        "mass": ca.SX(vehicle.mass),
        "linear_drag": ca.SX(vehicle.linear_drag),
        "quadratic_drag": ca.SX(vehicle.quadratic_drag),
        "thrust_limit": ca.SX(1e6 * vehicle.thrust_limit),
    }
    thrust, held, _ = velocity_control(
        wanted, nu, xi, model, k_v=ca.SX(GAINS["k_v"]), k_r=ca.SX(GAINS["k_r"]), k_i=ca.SX(k_i), dt=1.0
    )
    both = ca.vertcat(thrust, held - xi)  # a period of 1 s: the step of ξ is its rate
    slope = ca.Function("slope", [y, xi], [ca.jacobian(both, ca.vertcat(y, xi))])
    expected = np.asarray(slope(np.zeros(8), np.zeros(4)))
    dt = 0.05
    Az, By, *_ = cruise_loop(vehicle, {**GAINS, "k_i": k_i}, cruise=cruise, dt=dt, law="guarded").law
    Az, By, Cz, D = Az[:4, :4], By[:4], Az[4:, :4], By[4:]  # the thrusts that wait are the last states of the law
    assert np.block([[D, Cz], [By / dt, (Az - np.eye(4)) / dt]]) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("law", "rel"), [("closed_form", 2 * DAMPING**2), ("paper", 1e-9)])
def test_all_laws_that_track_have_one_loop(law: str, rel: float) -> None:
    one, other = (cruise_loop(VEHICLE, GAINS, cruise=0.15, dt=0.05, law=name) for name in ("guarded", law))
    assert other.law[1] == pytest.approx(one.law[1], rel=rel, abs=1e-9) and other.states() == one.states()


@pytest.mark.parametrize("k_i", [0.0, 0.2])
def test_the_loop_of_derivatives_is_that_of_differences_of_the_steps_of_the_law(k_i: float) -> None:
    gains = load_gains("default").with_values({"k_i": k_i})
    law, about = build_law("closed_form"), {"cruise": 0.15}
    stepped = law_loop(law, VEHICLE, gains, at=cruise_motion(law, VEHICLE, gains, **about), **about)
    assert 0 < stepped.kink < 1e-6 and law_loop(law, VEHICLE, gains, **about).kink == 0.0  # this one is of derivatives
    found = np.sort_complex(cruise_loop(VEHICLE, gains.values, cruise=0.15, dt=0.05).rates)
    expected = np.sort_complex(np.log(stepped.poles) / 0.05)
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-4)


def test_a_held_and_late_thrust_is_that_of_python_control() -> None:
    loop = cruise_loop(load_vehicle("sur400"), load_gains("default").values, cruise=0.15, dt=0.05)
    A, B, _, C, _ = loop.plant
    held = control.sample_system(control.ss(A, B, C, np.zeros((8, 4))), 0.05)
    A, B, C, D = loop.opened(*THRUSTS)
    for omega in (0.1, 3.0, 20.0):
        z = np.exp(0.05j * omega)
        expected = -loop.law[1][-4:] @ held(z) / z
        assert C @ np.linalg.solve(z * np.eye(len(A)) - A, B) + D == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_every_loop_is_reported_with_finite_crossovers_and_no_spurious_margin() -> None:
    margins = loop_margins(VEHICLE, GAINS, cruise=0.15, dt=0.05)
    assert [m.name for m in margins] == LOOPS
    for m in margins:
        assert m.stable and m.gain_margin > 1.5 and 30 < m.phase_margin_deg < 120
        assert 0.1 < m.delay_margin_s < 60 and 0.3 < m.disk_margin < 2
        assert set(m.to_dict()) >= {
            "name",
            "gain_margin",
            "phase_margin_deg",
            "delay_margin_s",
            "disk_margin",
        }


def test_an_unstable_loop_has_nothing_left() -> None:
    for m in loop_margins(VEHICLE, {**GAINS, "k_psi": 60.0}, cruise=0.15, dt=0.05):
        assert not m.stable and (m.gain_margin, m.delay_margin_s, m.disk_margin) == (1.0, 0.0, 0.0)
    assert cruise_loop(VEHICLE, {**GAINS, "k_psi": 60.0}, cruise=0.15, dt=0.05).rates[0].real > 0


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"k_psi": None}, "k_psi"),
        ({"k_v": -1.0}, "k_v"),
        ({"k1": float("nan")}, "k1"),
        ({"k_i": -1.0}, "k_i"),
    ],
)
def test_bad_gains_are_named(change: dict[str, float | None], key: str) -> None:
    gains = {n: v for n, v in {**GAINS, **change}.items() if v is not None}
    with pytest.raises(InputError, match=key):
        loop_margins(VEHICLE, gains, cruise=0.15, dt=0.05)


def test_a_cruise_beyond_the_thrust_is_refused() -> None:
    with pytest.raises(InputError, match="thrust"):
        loop_margins(VEHICLE, GAINS, cruise=0.9, dt=0.05)


def test_a_wrong_model_scales_the_loop_gain():
    vehicle, gains = load_vehicle("sur540-flooded"), GAINS
    heavy = vehicle.with_values({"m33": 115.0})
    about = {"cruise": 0.2, "dt": 0.05}
    right, wrong = ({m.name: m for m in loop_margins(heavy, gains, model=model, **about)} for model in (heavy, vehicle))
    # the heave loop of a body of 115 kg that is taken for 95 kg crosses over 95/115 lower, to first order
    ratio = wrong["heave"].crossover_rad_s / right["heave"].crossover_rad_s
    assert 0.75 < ratio < 0.9
    assert wrong["surge"] == right["surge"]


def test_the_least_delay_margin_is_that_of_all_corners_and_loops():
    vehicle, about = load_vehicle("sur540-flooded"), {"cruise": 0.2, "dt": 0.05}
    tried = corners(vehicle, 0.3)
    each = {
        f"{m.name} at {label}": m.delay_margin_s
        for plant, label in zip(tried.vehicles, tried.labels, strict=True)
        for m in loop_margins(plant, GAINS, model=vehicle, **about)
    }
    found = law_corners(build_law(), tried, load_gains("default").with_values(GAINS), cruise=0.2)
    worst = min(each, key=lambda where: each[where])
    assert (found.delay.where, found.delay.delay_s) == (worst, pytest.approx(each[worst], rel=1e-9))
    assert (
        found.delay.corner == "mass -30%, drag -30%"
        and tried.vehicle(found.delay.corner)["m11"] == 0.7 * vehicle["m11"]
    )
    with pytest.raises(InputError, match="uncertainty = 1"):
        corners(vehicle, 1.0)


@pytest.mark.parametrize("name", LOOPS[1::3])  # all of them: study 40
def test_python_control_has_the_margins_that_are_printed(name: str) -> None:
    gains, k, below = {**GAINS, "k_i": 0.05}, LOOPS.index(name), np.pi / 0.05
    ours = loop_margins(VEHICLE, gains, cruise=0.15, dt=0.05)[k]
    loop = cruise_loop(VEHICLE, gains, cruise=0.15, dt=0.05)
    L = control.ss(*loop.opened((*THRUSTS, *POSE)[k]), 0.05)
    response = control.frd(L, np.geomspace(1e-3, below, 4_000), smooth=True)
    gm, pm, _, w_phase, w_gain, _ = control.stability_margins(response, returnall=True)
    gm = gm[(gm > 1) & (w_phase < below)]
    lag = np.remainder(pm[w_gain < below], 360.0)
    assert ours.gain_margin == pytest.approx(min(gm, default=np.inf), rel=1e-5)
    assert ours.phase_margin_deg == pytest.approx(min(lag, default=np.inf), rel=1e-5)
    assert ours.delay_margin_s == pytest.approx(min(np.deg2rad(lag) / w_gain[w_gain < below], default=np.inf), rel=1e-5)
    assert ours.disk_margin == pytest.approx(control.disk_margins(L, np.geomspace(1e-3, below, 4_000))[0], rel=1e-4)

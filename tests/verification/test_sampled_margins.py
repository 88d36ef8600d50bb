"""Margins of any system: where a factor, a delay or a disk takes the sampled loop to the edge of stability."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from surctl.ir import Layout, Port
from surctl.system import Action, Controller, Plant, System, linearise
from surctl.system.linear_loop import LinearLoop, LoopNames
from surctl.verification import system_disk_margin, system_margins
from surctl.verification.sampled_margins import SampledLoop, corners_of
from tests.system.examples import ANGLE, RATE, TORQUE, level, pendulum, pendulum_plant


def largest_pole(linear, opening: str, factor: complex) -> float:
    """Largest |z| of the loop closed through a factor at an opening."""
    A, B, C, D = linear.opened(opening)
    return float(np.abs(np.linalg.eigvals(A - factor * B @ C / (1 + factor * D[0, 0]))).max())


@pytest.mark.parametrize("opening", ["torque", "angle", "rate"])
def test_a_factor_at_its_margin_is_at_the_edge(opening: str) -> None:
    linear = linearise(pendulum())
    (found,) = system_margins(linear, opening)
    for edge in (found.gain_margin, found.least_gain):
        if 0 < edge < np.inf:
            assert largest_pole(linear, opening, edge) == pytest.approx(1.0, abs=1e-7)
    assert found.least_gain < 1 < found.gain_margin and found.stable
    lag = np.exp(-1j * np.deg2rad(found.phase_margin_deg))
    assert largest_pole(linear, opening, lag) == pytest.approx(1.0, abs=1e-6)
    assert largest_pole(linear, opening, np.exp(-0.9j * np.deg2rad(found.phase_margin_deg))) < 1.0


def vessel() -> System:
    """Three axes held by proportional-integral-derivative control with four thrusters: nine slow poles near z = 1."""
    place, speed = Port("place", (3,), "m", ""), Port("speed", (3,), "m/s", "")
    thrust, total = Port("thrust", (4,), "N", ""), Port("total", (3,), "N", "")
    spread = np.array([[1.0, 1, 0, 0], [0, 0, 1, 1], [-0.1, 0.1, 0.5, -0.5]])
    mass, drag = ca.DM([25.8, 33.8, 2.76]), ca.DM([0.7, 0.9, 1.9])

    def ode(x, f, d, p):
        return {"place": x["speed"], "speed": (ca.DM(spread) @ f["thrust"] - drag * x["speed"]) / mass}

    def law(x, u, p):
        force = -(0.15 * u["place"] + 0.6 * u["speed"]) * mass - x["total"]
        return Action(ca.DM(np.linalg.pinv(spread)) @ force, {"total": x["total"] + 0.05 * 0.5 * u["place"]})

    measured = Layout((place, speed))
    hold = Controller("hold", 0.05, measured, Layout((thrust,)), law, state=Layout((total,)))
    return System(Plant("vessel", measured, Layout((thrust,)), ode), hold)


def test_the_margins_of_a_loop_with_many_slow_poles_are_those_of_its_states() -> None:
    linear = linearise(vessel())
    for found in system_margins(linear):
        for edge in (found.gain_margin, found.least_gain):
            if 0 < edge < np.inf:
                assert largest_pole(linear, found.name, edge) == pytest.approx(1.0, abs=1e-7), found
        if found.phase_margin_deg < np.inf:
            lag = np.exp(-1j * np.deg2rad(found.phase_margin_deg))
            A, B, C, D = linear.opened(found.name)
            poles = np.linalg.eigvals(A - lag * B @ C / (1 + lag * D[0, 0]))  # a lead may be at the edge before the lag
            assert np.abs(np.abs(poles) - 1).min() < 1e-7, found
        half = found.disk_margin / 2
        assert found.phase_margin_deg >= np.rad2deg(2 * np.arctan(half)) - 1e-6, found
        assert (1 - half) * found.gain_margin >= 1 + half - 1e-6, found


def test_a_factor_that_makes_the_loop_oscillate_at_the_nyquist_frequency_counts() -> None:
    force = Port("force", (1,), "m/s^2", "")
    cart = Plant("cart", Layout((RATE,)), Layout((force,)), lambda x, f, d, p: f["force"])
    law = Controller("hold", 0.1, Layout((RATE,)), Layout((force,)), lambda x, u, p: -2 * u["rate"])
    (found,) = system_margins(linearise(System(cart, law)), "force")
    assert found.gain_margin == pytest.approx(10.0) and found.least_gain == 0.0  # z = 1 - 0.2 k


def carts(rates: list[float]) -> System:
    """Carts side by side, each with integral action of its own; no cart acts on another."""
    place, speed, force, total = (
        Port(name, (len(rates),), unit, "")
        for name, unit in (("place", "m"), ("speed", "m/s"), ("force", "m/s^2"), ("total", "m s"))
    )

    def law(x, u, p):
        w = ca.DM(rates)
        return Action(
            -(w**2 * u["place"] + 1.4 * w * u["speed"] + w**3 / 10 * x["total"]),
            {"total": x["total"] + 0.05 * u["place"]},
        )

    plant = Plant(
        "carts", Layout((place, speed)), Layout((force,)),
        lambda x, f, d, p: {"place": x["speed"], "speed": f["force"] - 0.02 * x["speed"]},
    )  # fmt: skip
    return System(
        plant, Controller("hold", 0.05, Layout((place, speed)), Layout((force,)), law, state=Layout((total,)))
    )


def test_loops_beside_a_loop_do_not_change_its_margins() -> None:
    rates = [1.0, 1.3, 1.7, 2.1]
    together = linearise(carts(rates))
    for k, rate in enumerate(rates):
        (alone,) = system_margins(linearise(carts([rate])), "force")
        (beside,) = system_margins(together, f"force[{k}]")
        found = [getattr(beside, name) / getattr(alone, name) for name in vars(alone) if name not in ("name", "stable")]
        assert found == pytest.approx([1.0] * 8, rel=1e-6)


def test_whole_periods_of_delay_within_the_margin_are_stable_and_beyond_it_not() -> None:
    (found,) = system_margins(linearise(pendulum()), "torque")
    borne = int(found.delay_margin_s / 0.01)

    def late(periods: int) -> float:
        names = [Port(f"late{k}", (1,), "N m", "") for k in range(periods)]

        def law(x, u, p):
            free = -(19.7 * u["angle"] + 6.2 * u["rate"])
            line = [free, *(x[port.name] for port in names)]
            return Action(line[-1], {port.name: line[k] for k, port in enumerate(names)})

        controller = Controller(
            "late",
            dt=0.01,
            inputs=Layout((ANGLE, RATE)),
            command=Layout((TORQUE,)),
            state=Layout(tuple(names)),
            law=law,
        )
        start = {"start.angle": 0.0}
        return float(np.abs(linearise(System(pendulum_plant(), controller), start).poles()).max())

    assert borne > 5 and late(borne) < 1.0 < late(borne + 1)


def test_the_disk_of_one_loop_is_that_of_its_nyquist_curve() -> None:
    linear = linearise(level())
    for opening in linear.channels():
        loop = linear.loop(opening)(np.exp(1j * np.geomspace(1e-4, np.pi, 4001)))
        nearest = float(np.min(2 * np.abs(1 + loop) / np.abs(1 - loop)))
        alone = system_margins(linear, opening)[0].disk_margin
        assert alone == pytest.approx(min(nearest, 2.0), rel=5e-3)
        assert system_disk_margin(linear, opening).guaranteed == pytest.approx(alone, rel=1e-4)  # one number for both


def test_all_loops_at_once_bear_less_than_each_and_break_where_it_says() -> None:
    linear = linearise(pendulum())
    alone = min(loop.disk_margin for loop in system_margins(linear))
    together = system_disk_margin(linear)
    assert 0 < together.guaranteed <= together.reached and together.guaranteed <= alone * 1.001
    assert 0 < together.frequency_rad_s <= np.pi / 0.01


def test_a_pole_at_the_nyquist_frequency_is_no_obstacle() -> None:
    """A derivative by the trapezoidal rule has its pole at z = -1."""
    place, speed, force = Port("x", (1,), "m", ""), Port("v", (1,), "m/s", ""), Port("f", (1,), "N", "")
    mass = Plant(
        "mass", Layout((place, speed)), Layout((force,)), lambda x, f, d, p: {"x": x["v"], "v": f["f"] - 3 * x["v"]}
    )

    def loop(pole: float) -> System:
        def law(z, u, p):
            rate = pole * z["rate"] + (1 - pole) / 0.02 * (u["x"] - z["last"])
            return Action(-2 * u["x"] + 0.005 * rate, {"last": u["x"], "rate": rate})

        memory = Layout((Port("last", (1,), "m", ""), Port("rate", (1,), "m/s", "")))
        return System(mass, Controller("pd", 0.02, Layout((place,)), Layout((force,)), law, state=memory))

    at, near = linearise(loop(-1.0)), linearise(loop(-0.99999))
    assert system_margins(at, "f")[0].disk_margin == pytest.approx(system_margins(near, "f")[0].disk_margin, rel=1e-4)
    assert system_disk_margin(at).guaranteed == pytest.approx(system_disk_margin(near).guaranteed, rel=1e-4)


def test_a_loop_without_memory_has_all_margins() -> None:
    """A sampled plant without states: nothing of a command returns."""
    nothing, wide, tall = np.zeros((0, 0)), np.zeros((1, 0)), np.zeros((0, 1))
    names = LoopNames("plant", "law", (), (), ("f",), ("f",), ("y",))
    law = (nothing, tall, nothing, wide, np.array([[-2.0]]), wide)
    loop = SampledLoop(LinearLoop((nothing, tall, nothing, wide, wide), law, names, 0.1, sampled=True))
    assert loop.stable and loop.slowest_per_s == -np.inf and loop.disk == pytest.approx(2.0, rel=0.01)
    assert corners_of(loop, [("other", loop.linear)]).enough


def test_an_unstable_loop_has_no_margins() -> None:
    slack = replace(pendulum(), costs={}, controller=Controller(
        "slack", 0.01, Layout((ANGLE, RATE)), Layout((TORQUE,)), lambda x, u, p: -5 * u["angle"] - ca.SX(0)
    ))  # fmt: skip
    linear = linearise(slack, {"start.angle": 0.0})
    assert [(m.stable, m.gain_margin, m.disk_margin) for m in system_margins(linear, "torque")] == [(False, 1.0, 0.0)]
    assert not system_disk_margin(linear).stable

"""Sampled sensors and actuators: an independent simulation, both ways to run a loop, its linear model, and mistakes."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.lyapunov import continuous_dynamics
from surctl.system import (
    Controller,
    Cost,
    Plant,
    Sampled,
    System,
    find_equilibrium,
    linearise,
    message,
    run_system,
    simulate_system,
)
from tests.oracles.noise_stream import NoiseStream

POSITION, SPEED = Port("position", (1,), "m", "of the cart"), Port("speed", (1,), "m/s", "of the cart")
FORCE, TARGET = Port("force", (1,), "N", "on the cart"), Port("target", (1,), "m", "of the cart", 1.0)
CART = Plant(
    "cart", Layout((POSITION, SPEED)), Layout((FORCE,)),
    lambda x, f, d, p: {"position": x["speed"], "speed": f["force"] / 2.0 - 0.1 * x["speed"]},
)  # fmt: skip
LAW = Controller(
    "pd", 0.1, Layout((POSITION, SPEED, TARGET)), Layout((FORCE,)),
    lambda x, u, p: -3 * (u["position"] - u["target"]) - 4 * u["speed"],
)  # fmt: skip


def camera(period: float = 0.02, deviation: float = 0.05) -> Sampled:
    return Sampled(
        "camera", Layout((POSITION,)), Layout((POSITION,)),
        lambda x, u, p, w: {"position": u["position"] + p["deviation"] * w["noise"]},
        parameters=Layout((Port("deviation", (1,), "m", "of the position", deviation),)),
        normal=Layout((Port("noise", (1,), "1", "of the picture"),)), period=period,
    )  # fmt: skip


def motor(period: float = 0.05) -> Sampled:
    return Sampled(
        "motor", Layout((FORCE,)), Layout((FORCE,)),
        lambda x, u, p, w: {"force": x["force"] + 0.5 * (u["force"] - x["force"])}, period=period,
    )  # fmt: skip


def loop(*sensors: Sampled, actuators: tuple[Sampled, ...] = (), law: Controller = LAW) -> System:
    error = Cost(lambda s: (s.y["position"] - s.r["target"]) ** 2, "mean", "m^2")
    return System(CART, law, costs={"error": error}, sensors=sensors, actuators=actuators)


def by_hand(seed: int, periods: int, loss: float, late: int) -> np.ndarray:
    """The cart with a camera at 50 Hz, a radio at 50 Hz and a motor at 20 Hz under the 10 Hz controller, exactly."""
    step = expm(0.01 * np.array([[0, 1, 0], [0, -0.1, 0.5], [0, 0, 0]]))  # of position, speed and held force
    noise, x, sent, seen, force = NoiseStream(seed), np.zeros(2), [0.0] * late, 0.0, 0.0
    states = []
    for _ in range(periods):
        states.append(x)
        for instant in range(10):  # of 10 ms
            if instant % 2 == 0:
                picture = x[0] + 0.05 * noise.normals(2)[0]
                sent = [picture, *sent]
                arrived = sent.pop()
                seen = seen if noise.uniform() < loss else arrived
            if instant == 0:
                command = -3 * (seen - 1.0) - 4 * x[1]
            if instant % 5 == 0:
                force += 0.5 * (command - force)
            x = (step @ [*x, force])[:2]
    return np.array(states)


@pytest.mark.parametrize(("seed", "loss", "late"), [(0, 0.0, 0), (7, 0.3, 2)])
def test_a_run_is_that_of_an_independent_simulation(seed, loss, late) -> None:
    radio = message("radio", Layout((POSITION,)), period=0.02, samples_late=late, loss=loss)
    record = run_system(loop(camera(), radio, actuators=(motor(),)), 3.0, {"seed": seed})
    states = np.hstack([record["position"], record["speed"]])
    assert np.abs(states - by_hand(seed, 30, loss, late)).max() < 1e-9


@settings(max_examples=4, deadline=None)
@given(
    seen=st.sampled_from([0.02, 0.05, 0.1, 0.3]), acts=st.sampled_from([0.025, 0.1, 0.2]), late=st.integers(0, 2),
    seed=st.integers(0, 2**53),
)  # fmt: skip
def test_the_compiled_run_is_that_of_python(seen, acts, late, seed) -> None:
    system = loop(
        camera(seen), message("radio", Layout((POSITION,)), period=seen, samples_late=late, loss=0.4),
        actuators=(motor(acts),),
    )  # fmt: skip
    runs = simulate_system(system, 2.0, {"seed": [seed, seed // 2], "radio.loss": [0.4, 0.1]})
    for k, values in enumerate(({"seed": seed}, {"seed": seed // 2, "radio.loss": 0.1})):
        record = run_system(system, 2.0, values)
        assert record["error"] == pytest.approx(runs["error"][k], rel=1e-9)


@pytest.mark.parametrize("late", [0, 3])
def test_the_linear_loop_predicts_a_run_without_noise(late) -> None:
    radio = message("radio", Layout((POSITION,)), period=0.05, samples_late=late)
    system = loop(camera(0.025, deviation=0.0), radio, actuators=(motor(),))
    linear, record = linearise(system), run_system(system, 3.0, {"start.position": 0.4})
    rest, (transition, *_) = linear.at, linear.transferred(["reference.target"], ["measured.position"])
    assert len(transition) == len(linear.states())
    error = np.concatenate([[0.4, 0.0] - rest.x, system.blocks.memory.pack() - rest.memory])
    for position in record["position"][:, 0]:
        assert position == pytest.approx(rest.x[0] + error[0], abs=1e-7)  # the run has Runge-Kutta steps
        error = transition @ error
    assert max(abs(linear.poles())) < 1


def test_a_delay_costs_its_phase() -> None:
    radio, now = message("radio", Layout((POSITION,)), samples_late=1), message("radio", Layout((POSITION,)))
    late, direct = (linearise(loop(block)).loop("position") for block in (radio, now))
    w = 1.5
    assert late(np.exp(0.1j * w)) == pytest.approx(direct(np.exp(0.1j * w)) * np.exp(-0.1j * w), rel=1e-9)
    assert direct(np.exp(0.1j * w)) == pytest.approx(linearise(loop()).loop("position")(np.exp(0.1j * w)), rel=1e-9)


def test_a_monitor_with_memory_ends_a_run() -> None:
    still = Sampled(
        "watch", Layout((SPEED,)), Layout((Port("still", (1,), "s", "time at rest"),)),
        lambda x, u, p, w: {"still": ca.if_else(ca.fabs(u["speed"]) < 0.01, x["still"] + 0.1, 0)},
    )  # fmt: skip
    system = System(CART, LAW, sensors=(still,), stops={"rests": lambda s: s.y["still"] > 0.95})
    record = run_system(system, 60.0)
    assert record.stopped == "rests" and np.all(np.abs(record["speed"][-10:]) < 0.01)
    assert simulate_system(system, 60.0).time[0] == pytest.approx(record.duration)


def test_a_block_reads_the_time_of_its_samples() -> None:
    step = lambda x, u, p, w: {"sampled_at": u["time"], "before": x["sampled_at"]}  # noqa: E731
    outputs = Layout((Port("sampled_at", (1,), "s", "time of the sample"), Port("before", (1,), "s", "of that before")))
    clock = Sampled("clock", Layout((Port("time", (1,), "s", "of the sample"),)), outputs, step, period=0.05)
    costs = {name: Cost(lambda s, name=name: s.y[name], "final", "s") for name in ("sampled_at", "before")}
    system = System(CART, LAW, costs={f"last_{name}": cost for name, cost in costs.items()}, sensors=(clock,))
    record = run_system(system, 1.0)
    assert record["sampled_at"][:, 0] == pytest.approx(record.time)
    assert record["before"][1:, 0] == pytest.approx(record.time[1:] - 0.05)
    runs = simulate_system(system, 1.0)
    assert {name: runs[name][0] for name in record.figures} == pytest.approx(record.figures)


def test_random_numbers_have_their_means_in_an_equilibrium() -> None:
    always = find_equilibrium(loop(camera(), message("radio", Layout((POSITION,)), loss=0.4)))
    assert always.x == pytest.approx([1.0, 0.0], abs=1e-9) and always.memory == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize(
    ("build", "told"),
    [
        (lambda: loop(camera(0.03)), r"camera\.period.*does not fit"),
        (lambda: loop(camera(), camera()), "two blocks"),
        (lambda: loop(message("radio", Layout((Port("height", (1,), "m", ""),)))), r"radio\.inputs\.height"),
        (lambda: loop(message("radio", Layout((Port("position", (1,), "ft", ""),)))), "is in ft"),
        (lambda: loop(actuators=(motor(0.07),)), r"motor\.period"),
        (lambda: System(CART, LAW, sensors=(LAW,)), "sensors.*type Controller"),
        (lambda: message("radio", Layout((POSITION,)), loss=1.5), "is not a probability"),
        (lambda: message("radio", Layout((POSITION,)), samples_late=0.5), "is not a delay"),
        (lambda: Sampled("plant", Layout(()), Layout(()), lambda x, u, p, w: {}), "kind of numbers"),
        (lambda: linearise(loop(camera(0.3))), r"camera\.period.*once in 3"),
        (lambda: run_system(loop(camera()), 1.0, {"seed": 0.5}), "is not a seed"),
        (lambda: run_system(loop(), 1.0, {"seed": 1}), "no such number"),
        (lambda: continuous_dynamics(loop(camera()), {"position": (-1, 1), "speed": (-1, 1)}), "regions do not cover"),
    ],
)  # fmt: skip
def test_a_mistake_is_told(build, told) -> None:
    with pytest.raises(InputError, match=told):
        build()

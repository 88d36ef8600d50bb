"""Allocation: strict priorities within the thrusters' limits, equal to an exhaustive search over all limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import compile_block, replay
from surctl.ir.native import runnable
from surctl.marine.allocation import Allocation, allocate
from surctl.marine.allocation.program import allocation_block
from surctl.marine.vehicle import Actuators, Thruster, attainable, load_vehicle
from surctl.priority import Level, Row, build_problem, solve
from tests.allocation.enumeration import Enumeration

Array = NDArray[np.float64]


def _library(name: str) -> Actuators:
    actuators = load_vehicle(name).actuators
    assert actuators is not None
    return actuators


@cache
def _skewed() -> Actuators:
    """Six thrusters in no special direction: every half-space is spanned by another three of them."""
    rng = np.random.default_rng(5)
    thrusters = []
    for k in range(6):
        push = rng.normal(size=3)
        push /= np.linalg.norm(push)
        forward, reverse = rng.uniform(10, 40, 2)
        x, y, z = rng.uniform(-0.4, 0.4, 3)
        curve = ((-1.0, -reverse), (0.0, 0.0), (1.0, forward))
        thrusters.append(Thruster(f"T{k}", (x, y, z), tuple(push.tolist()), forward, reverse, curve))
    return Actuators(tuple(thrusters))


@cache
def _runner(actuators: Actuators) -> Callable[..., list[Array]]:
    return runnable(allocation_block(actuators))


def _wrenches(actuators: Actuators, count: int, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    most = np.abs(attainable(actuators).intervals()).max(axis=1)
    wrenches = rng.normal(size=(count, 4)) * most * rng.choice([0.1, 0.5, 1.0, 3.0], (count, 1))
    wrenches[::5, rng.integers(4)] = 0.0
    wrenches[0] = 0.0
    wrenches[1:5] = 30 * np.diag(most)
    return wrenches


@pytest.mark.parametrize("failed", [(), (0, 1)])
@pytest.mark.parametrize("vehicle", ["bluerov2-thrusters", "skewed"])
def test_forces_equal_those_of_an_exhaustive_search(vehicle: str, failed: tuple[int, ...]) -> None:
    actuators = _skewed() if vehicle == "skewed" else _library(vehicle)
    working = np.ones(6)
    working[list(failed)] = 0.0
    reference = Enumeration(actuators, working)
    for wrench in _wrenches(actuators, 120):
        achieved, forces, _ = _runner(actuators)(wrench, working)
        expected = reference.solve(wrench)
        assert achieved == pytest.approx(actuators.matrix @ expected, abs=1e-9)
        assert forces == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("vehicle", ["bluerov2-heavy", "sur540-jets"])
def test_every_level_is_as_close_as_the_lexicographic_solver_brings_it(vehicle: str) -> None:
    actuators = _library(vehicle)
    rows, levels = [], [("yaw", [3]), ("force", [0, 1, 2])]
    for thruster, where in zip(actuators.thrusters, actuators.slices, strict=True):
        for k, (normal, bound) in enumerate(zip(*thruster.sides, strict=True)):
            wide = np.zeros(actuators.matrix.shape[1])
            wide[where] = normal
            rows.append(Row(f"{thruster.name}.{k}", "actuator", wide, -np.inf, float(bound)))
    for wrench in _wrenches(actuators, 12, seed=1)[5:]:
        problem = build_problem([Level(name, actuators.matrix[axes], wrench[axes]) for name, axes in levels], rows)
        expected = solve(problem, mode="lexicographic", backend="daqp").v
        achieved, components, *_ = _runner(actuators)(wrench, np.ones(len(actuators.thrusters)))
        assert achieved == pytest.approx(actuators.matrix @ expected, abs=1e-6)
        assert components == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("vehicle", ["bluerov2-heavy", "sur540-jets", "skewed"])
def test_no_limit_is_exceeded_and_the_commands_give_the_forces(vehicle: str) -> None:
    actuators = _skewed() if vehicle == "skewed" else _library(vehicle)
    count = len(actuators.thrusters)
    for k, wrench in enumerate(_wrenches(actuators, 150, seed=2)):
        working = np.ones(count)
        if k % 3 == 0:
            working[k % count] = 0.0
        achieved, components, commands, *angles = _runner(actuators)(wrench, working)
        forces = actuators.magnitudes(components)
        for thruster, force, command, on in zip(actuators.thrusters, forces, commands, working, strict=True):
            assert -on * thruster.reverse <= force <= on * thruster.forward * (1 + 1e-15)
            assert thruster.force(float(command)) == pytest.approx(force, abs=1e-9)
        assert achieved == pytest.approx(actuators.matrix @ components, abs=1e-12)
        if angles:
            assert angles[0] == pytest.approx(actuators.angles(components), abs=1e-12)


@pytest.mark.parametrize("real", ["float64", "float32"])
def test_compiled_c_and_the_replay_give_the_same_bytes(real: str) -> None:
    actuators = _library("bluerov2-thrusters")
    block = allocation_block(actuators, "float32" if real == "float32" else "float64")
    native = compile_block(block, real="float32" if real == "float32" else "float64").workspace()
    working = np.array([1.0, 1.0, 0.0, 1.0, 1.0, 1.0])
    for wrench in _wrenches(actuators, 20, seed=3):
        for on in (np.ones(6), working):
            native.inputs[0][:], native.inputs[1][:] = wrench, on
            native.run()
            replayed = replay(block, wrench, on, real=np.float32 if real == "float32" else np.float64)
            for got, expected in zip(native.outputs, replayed, strict=True):
                assert got.tobytes() == np.asarray(expected).tobytes()
            exact = _runner(actuators)(wrench, on)[1]
            assert native.outputs[1] == pytest.approx(exact, abs=1e-9 if real == "float64" else 2e-2)


def _report(wrench: list[float], *failed: str) -> Allocation:
    return allocate(_library("bluerov2-heavy"), wrench, failed=failed)


def test_what_gives_up_and_what_binds_are_named() -> None:
    assert _report([40.0, 20.0, 30.0, 5.0]).explain() == "Every level is reached."
    turning = _report([40.0, 0.0, 0.0, 60.0])
    assert turning.achieved[3] == pytest.approx(attainable(_library("bluerov2-heavy")).intervals()[3, 1])
    assert turning.gave_up == pytest.approx({"yaw": 60 - turning.achieved[3], "force": 40.0}, abs=1e-6)
    assert turning.binding["yaw"] == ("T1", "T2", "T3", "T4")
    rising = _report([10.0, 0.0, 300.0, 0.0])
    assert rising.explain() == "`force` gave up 122.8 N because `T5`, `T6`, `T7` and `T8` bind."
    without = _report([40.0, 40.0, 0.0, 5.0], "T2")
    assert without.forces[1] == without.commands[1] == 0.0
    assert "T2" in without.binding["force"]


def test_another_order_gives_up_another_level() -> None:
    actuators = replace(_library("bluerov2-heavy"), order=("force", "yaw", "effort"))
    found = allocate(actuators, [70.0, 20.0, 0.0, 20.0])
    assert found.achieved[:3] == pytest.approx([70.0, 20.0, 0.0], abs=1e-9)
    assert list(found.gave_up) == ["yaw"]
    single = replace(actuators, order=("sway", "surge", "yaw", "heave", "effort"))
    assert list(allocate(single, [100.0, 60.0, 0.0, 0.0]).gave_up) == ["surge"]


def test_roll_and_pitch_of_the_thrusters_are_reported() -> None:
    found = _report([40.0, 0.0, 0.0, 0.0])
    # the horizontal thrusters are 0.085 m below the origin: a force forward turns the nose up
    assert (found.roll, found.pitch) == pytest.approx((0.0, -0.085 * 40.0))


def test_a_wrong_wrench_or_name_is_refused() -> None:
    with pytest.raises(InputError, match="is not 4 finite numbers"):
        _report([1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="no such thruster"):
        _report([0.0] * 4, "T9")

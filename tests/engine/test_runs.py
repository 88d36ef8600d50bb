"""Runs in MuJoCo: against the own plant, in several processes, with a controller over TCP, and into obstacles."""

from __future__ import annotations

import ctypes
import pickle
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from math import pi
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any, Self

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.export import connect, write_bundle
from surctl.ir.cache import compile_program
from surctl.marine.control import build_law, load_gains
from surctl.marine.engine import BatchCase, EngineOptions, MujocoPhysics, mujoco_physics
from surctl.marine.engine.mjcf import write_mjcf
from surctl.marine.engine.physics import simulate_seeds, simulate_with_steppers
from surctl.marine.export import CompiledLaw, LinkedLaw, build_bundle
from surctl.marine.simulation import Case, OwnPhysics, law_numbers, load_scenario, simulate
from surctl.marine.simulation.metrics import LINK_LOST
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import plant_state
from surctl.system import ControllerStep
from tests.engine.tools import STILL, library, load_vehicle, physics
from tests.tools import need_compiler

GAINS = load_gains("default")
POOL = load_scenario("pool-behind")
CLOSED = build_law("closed_form")


@pytest.mark.parametrize(("vehicle", "dof"), [("sur400", 4), ("sur400-tilting", 6)])
def test_a_run_agrees_with_the_own_plant(vehicle: str, dof: int) -> None:
    runs = [
        simulate(POOL, load_vehicle(vehicle), gains=GAINS, law=CLOSED, physics=made)
        for made in (OwnPhysics, mujoco_physics())
    ]
    own, theirs = (run.metrics for run in runs)
    assert runs[1].plant == f"mujoco, {dof} DoF" and theirs.reached and not runs[1].contacts
    assert theirs.time_s == pytest.approx(own.time_s, abs=0.2)
    assert theirs.min_clearance_m == pytest.approx(own.min_clearance_m, abs=0.003)
    assert theirs.path_error_m == pytest.approx(own.path_error_m, abs=0.002)
    assert (runs[1].record.tilt is not None) == (dof == 6)
    assert runs[1].to_dict()["plant"] == runs[1].plant


def test_jets_in_the_plane_of_the_centre_do_not_tilt_the_hull() -> None:
    """Total force and yaw moment are those of the own plant, which has the thrust at (xt, yt, zt), below the centre."""
    jets, short = load_vehicle("sur540-jets").actuators, replace(POOL, time_limit=2.0)
    boat = replace(load_vehicle("sur400-tilting"), actuators=jets)
    laws = (CLOSED, build_law("closed_form", actuators=jets))  # allocated by the simulation, and by the law
    for law in laws:
        own, theirs = (
            simulate(short, boat, gains=GAINS, law=law, physics=made).record for made in (OwnPhysics, mujoco_physics())
        )
        assert own.tilt is not None and theirs.tilt is not None
        assert np.abs(own.tilt).max() > 0.03 > 20 * np.abs(theirs.tilt).max()


class Here:
    """A pool of processes that is this one, with all pickled that goes in and comes out."""

    def __init__(self, count: int, **_: Any) -> None:
        assert count == 2

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def map(self, function: Callable[[int], Any], seeds: Sequence[int]) -> Iterator[Any]:
        return (sent(sent(function)(seed)) for seed in seeds)


def sent(what: Any) -> Any:
    return pickle.loads(pickle.dumps(what))


def test_runs_in_other_processes_by_the_law_as_c_have_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes of their own are a check of `analysis/40_long_checks`."""
    monkeypatch.setattr("surctl.marine.engine.physics.ProcessPoolExecutor", Here)
    case = Case(
        replace(load_scenario("pool-static"), time_limit=2.0), load_vehicle("sur400-tilting"), GAINS, "closed_form"
    )
    need_compiler()
    by_c = simulate_with_steppers(BatchCase(case, mujoco_physics(), stepper=CompiledLaw), [3, 4], processes=2)
    apart, reports = zip(*by_c, strict=True)
    assert [(run.replaced, report.answered, report.differing) for run, report in zip(apart, reports, strict=True)] == [
        (True, 40, 0),
        (True, 40, 0),
    ]
    here = list(simulate_seeds(BatchCase(case, mujoco_physics()), [3, 4]))
    for one, other in zip(apart, here, strict=True):
        assert one.seed == other.seed and one.record.eta.tobytes() == other.record.eta.tobytes()
        assert one.record.law_input.tobytes() == other.record.law_input.tobytes()
    assert one.record.law_input.tobytes() != apart[0].record.law_input.tobytes()  # the seed counts


def test_a_killed_controller_leaves_no_thrust_and_ends_the_run(tmp_path: Path) -> None:
    need_compiler()
    tank, boat = load_scenario("tank-static"), load_vehicle("sur540-flooded")
    p = law_numbers(tank, GAINS, boat)
    bundle = build_bundle(CLOSED, CLOSED.gains.unpack(p))
    write_bundle(bundle, tmp_path)
    sources = [tmp_path / file for file in ("controller.c", "link.c", *bundle.sources)]
    program = compile_program(sources, tmp_path / "controller", flags=("-O0",))
    with Popen([program, "0"], stdout=PIPE, text=True) as controller:
        assert controller.stdout is not None
        with connect(controller.stdout.readline().split()[-1]) as line:
            linked, steps = LinkedLaw(CLOSED, p, line), []

            def stepper(x: np.ndarray, u: np.ndarray, gains: np.ndarray) -> ControllerStep:
                if len(steps) == 60:
                    controller.kill()
                    controller.wait()
                steps.append(linked(x, u, gains))
                return steps[-1]

            run = simulate(tank, boat, gains=GAINS, law=CLOSED, stepper=stepper, physics=mujoco_physics())
    assert run.metrics.stopped_because == LINK_LOST and linked.report().differing == 0
    assert np.abs(run.record.tau[30:60]).max() > 0 and np.all(run.record.tau[66:] == 0)
    assert linked.report().gone_s == pytest.approx(3.0)


def test_the_hull_touches_a_wall_and_stays_outside() -> None:
    system = physics(load_vehicle("sur540-tilting"))
    system.state = plant_state(load_vehicle("sur540-tilting").form).pack({"eta": [0.4, 200, -150, pi]})
    for k in range(400):
        state = system.advance(np.array([5.0, 0, 0, 0]), k * 0.025)
    (contact,) = system.contacts
    assert contact.what == "wall/x0" and 0 < contact.time < 5
    assert state[0] == pytest.approx(0.27, abs=0.005)
    assert system.clearance([])[1] == pytest.approx(state[0] - 0.27, abs=1e-6)


def test_echoes_of_a_fan_are_those_of_the_own_plant_and_the_cone_tilts() -> None:
    scenario = replace(load_scenario("tank-static"), depth=-2.5)
    boat = load_vehicle("sur540-tilting")
    world = build_world(scenario, boat, seed=0)
    array = replace(scenario.sensors.array_on(boat["radius"]), pitch=0.0)
    bodies = world.bodies(0.0)
    mine = OwnPhysics(world, boat, array)
    fan, cone, few = (
        MujocoPhysics(world, boat, array, EngineOptions(rays=rays, count=count))
        for rays, count in (("fan", 2001), ("cone", 2000), ("cone", 40))
    )
    for heading in (0.0, 0.7, 2.0):
        state = plant_state(boat.form).pack({"eta": [2.0, 2.0, -2.5, heading]})
        for system in (mine, fan, cone, few):
            system.state = state
        for sensor in range(array.size):
            exact = mine.echo(sensor, bodies)
            assert fan.echo(sensor, bodies) == pytest.approx(exact, abs=2e-3) or exact > array.maximum + 0.9
            assert cone.echo(sensor, bodies) >= exact - 1e-6 and few.echo(sensor, bodies) >= exact - 1e-6
    limited = MujocoPhysics(world, boat, replace(array, incidence_limit=0.2), EngineOptions(rays="fan"))
    limited.state = plant_state(boat.form).pack({"eta": [2.0, 2.5, -2.5, pi - 1.0]})
    cone.state = limited.state
    assert limited.echo(0, []) > cone.echo(0, []) + 0.1  # the near wall is seen at 20 degrees or more


@pytest.mark.parametrize("echoes", ["specular", "diffuse"])
def test_reflectors_are_those_of_the_own_plant(echoes: str) -> None:
    base, boat = replace(load_scenario("tank-static"), depth=-1.0), load_vehicle("sur540-tilting")
    scenario = replace(base, sensors=base.sensors.hearing(echoes))
    world = build_world(scenario, boat, seed=0)
    array = replace(scenario.sensors.array_on(boat["radius"]), pitch=0.0)
    mine, cone = OwnPhysics(world, boat, array), MujocoPhysics(world, boat, array, EngineOptions(count=4000))
    ranges = []
    for x, y, heading in ((1.0, 2.5, 0.2), (3.2, 2.2, 0.0), (3.2, 2.2, 2.0)):
        mine.state = cone.state = plant_state(boat.form).pack({"eta": [x, y, -1.0, heading]})
        for sensor in range(array.size):
            ranges.append(mine.echo(sensor, world.bodies(0.0)))
            assert cone.echo(sensor, world.bodies(0.0)) == pytest.approx(ranges[-1], abs=3e-3)
    level = 1.0 / np.sin(array.half_angle)  # of the water surface
    assert (abs(max(ranges) - level) < 1e-9) == (echoes == "diffuse")
    down = replace(array, pitch=-0.15)
    mine, cone = OwnPhysics(world, boat, down), MujocoPhysics(world, boat, down, EngineOptions(count=4000))
    mine.state = cone.state = plant_state(boat.form).pack({"eta": [3.2, 2.2, -1.0, 0.0]})
    assert cone.echo(0, world.bodies(0.0)) == pytest.approx(mine.echo(0, world.bodies(0.0)), abs=3e-3)
    assert mine.echo(0, world.bodies(0.0)) == pytest.approx(2.069 if echoes == "diffuse" else 2.388, abs=1e-3)


def test_the_exported_model_moves_as_here(tmp_path: Path) -> None:
    need_compiler()
    mujoco, boat = library(), load_vehicle("sur540-tilting")
    scene, water = write_mjcf(STILL, boat, tmp_path, options=EngineOptions(surface=0.1))
    headers = Path(mujoco.__file__).parent / "include"
    if not headers.exists():
        pytest.skip("this MuJoCo has no header files")
    program = compile_program([water], tmp_path / "water.so", flags=["-shared", "-fPIC", "-isystem", str(headers)])
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    mine = physics(boat, surface=0.1)
    mine.state = plant_state(boat.form).pack({"eta": STILL.start_pose})
    data.ctrl[:] = 4.0, -2.0, 1.0, 0.2
    mujoco.set_mjcb_passive(ctypes.CDLL(str(program)).surctl_water)
    try:
        mujoco.mj_step(model, data, nstep=80)
    finally:
        mujoco.set_mjcb_passive(None)
    for k in range(40):
        mine.advance(np.array([4.0, -2.0, 1.0, 0.2]), k * 0.025)
    assert data.qpos == pytest.approx(mine.data.qpos, abs=1e-12) and np.abs(data.qvel).max() > 0.03


def test_six_degrees_of_freedom_need_stated_centres() -> None:
    with pytest.raises(InputError, match="needs weight, buoyancy"):
        physics(load_vehicle("sur400"), dof=6)


def test_an_unstable_integration_ends_with_the_reason_and_is_no_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MuJoCo itself would begin again from its first state, and write a file into the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("surctl.marine.engine.fluid._UNLIKE", 1000)
    scenario, boat = load_scenario("pool-behind"), load_vehicle("sur400")
    tossed = mujoco_physics(EngineOptions(surface=0.2, box=(100.0, 100.0, 100.0)))
    with pytest.raises(InputError, match=r"step = 0.0125: becomes unstable at 0.\d\d s; give a smaller step"):
        simulate(scenario, boat, gains=load_gains("default"), physics=tossed)
    assert not list(tmp_path.iterdir())

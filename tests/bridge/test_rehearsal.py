"""Sessions with the simulated autopilot, by real frames on simulated time."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.bridge import (
    Act,
    Bridge,
    LinkQuality,
    Plan,
    Rehearsal,
    RehearsalResult,
    SessionRecord,
    SimulatedSub,
    Wire,
)
from surctl.marine.bridge.bridge import plan_session
from surctl.marine.bridge.inputs import Site
from surctl.marine.bridge.rehearsal import rehearse
from surctl.marine.control import load_gains
from surctl.marine.simulation import Run, load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from surctl.marine.vehicle.logs.read import read_recording
from tests.simulation.test_scene_file import messages
from tests.tools import need_compiler, need_module

WORST = LinkQuality(loss=0.2, delay=0.3)


@cache
def plan(mode: str = "alt_hold") -> Plan:
    """The pool without obstacles: 2 m in 11 s."""
    need_compiler()
    need_module("pymavlink")
    scenario = replace(load_scenario("pool-behind"), obstacles=())
    return plan_session(scenario, load_vehicle("sur400"), law="closed_form", mode=mode)


@cache
def tank() -> Plan:
    """The scenario of the bar: an obstacle comes head-on."""
    need_compiler()
    need_module("pymavlink")
    return plan_session(load_scenario("tank-speed-015"), load_vehicle("sur540-flooded"))


def session(
    *acts: Act, link: LinkQuality | None = None, seconds: float = 9.0, of: Plan | None = None, **kinds: Any
) -> RehearsalResult:
    made = of or plan()
    sub = SimulatedSub(made.scenario, made.vehicle, site=made.site, **kinds)
    sub.mode = made.mapping.mode.name
    return rehearse(Bridge(made, Wire()), sub, link=link, acts=acts, limit=seconds)


@cache
def usual() -> RehearsalResult:
    return session(seconds=20.0)


def test_a_flight_through_the_bridge_takes_as_long_as_the_direct_one() -> None:
    """In the scenario of the bar it is a check of `analysis/40_long_checks`."""
    takes_as_long(plan(), usual(), 0.3)


def takes_as_long(made: Plan, result: RehearsalResult, tolerance: float) -> Run:
    """Against the direct run, which is returned."""
    direct = simulate(made.scenario, made.vehicle, gains=load_gains("default"), law=made.law)
    assert result.arrived and result.begun == 1 and result.bad == 0 and result.commands == {511}
    assert result.time == pytest.approx(direct.metrics.time_s, abs=tolerance)
    return direct


@pytest.mark.parametrize("mode", ["manual", "guided"])
def test_it_steers_in_every_mode(mode: str) -> None:
    result = session(of=plan(mode=mode), seconds=20.0)
    assert result.arrived and result.begun == 1 and result.time == pytest.approx(usual().time, rel=0.05)


def test_the_place_of_the_autopilot_s_frame_does_not_matter() -> None:
    # the vehicle heads south, where the autopilot's yaw jumps from pi to -pi
    elsewhere = session(of=replace(plan(), site=Site(1.0, -2.0, np.pi)), seconds=20.0)
    assert elsewhere.arrived and usual().time == pytest.approx(elsewhere.time, abs=0.11)


@pytest.mark.parametrize("action", ["reboot", "cut", "manual", "disarm", "quit"])
def test_after_every_end_the_thrust_is_neutral_and_stays_so(action: str) -> None:
    result = session(Act(2.0, "arm"), Act(5.0, action), link=WORST)
    ((_, after),) = [one for one in result.neutral_after if one[0].action == action]
    assert result.phases["steering"] > 30 and after <= (1.5 if action == "manual" else 0.81), after
    assert result.commands == {511}, "it never arms"


def test_only_arming_again_lets_it_go_on() -> None:
    acts = [Act(2.0, "arm"), Act(4.0, "cut"), Act(8.0, "join"), Act(10.0, "disarm"), Act(12.5, "arm")]
    result = session(*acts, seconds=14.0, pilot_timeout=100.0)
    texts = [text for time, text in result.texts if time > 4.0]
    assert texts[0] == "holding: position or attitude is older than 0.45 s"
    assert [text.partition(":")[0] for text in texts].count("steering") == 1
    assert next(time for time, text in result.texts if text == "steering" and time > 4.0) > 12.5


def test_acts_keep_their_order_and_other_system_ids_are_rehearsed() -> None:
    made = plan()
    sub = SimulatedSub(made.scenario, made.vehicle, target=250, system=33)
    acts = [Act(99.0, "cut"), Act(0.5, "arm"), Act(3.0, "disarm"), Act(3.0, "arm"), Act(3.5, "alt_hold")]
    result = rehearse(Bridge(made, Wire(target=250, system=33)), sub, acts=acts, limit=5.0)
    assert [text for time, text in sub.events if time > 2.9][:2] == [
        "disarmed by the operator",
        "armed by the operator",
    ]
    assert [act.action for act, _ in result.neutral_after] == ["disarm"], "alt_hold is the mode in which it steers"
    assert result.missed == [Act(99.0, "cut")] and np.hypot(*sub.physics.state[4:6]) > 0.05
    assert not result.touched and replace(result, clearance=-0.01).touched


def test_a_vehicle_that_was_armed_before_is_left_alone() -> None:
    result = session(Act(0.0, "arm"), seconds=4.0)
    assert "steering" not in result.phases and "disarm and arm" in result.texts[-1][1]


def test_damaged_repeated_and_overtaking_frames_do_no_harm() -> None:
    rough = LinkQuality(loss=0.1, delay=0.05, jitter=0.1, damaged=0.1, repeated=0.1)
    result = session(link=rough, seconds=25.0)
    assert result.arrived and result.bad > 50


def test_a_silent_moving_obstacle_stops_it() -> None:
    made = tank()
    sub = SimulatedSub(made.scenario, made.vehicle)
    talks = sub._obstacles
    sub._obstacles = lambda now: talks(now) if now < 4.0 else []  # type: ignore[method-assign]
    result = rehearse(Bridge(made, Wire()), sub, limit=6.5)
    held = [(time, text) for time, text in result.texts if "moving obstacle" in text and time > 3.5]
    assert held and held[0][0] == pytest.approx(5.0, abs=0.2) and held[0][1].startswith("holding")


def test_the_law_gets_poses_moved_on_by_their_age() -> None:
    made = plan()
    bridge, sub = Bridge(made, Wire()), SimulatedSub(made.scenario, made.vehicle)
    errors, ages = [], []

    def look(run: Rehearsal) -> None:
        moment = bridge.moment
        assert moment is not None
        if moment.phase == "steering" and moment.eta is not None and moment.time > 4.5:
            errors.append(np.abs(moment.eta[:2] - trail[round(moment.time / 0.05)]).max())
            ages.append(moment.age)
        trail[round((moment.time + 0.05) / 0.05)] = sub.state[0][:2].copy()

    trail = {round(k): np.zeros(2) for k in range(3)}
    rehearse(bridge, sub, link=LinkQuality(delay=0.3), limit=8.0, each=look)
    assert np.median(ages) == pytest.approx(0.315, abs=0.05)
    assert np.median(errors) < 0.02, "0.3 s at 0.15 m/s would be 0.045 m"


def test_a_mission_that_must_be_fed_is_refused() -> None:
    made = plan()
    with pytest.raises(InputError, match="--mode manual or guided"):
        replace(made, scenario=replace(made.scenario, depths=(-0.9, -0.1)))
    path = made.scenario.path
    with pytest.raises(InputError, match="legs without speed_m_per_s, depth_m and corner"):
        replace(made, scenario=replace(made.scenario, path=replace(path, rises=np.array([0.0, -0.1]))))


def test_the_record_of_a_session_can_be_read(tmp_path: Path) -> None:
    bridge, sub = Bridge(plan(), Wire()), SimulatedSub(plan().scenario, plan().vehicle)
    with SessionRecord(tmp_path, "swim", bridge, epoch=1000.0) as record:
        rehearse(bridge, sub, acts=[Act(2.0, "arm")], limit=4.0, log=record)
    read = messages((tmp_path / "swim.mcap").read_bytes())
    assert len(read["/pose"]) > 70 and read["/pose"][0][0] > 1000.0
    assert {m["values"]["phase"] for _, _, m in read["/status"]} == {"ready", "steering"}
    steps = {m["values"]["phase"]: m["status"] is not None for _, _, m in read["/status"]}
    assert steps == {"ready": False, "steering": True}, "0 would say that the law has accepted a step"
    assert max(m["surge_n"] for _, _, m in read["/thrust"]) == 5.0
    assert any("steering" in m["message"] for _, _, m in read["/log"])
    log = read_recording(tmp_path / "swim.tlog", None)
    sent, positions = log.topics["RC_CHANNELS_OVERRIDE"], log.topics["LOCAL_POSITION_NED"]
    assert sent.fields["chan5_raw"].max() == 1900.0 and len(positions.time) > 70
    assert sent.time[0] == pytest.approx(1002.0, abs=1.1)


def test_a_position_that_jumps_is_refused_and_its_thrust_is_neutral() -> None:
    bridge, sub = Bridge(plan(), Wire()), SimulatedSub(plan().scenario, plan().vehicle)
    seen: list[tuple[int, bool]] = []

    def jump(run: Rehearsal) -> None:
        moment = bridge.moment
        assert moment is not None
        if run.now == pytest.approx(5.025):
            sub.physics.state = (
                sub.physics.state + np.eye(12)[1] * 0.8
            )  # 0.8 m aside, as after a reset of the estimator
        elif run.now > 5.025 and moment.status is not None:
            assert moment.axes is not None
            seen.append((moment.status, moment.axes.neutral))

    rehearse(bridge, sub, acts=[Act(2.0, "arm")], limit=8.0, each=jump)
    refused = [neutral for status, neutral in seen if status < 0]
    assert refused and all(refused) and len(refused) < 40
    assert seen[-1][0] >= 0, "a place that stays is believed after a while"


def test_an_autopilot_of_another_kind_is_left_alone() -> None:
    bridge, px4 = Bridge(plan(), Wire()), SimulatedSub(plan().scenario, plan().vehicle)
    real = px4._frame
    px4._frame = lambda system, kind, *n: real(system, kind, *((n[0], 12, *n[2:]) if kind == "heartbeat" else n))  # type: ignore[method-assign]
    rehearse(bridge, px4, acts=[Act(1.0, "arm")], limit=3.0)
    assert bridge.session.phase == "waiting" and bridge.session.why == "the autopilot is not ArduSub"
    assert bridge.moment is not None and bridge.moment.axes is None

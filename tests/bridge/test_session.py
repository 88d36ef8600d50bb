"""The state machine: what the operator, the autopilot and the clock change, and what is sent."""

from __future__ import annotations

from dataclasses import replace

import pytest

from surctl.errors import InputError
from surctl.marine.bridge.session import (
    Clock,
    Limits,
    Session,
    after_arrival,
    after_beat,
    after_estimate,
    after_law,
    after_time,
    sending,
)  # fmt: skip

MODE, OTHER = 2, 19
LIMITS = Limits()
CLOCK = Clock(offset=0.0, replied=10.0, newest=(10.0, 10.0))


def beat(session: Session, now: float, *, armed: bool, mode: int = MODE) -> Session:
    return after_beat(session, now, armed=armed, mode=mode, steering_mode=MODE)


def tick(session: Session, now: float, *, clock: Clock | None = None, obstacle: str = "") -> Session:
    known = clock or replace(CLOCK, replied=now)
    return after_time(session, now, clock=known, steering_mode=MODE, obstacle=obstacle, limits=LIMITS)


def steering(now: float = 10.0) -> Session:
    session = beat(beat(Session(), now - 1.0, armed=False), now, armed=True)
    session = tick(after_estimate(session, now), now)
    assert session.phase == "steering"
    return session


def test_it_steers_only_after_it_has_seen_the_operator_arm() -> None:
    already = tick(after_estimate(beat(Session(), 10.0, armed=True), 10.0), 10.0)
    assert already.phase == "ready" and "disarm and arm" in already.why
    assert sending(already, 10.0, limits=LIMITS) == "nothing"
    assert sending(steering(), 10.0, limits=LIMITS) == "command"


def test_a_change_of_mode_never_hands_the_vehicle_over() -> None:
    other = beat(beat(Session(), 9.0, armed=False), 10.0, armed=True, mode=OTHER)
    other = tick(after_estimate(other, 10.0), 10.0)
    assert other.phase == "ready" and "another mode: set the mode" in other.why
    now_in_it = tick(after_estimate(beat(other, 10.2, armed=True), 10.2), 10.2)
    assert now_in_it.phase == "ready" and "disarm and arm" in now_in_it.why
    early = beat(beat(Session(), 9.0, armed=False), 10.0, armed=True)  # armed in the mode, without an estimate
    early = beat(beat(early, 10.1, armed=True, mode=OTHER), 10.2, armed=True)
    assert tick(after_estimate(early, 10.2), 10.2).phase == "ready"


def test_it_leaves_with_the_mode() -> None:
    left = beat(steering(), 10.5, armed=True, mode=OTHER)
    assert left.phase == "released" and not left.permitted
    assert [sending(left, 10.5 + t, limits=LIMITS) for t in (0.1, 0.6)] == ["neutral", "nothing"]
    back = tick(after_estimate(beat(left, 11.0, armed=True), 11.0), 11.0)
    assert back.phase == "released", "only arming lets it steer again"


def test_a_stale_estimate_holds_and_a_newer_one_goes_on() -> None:
    held = tick(steering(), 10.51)
    assert held.phase == "holding" and held.permitted and sending(held, 10.51, limits=LIMITS) == "neutral"
    assert tick(after_estimate(beat(held, 10.6, armed=True), 10.6), 10.6).phase == "steering"


@pytest.mark.parametrize("lost", ["estimate", "heartbeat", "reply"])
def test_after_a_long_loss_only_the_operator_lets_it_steer_again(lost: str) -> None:
    session, now = steering(), 10.0
    for _ in range(80):
        now += 0.05
        if lost != "heartbeat":
            session = beat(session, now, armed=True)
        if lost != "estimate":
            session = after_estimate(session, now)
        session = tick(session, now, clock=replace(CLOCK, replied=10.0) if lost == "reply" else None)
    assert session.phase == "holding" and not session.permitted, lost
    again = tick(after_estimate(beat(session, now, armed=True), now), now)
    assert again.phase == "holding" and sending(again, now, limits=LIMITS) == "neutral"
    armed = beat(beat(again, now + 0.1, armed=False), now + 0.2, armed=True)
    assert tick(after_estimate(armed, now + 0.2), now + 0.2).phase == "steering"


def test_a_restart_ends_steering_even_if_the_next_heartbeat_says_armed() -> None:
    clock = replace(CLOCK, replied=10.1).stamped(10.1, 0.2)
    assert clock.restarts == 1 and clock.offset is None
    session = tick(steering(), 10.1, clock=clock)
    assert session.phase == "holding" and not session.permitted and session.estimate is None
    session = tick(after_estimate(beat(session, 10.2, armed=True), 10.2), 10.2, clock=replace(clock, replied=10.2))
    assert session.phase == "holding", "it was not seen to be armed"


def test_disarming_arrival_and_a_refusing_law_end_it() -> None:
    disarmed = beat(steering(), 10.2, armed=False)
    assert disarmed.phase == "released" and sending(disarmed, 10.2, limits=LIMITS) == "neutral"
    there = after_arrival(steering(), 10.1)
    assert tick(after_estimate(there, 10.2), 10.2).phase == "arrived" and not there.permitted
    session = steering()
    for k in range(50):
        now = 10.0 + 0.05 * k
        session = after_law(after_estimate(session, now), now, status=-3, limits=LIMITS)
        session = tick(session, now)
    assert session.phase == "holding" and "refuses" in session.why and not session.permitted


def test_a_silent_obstacle_holds() -> None:
    session = tick(steering(), 10.1, obstacle="of system 11")
    assert session.phase == "holding" and "system 11" in session.why
    assert tick(session, 10.2).phase == "steering"


def test_without_a_clock_no_estimate_counts() -> None:
    session = beat(beat(Session(), 9.0, armed=False), 10.0, armed=True)
    waits = after_time(
        after_estimate(session, 10.0), 10.0, clock=Clock(), steering_mode=MODE, obstacle="", limits=LIMITS
    )
    assert waits.phase == "ready" and "TIMESYNC" in waits.why


def test_round_trips_give_the_age_and_old_frames_are_no_restart() -> None:
    clock = Clock().reply(10.6, sent=10.0, boot=5.3)
    assert clock.measured(5.0) == pytest.approx(10.0)
    assert clock.reply(20.0, sent=19.9, boot=14.95).offset == pytest.approx(5.0), "the shorter trip replaces it"
    assert clock.stamped(10.7, 4.9).restarts == 0 and clock.stamped(10.7, 4.2).restarts == 1
    assert clock.stamped(10.7, 60.0).restarts == 1
    assert Clock().reply(100.0, sent=1.0, boot=5.0).offset is None


def test_time_outs_are_checked() -> None:
    with pytest.raises(InputError, match="heartbeat = nan"):
        Limits(heartbeat=float("nan"))
    with pytest.raises(InputError, match="above lost"):
        Limits(estimate=3.0)

"""The barrier with inertia against an independent flight of the worst kind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from math import inf, sqrt
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.guidance import braking
from surctl.marine.guidance.braking import (
    Brakes,
    BrakeSymbols,
    Watch,
    beside,
    brakes_of,
    closing_bound,
    fastest_obstacle,
    range_needed,
    sideways_force,
    stopping_distance,
    stopping_distance_with_drag,
)
from surctl.marine.vehicle import load_vehicle
from tests.oracles.braking_episodes import allowed_speed

FLOODED = load_vehicle("sur540-flooded")
BRAKES = brakes_of(FLOODED)
SLICK = replace(BRAKES, linear=(0.0, 4.0), quadratic=(0.0, 60.0))  # nothing helps ahead, much drags astern
FREE = replace(BRAKES, linear=(0.0, 0.0), quadratic=(0.0, 0.0))  # no drag: nothing is left over
WATCH = Watch(age=0.2, range_error=0.05, speed_error=0.01)

Vector = NDArray[np.float64]


# ---- an independent flight: two dimensions, 5 ms, thrust with lag, obstacles and sensors against it

STEP, EPISODES, SECONDS, CAP = 0.005, 150, 10.0, 0.5  # s, 1, s, m/s


def fly(
    brakes: Brakes, watch: Watch, obstacle: float, *, seed: int, rule: Callable[..., float] | None = None
) -> tuple[float, float]:
    """Least clearance [m] of many episodes, and the share of them that came within 0.1 m.

    Each draws mass, drag and braking force at an end of its range, and its sensor errors at their bounds; the vehicle
    pushes towards the obstacle with all it has whenever the rule lets it, and the obstacle comes on, stops and turns.
    """
    needed = rule or range_needed
    rng = np.random.default_rng(seed)
    n = EPISODES
    mass = rng.choice(brakes.masses, n)
    ahead = rng.choice(brakes.linear, n), rng.choice(brakes.quadratic, n)
    heading = rng.uniform(-np.pi, np.pi, n)
    away = rng.uniform(0.0, 2.0, n)
    speed = rng.uniform(0, 0.1, n)
    place, velocity = np.zeros((n, 2)), np.zeros((n, 2))
    thrust = np.zeros((n, 2))
    other = unit(heading) * (1.0 + away)[:, None]
    radius = rng.uniform(0.05, 0.6, n)
    other += unit(heading) * radius[:, None]
    velocity += unit(heading) * speed[:, None]
    worst = rng.uniform(size=n) < 0.5  # always the worst end of everything, the others as drawn
    mood, braking_now, latched = np.zeros(n), np.zeros(n, dtype=bool), unit(heading)
    latest = round(watch.age / STEP)
    past: list[tuple[Vector, Vector]] = []
    grid = np.linspace(-0.8, 0.8, 1601)
    table = np.array([needed(brakes, watch, v, obstacle=obstacle, fastest=0.0) for v in grid])
    each, least, near, brake = round(watch.period / STEP), np.full(n, inf), np.zeros(n, dtype=bool), np.zeros(n)
    for k in range(round(SECONDS / STEP)):
        gap = other - place
        distance = np.linalg.norm(gap, axis=1)
        normal, clearance = gap / distance[:, None], distance - radius
        closing = np.sum(velocity * normal, axis=1)
        past = [*past, (clearance, closing)][-latest - 1 :]
        least, near = np.minimum(least, clearance), near | (clearance < 0.1)
        if least.min() < 0:
            break
        if k % each == 0:
            sign = rng.choice((-1.0, 1.0), (2, n))
            sign[:, worst] = 1.0
            heard = past[0][0] + watch.range_error * sign[0]
            told = closing - watch.speed_error * sign[1]
            fastest = np.max([v for _, v in past], axis=0) - watch.speed_error * sign[1]
            free = heard >= np.interp(told, grid, table) + np.maximum(fastest, told) * watch.age
            latched = np.where((braking_now & ~free)[:, None], latched, normal)
            braking_now = ~free
            mood = np.where(rng.uniform(size=n) < 0.05, rng.uniform(size=n), mood)
            brake = np.where(worst, brakes.least, rng.uniform(brakes.least, brakes.most, n))
        came = np.where(worst | (mood < 0.5), -1.0, 1 - 2 * mood)[:, None] * normal
        turned = np.where(((mood > 0.8) & ~worst)[:, None], np.column_stack([-normal[:, 1], normal[:, 0]]), came)
        push = np.where(closing < CAP, brakes.most, 0.0)
        asked = np.where(braking_now[:, None], -brake[:, None] * latched, push[:, None] * normal)
        # the plant, straight: drag along the velocity, its least ahead and its largest astern
        back = np.sum(velocity * latched, axis=1) < 0
        lin = np.where(worst, np.where(back, brakes.linear[1], brakes.linear[0]), ahead[0])
        quad = np.where(worst, np.where(back, brakes.quadratic[1], brakes.quadratic[0]), ahead[1])
        size = np.linalg.norm(velocity, axis=1)
        force = thrust - (lin + quad * size)[:, None] * velocity
        place = place + STEP * velocity + STEP**2 / 2 * force / mass[:, None]
        velocity = velocity + STEP * force / mass[:, None]
        share = 1.0 if brakes.lag == 0 else 1 - np.exp(-STEP / brakes.lag)
        thrust = thrust + share * (asked - thrust)
        other = other + STEP * obstacle * turned
    return float(least.min()), float(near.mean())


def unit(angle: Vector) -> Vector:
    return np.column_stack([np.cos(angle), np.sin(angle)])


SETTINGS = [
    (BRAKES, Watch(), 0.0),
    (SLICK, Watch(), 0.0),
    (SLICK, WATCH, 0.0),
    (FREE, Watch(), 0.08),
    (SLICK, Watch(), 0.08),
    (brakes_of(FLOODED, spread=0.2), WATCH, 0.10),
    (brakes_of(load_vehicle("sur400"), spread=0.2), Watch(period=0.1, age=0.1, range_error=0.02), 0.15),
]


@pytest.mark.parametrize("k", [5])  # with drag and errors; others: study 40
def test_nothing_is_ever_hit(k: int) -> None:
    brakes, watch, obstacle = SETTINGS[k]
    least, near = fly(brakes, watch, obstacle, seed=k)
    assert least >= 0
    assert near > 0.3 or watch.range_error > 0  # it comes near: a rule that never lets go would pass too


def scaled(share: float) -> Callable[..., float]:
    """`range_needed` with only a share of S."""

    def way(*args: Any, **keys: Any) -> float:
        return share * stopping_distance(*args, **keys)

    return lambda *args, **keys: range_needed(*args, **keys, stopping=way)


def without_lag(brakes: Brakes, watch: Watch, speed: float, **keys: Any) -> float:
    return range_needed(replace(brakes, lag=0.0), watch, speed, **keys)


def unsampled(brakes: Brakes, watch: Watch, speed: float, **keys: Any) -> float:
    return range_needed(brakes, replace(watch, period=1e-9), speed, **keys)


def blind_to_error(brakes: Brakes, watch: Watch, speed: float, **keys: Any) -> float:
    return range_needed(brakes, replace(watch, range_error=0.0, speed_error=0.0), speed, **keys)


@pytest.mark.parametrize(
    ("k", "rule"),
    [
        (1, scaled(0.9)),
        (1, without_lag),
        (1, unsampled),
        (2, blind_to_error),
    ],
)
def test_a_rule_that_asks_for_less_hits(k: int, rule: Callable[..., float]) -> None:
    brakes, watch, obstacle = SETTINGS[k]
    assert fly(brakes, watch, obstacle, seed=k, rule=rule)[0] < 0


def test_drag_s_help_may_be_counted_on() -> None:
    def rule(*args: Any, **keys: Any) -> float:
        return range_needed(*args, **keys, stopping=stopping_distance_with_drag)

    for k in (3,):
        brakes, watch, obstacle = SETTINGS[k]
        assert fly(brakes, watch, obstacle, seed=k, rule=rule)[0] >= 0


# ---- closed form, inverse and twins

speeds = st.floats(0.0, 0.4)


def drawn(rng: np.random.Generator) -> Brakes:
    low, drag = float(rng.uniform(20, 100)), (rng.uniform(0, 5), rng.uniform(10, 120))
    masses = (low, low * float(rng.uniform(1, 2)))
    least = float(rng.uniform(2, 6))
    return Brakes(masses, least, least * 1.3, float(rng.uniform(0, 0.6)), (0.0, float(drag[0])), (5.0, float(drag[1])))


def symbols(brakes: Brakes, period: float) -> BrakeSymbols:
    numbers = (*brakes.masses, brakes.least, brakes.most, brakes.lag, brakes.linear[1], brakes.quadratic[1], period)
    return BrakeSymbols(*(ca.SX(x) for x in numbers))


def test_symbols_say_what_the_numbers_say() -> None:
    rng = np.random.default_rng(0)
    flat, vo, d = ca.SX.sym("b", 8), ca.SX.sym("vo"), ca.SX.sym("d")
    b = BrakeSymbols(*ca.vertsplit(flat))
    bounded = ca.Function("bounded", [flat, vo, d], [closing_bound(b, d, obstacle=vo)])
    checked = 0
    for _ in range(300):
        brakes, watch = drawn(rng), Watch(period=float(rng.uniform(0.01, 0.2)))
        obstacle, distance = float(rng.uniform(0, 0.2)), float(rng.uniform(-0.2, 3))
        if brakes.left(obstacle) < 0.02 * brakes.least:
            continue
        numbers = [*brakes.masses, brakes.least, brakes.most, brakes.lag, brakes.linear[1], brakes.quadratic[1]]
        bound = float(bounded([*numbers, watch.period], obstacle, distance))
        assert bound == pytest.approx(allowed_speed(brakes, watch, distance, obstacle=obstacle), rel=1e-12, abs=1e-12)
        checked += 1
    assert checked > 150


def test_before_what_is_too_fast_the_symbols_ask_for_a_retreat() -> None:
    bound = float(ca.DM(closing_bound(symbols(BRAKES, 0.05), ca.SX(0.3), obstacle=ca.SX(0.25))))
    assert -0.3 < bound < -0.1
    assert allowed_speed(BRAKES, Watch(), 0.3, obstacle=0.25) == -inf


@given(distance=st.floats(0.05, 4.0), obstacle=st.floats(0.0, 0.15))
def test_the_allowed_speed_is_the_inverse_of_the_range(distance: float, obstacle: float) -> None:
    speed = allowed_speed(BRAKES, WATCH, distance, obstacle=obstacle)
    if speed + WATCH.speed_error + BRAKES.acceleration(obstacle) * WATCH.period + obstacle >= 0:
        assert range_needed(BRAKES, WATCH, speed, obstacle=obstacle) == pytest.approx(distance, abs=1e-12)
    assert allowed_speed(BRAKES, WATCH, distance + 0.01, obstacle=obstacle) > speed
    assert range_needed(BRAKES, WATCH, speed + 1e-3, obstacle=obstacle) > distance


def test_the_closed_form_is_that_of_the_proof() -> None:
    b, s, left = replace(BRAKES, masses=(95.0, 95.0)), 0.2 + 0.05, BRAKES.left(0.05)
    swing = b.lag * (b.most + b.least)
    wanted = (95 * s**2 / 2 + s * swing + swing**2 / (2 * 95)) / left
    assert stopping_distance(b, 0.2, obstacle=0.05) == pytest.approx(wanted, rel=1e-12)


@given(speed=speeds, obstacle=st.floats(0.0, 0.15), share=st.floats(0.0, 1.0))
def test_the_ends_of_the_mass_range_are_the_worst_and_drag_only_helps(
    speed: float, obstacle: float, share: float
) -> None:
    between = BRAKES.masses[0] + share * (BRAKES.masses[1] - BRAKES.masses[0])
    one = replace(BRAKES, masses=(between, between))
    for way in (stopping_distance, stopping_distance_with_drag):
        assert way(one, speed, obstacle=obstacle) <= way(BRAKES, speed, obstacle=obstacle) * (1 + 1e-12)
    assert (
        stopping_distance_with_drag(BRAKES, speed, obstacle=obstacle)
        <= stopping_distance(BRAKES, speed, obstacle=obstacle) * 1.001
    )


# ---- figures

# least range [m] at 0.10, 0.15, 0.22 m/s (rows) before obstacles at 0, 0.05, 0.10, 0.15 m/s (columns)
RANGES = {
    "sur540-flooded, 20 %": [[0.30, 0.52, 0.81, 1.19], [0.48, 0.74, 1.09, 1.52], [0.75, 1.08, 1.47, 1.96]],
    "sur540-flooded, its ranges": [[0.33, 0.58, 0.91, 1.35], [0.53, 0.84, 1.22, 1.72], [0.85, 1.22, 1.68, 2.24]],
    "sur400, 20 %": [[0.24, 0.38, 0.56, 0.78], [0.36, 0.53, 0.74, 0.98], [0.55, 0.76, 1.00, 1.28]],
}
FASTEST = {"sur540-flooded, 20 %": 0.227, "sur540-flooded, its ranges": 0.182, "sur400, 20 %": 0.314}


@pytest.mark.parametrize("name", RANGES)
def test_ranges_and_fastest_obstacles_are_those_of_the_study(name: str) -> None:
    vehicle, spread = load_vehicle(name.split(",")[0]), 0.2 if "20" in name else None
    brakes = brakes_of(vehicle, spread=spread)
    found = [
        [
            range_needed(brakes, WATCH, v, obstacle=o, stopping=stopping_distance_with_drag)
            for o in (0.0, 0.05, 0.10, 0.15)
        ]
        for v in (0.10, 0.15, 0.22)
    ]
    worst = 0.015 if spread else 0.065  # WATCH is fitted: what the study took for it is not written down
    assert np.abs(np.array(found) - RANGES[name]).max() < worst
    assert fastest_obstacle(brakes) == pytest.approx(FASTEST[name], abs=0.002)
    assert brakes.left(fastest_obstacle(brakes)) == pytest.approx(0, abs=1e-9)


# ---- what pushes from the side


def test_no_heading_and_no_drag_in_the_range_pushes_more_than_stated() -> None:
    rng = np.random.default_rng(1)
    n = 100_000
    heading, w, obstacle = rng.uniform(0, 2 * np.pi, n), rng.uniform(0, 0.3, n), rng.uniform(0, 0.2, n)
    u = -obstacle * np.cos(heading) - w * np.sin(heading)
    v = -obstacle * np.sin(heading) + w * np.cos(heading)
    one, two = (rng.choice(pair, (2, n)) for pair in (BRAKES.linear, BRAKES.quadratic))
    push = -np.cos(heading) * (one[0] + two[0] * abs(u)) * u - np.sin(heading) * (one[1] + two[1] * abs(v)) * v
    drag = BRAKES.linear[1] * obstacle + BRAKES.quadratic[1] * obstacle**2
    (low, high), (low2, high2) = BRAKES.linear, BRAKES.quadratic
    stated = [sideways_force(BRAKES, float(w[k]), obstacle=float(obstacle[k])) for k in range(1000)]
    bound = (high - low) * w / 2 + sqrt(2) * high2 * obstacle * w + (2 * high2 - low2) * w**2 / (3 * sqrt(3))
    assert stated == pytest.approx(bound[:1000], rel=1e-12)
    assert np.max(push - drag - bound) <= 1e-12
    still = obstacle < 0.002
    assert np.max(push[still] / bound[still]) > 0.8  # not far too much either
    assert beside(BRAKES, 0.1).disturbance == sideways_force(BRAKES, 0.1)


def test_push_and_current_lengthen_the_way() -> None:
    for worse in (replace(BRAKES, disturbance=0.5), replace(BRAKES, current=0.05)):
        for way in (stopping_distance, stopping_distance_with_drag):
            assert way(worse, 0.2, obstacle=0.05) > way(BRAKES, 0.2, obstacle=0.05)
        assert fastest_obstacle(worse) < fastest_obstacle(BRAKES)
    assert fastest_obstacle(replace(BRAKES, disturbance=9.0)) == 0
    assert fastest_obstacle(FREE) == inf
    assert stopping_distance(BRAKES, 0.1, obstacle=0.3) == stopping_distance_with_drag(BRAKES, 0.1, obstacle=0.3) == inf
    assert stopping_distance(BRAKES, 0.1, thrust=-9.0) < stopping_distance(BRAKES, 0.1, thrust=0.0)


# ---- users' mistakes


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"masses": (0.0, 1.0)}, "masses"),
        ({"masses": (2.0, 1.0)}, "masses"),
        ({"linear": (-1.0, 1.0)}, "linear"),
        ({"quadratic": (0.0, inf)}, "quadratic"),
        ({"least": 0.0}, "least"),
        ({"lag": -0.1}, "lag"),
        ({"disturbance": float("nan")}, "disturbance"),
    ],
)
def test_a_bad_number_is_named(change: dict[str, Any], key: str) -> None:
    with pytest.raises(InputError) as caught:
        replace(BRAKES, **change)
    assert caught.value.key == key


@pytest.mark.parametrize("key", [f.name for f in fields(Watch)])
def test_a_bad_watch_is_named(key: str) -> None:
    with pytest.raises(InputError) as caught:
        replace(WATCH, **{key: -1.0})
    assert caught.value.key == key
    with pytest.raises(InputError):
        Watch(period=0.0)


def test_shares_are_checked() -> None:
    for key, value in (("share", 0.0), ("share", 1.1), ("spread", 1.0)):
        with pytest.raises(InputError, match=key):
            brakes_of(FLOODED, **{key: value})
    assert braking.LEAST_THRUST == 0.85

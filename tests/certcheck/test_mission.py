"""The checker of missions: what it accepts, and what it must not."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal, localcontext
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from surctl.certcheck import check_document, mission, turning
from surctl.certcheck.document import Rejected
from surctl.certcheck.mission import (
    ON_LEG,
    Funnel,
    decayed,
    funnel_of,
    leg_length,
    places,
    read_claim,
    starts,
    turned,
)
from surctl.certcheck.region_exact import root_up
from surctl.certcheck.turning_claim import TurningClaim
from surctl.marine.guidance.path import next_leg
from surctl.marine.verification.mission import BrokenChain, MissionClaim, certificate_of, tube_radii
from tests.certcheck.altering import put, sealed
from tests.certcheck.turning_truth import commanded

HERE = Path(__file__).parent
STRAIGHT, BENT = ((0.5, 2.5), (9.5, 2.5)), ((0.0, 0.0), (14.0, 0.0), (28.0, 5.0), (43.0, 3.0))
SLIGHT = ((0.0, 0.0), (25.0, 0.0), (50.0, 3.0), (75.0, 2.0))
EXACT, REST, HELD, CURRENT, LAG, LAG_20 = (
    f"region-turning{end}" for end in ("", "-20-rest", "-20-sampled", "-20-current", "-lag", "-20-lag")
)
CASES = (
    (BENT, EXACT, {}), (BENT, EXACT, {"period": 0.05}), (BENT, EXACT, {"current": 0.003}),
    (SLIGHT, LAG, {"at_rest": False}), (SLIGHT, LAG, {"period": 0.05, "at_rest": False}),
    (STRAIGHT, LAG_20, {}), (STRAIGHT, REST, {}),
    (STRAIGHT, HELD, {"at_rest": False}), (STRAIGHT, CURRENT, {"at_rest": False}),
)  # fmt: skip


@cache
def _built(
    path: Any = BENT,
    member: str = EXACT,
    *,
    at_rest: bool = True,
    period: float = 0.0,
    current: float = 0.0,
    cruise: float | None = None,
) -> str:
    """Return the text of a certificate whose region is that of a certificate of this folder.

    V falls at the claimed rate in all shells. With another period, current or cruise speed, the region is that of
    another claim, and is not proved.
    """
    region = json.loads((HERE / f"{member}.json").read_text())
    for shell in region["proof"]["shells"]:
        del shell["rate"]
    region["claim"]["law"]["cruise"] = cruise or region["claim"]["law"]["cruise"]
    if period:
        region["claim"]["law"]["period_s"] = period
    if current:
        region["claim"]["vehicle"]["current_m_per_s"] = current
        region["proof"]["flow"] = [[0.5, 0.5], [0.0, 0.0], [0.0, 0.0]]
    claim = MissionClaim("mission-test", np.array(path), None, at_rest)  # type: ignore[arg-type]
    return json.dumps(certificate_of(claim, region))


def built(*case: Any, **further: Any) -> dict[str, Any]:
    """Return a certificate, see `_built`."""
    return json.loads(_built(*case, **further))


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Check the chain without the proof of the region, which takes seconds and has its own tests."""
    monkeypatch.setattr(turning, "check", lambda document: None)


def reason_of(document: dict[str, Any]) -> str:
    try:
        mission.check(document)
    except Rejected as rejected:
        return str(rejected)
    return ""


def test_the_whole_certificate_is_accepted() -> None:
    checked, tube = check_document(built()), built()["claim"]["motion"]["tube_m"]
    assert checked.reason == "" and f"stays within {max(tube):g} m of the path" in checked.proves
    assert max(tube) > min(tube)


@pytest.mark.parametrize(("path", "member", "further"), CASES)
def test_chains_are_accepted(path: Any, member: str, further: Any, alone: None) -> None:
    assert reason_of(built(path, member, **further)) == ""


def numbers(document: dict[str, Any], key: str) -> Any:
    return {"tube": document["claim"]["motion"]["tube_m"], "levels": document["proof"]["levels"],
            "path": document["claim"]["path_m"], "within": document["claim"]["start"]["within_m"]}[key]  # fmt: skip


def scaled(key: str, k: int, factor: float) -> Callable[[dict[str, Any]], None]:
    def change(document: dict[str, Any]) -> None:
        numbers(document, key)[k] *= factor

    return change


def moved(k: int, point: tuple[float, float]) -> Callable[[dict[str, Any]], None]:
    def change(document: dict[str, Any]) -> None:
        numbers(document, "path")[k] = list(point)

    return change


def reordered(document: dict[str, Any]) -> None:
    points = np.array(numbers(document, "path"))
    numbers(document, "path")[:] = [*points[:1].tolist(), *(points[0] + np.cumsum(np.diff(points, axis=0)[::-1], 0))]
    numbers(document, "path")[1:] = [list(map(float, point)) for point in numbers(document, "path")[1:]]


def entry(*keys: Any, to: Any) -> Callable[[dict[str, Any]], None]:
    return lambda document: put(document, keys, to)


NEAR_MISSES: tuple[tuple[Callable[[dict[str, Any]], None], str], ...] = (
    (scaled("levels", 0, 4.0), "above 1"),
    (scaled("levels", 1, 0.999), "not in the region of leg 2"),
    (scaled("levels", 2, 0.999), "not in the region of leg 3"),
    (scaled("levels", 0, 0.99), "at the start"),
    (scaled("tube", 0, 0.999), "wider than the claimed tube"),
    (scaled("tube", 1, 0.999), "wider than the claimed tube"),
    (scaled("within", 0, 1.02), "at the start"),
    (scaled("within", 1, 1.01), "at the start"),
    (entry("claim", "motion", "goal_m", to=0.05), "further from the goal"),
    (moved(1, (13.8, 0.0)), "leave out the corner"),  # a shorter leg
    (moved(2, (28.0, 5.05)), "leg 2"),  # a larger turn
    (moved(3, (43.0, 2.9)), "leg 3"),
    (moved(1, (3.0, 0.0)), "leave out the corner"),
    (reordered, "leg"),
    (entry("proof", "multipliers", 0, to=0.9), "not in the region of leg 2"),
    (entry("proof", "multipliers", to=[2.0]), "must have 2 entries"),
    (entry("proof", "levels", to=[1.0, 1.0]), "must have 3 entries"),
    (entry("claim", "loop", "law", "cruise", to=0.16), "start"),  # another speed
    (entry("claim", "loop", "motion", "rate_per_s", to=0.0198), "leave out"),
    (entry("claim", "loop", "vehicle", "lag_s", to=[0.1, 0.1]), "6 rows"),
    (entry("proof", "loop", "shells", 0, "rate", to=0.0199), "rate of a shell must be at least 1/50"),
    (entry("claim", "start", "at_rest", to=1), "true or false"),
    (entry("claim", "excludes", to=[]), "excludes differs"),
    (entry("claim", "path_m", to=[[0, 0]]), "2 to 400 points"),
    (entry("claim", "path_m", 2, to=[14.0, 0.0]), "shorter than the target moves"),
    (entry("claim", "path_m", 2, to=[8.0]), "two coordinates"),
    (entry("claim", "motion", "tube_m", to=[1.0]), "one number for each leg"),
    (entry("claim", "system", to="cruise"), "claim.system"),
    (entry("claim", "name", to=7), "claim.name a text"),
    (entry("claim", "path_m", to="ab"), "2 to 400 points"),
    (entry("claim", "path_m", 1, to="ab"), "two coordinates"),
    (entry("claim", "motion", "tube_m", to="abc"), "one number for each leg"),
    (entry("proof", "levels", to="abc"), "must have 3 entries"),
    (moved(1, (1e-7, 0.0)), "shorter than the target moves"),  # the first leg
    (moved(3, (28.0, 5.0000001)), "shorter than the target moves"),  # the last leg
    (entry("further", to=1), "the certificate"),
)  # fmt: skip


@pytest.mark.parametrize(("change", "message"), NEAR_MISSES)
def test_near_misses_are_rejected(change: Callable[[dict[str, Any]], None], message: str, alone: None) -> None:
    document = built()
    change(document)
    assert message in reason_of(document)


@pytest.mark.parametrize(
    "keys", [("vehicle", "drag_factor"), ("law", "k1"), ("law", "k_v"), ("vehicle", "yaw_rate_rad_per_s")]
)
def test_the_region_of_another_vehicle_is_rejected(keys: tuple[str, str]) -> None:
    document = built(STRAIGHT)
    others = {"drag_factor": [0.9, 1.1], "k1": 0.9, "k_v": 0.3, "yaw_rate_rad_per_s": 5.0}
    put(document, ("claim", "loop", *keys), others[keys[1]])
    assert not check_document(sealed(document)).accepted


def test_a_path_with_sharp_corners_has_no_chain() -> None:
    with pytest.raises(BrokenChain, match=r"a turn of 179 degrees, V may grow to .*, and the region ends at V = 1"):
        built(((0, 0), (90, 0), (1, 1)), at_rest=False, cruise=0.21)
    with pytest.raises(BrokenChain, match="it may leave out the corner"):
        built(((0, 0), (2, 0), (10, 2)))


def test_starts_with_the_targets_velocity_are_further_from_the_path() -> None:
    rest, moving = (built(STRAIGHT, at_rest=at_rest)["claim"]["start"]["within_m"] for at_rest in (True, False))
    assert rest[0] < moving[0]
    assert rest[1] < moving[1]


def test_the_decay_is_bounded_from_above() -> None:
    whole = built(STRAIGHT)
    loop, funnel = read_claim(whole["claim"]).loop, funnel_of(read_claim(whole["claim"]).loop, whole["proof"]["loop"])
    for length in (0.0, 0.3, 5.0, 40.0, 400.0):
        exact = max(0.7 * np.exp(-float(loop.rate) * length / float(loop.cruise)), float(funnel.floor))
        bound = float(decayed(loop, funnel, Fraction(7, 10), Fraction(length)))
        assert exact <= bound * (1 + 1e-12)
        assert bound <= exact * (1 + 1e-3)


def test_v_falls_at_the_rate_of_each_shell() -> None:
    whole = built(STRAIGHT)
    shells = whole["proof"]["loop"]["shells"]
    for k, shell in enumerate(shells):
        shell["rate"] = 0.02 * (len(shells) - k)
    stated = read_claim(whole["claim"])
    funnel, floor = funnel_of(stated.loop, whole["proof"]["loop"]), whole["proof"]["loop"]["floor"]
    time, high = 0.0, 0.7
    for shell, low in zip(shells[::-1], [*(one["level"] for one in shells[-2::-1]), floor], strict=True):
        if low >= high:
            continue
        for level in (low + 0.3 * (high - low), low):
            until = time + np.log(high / level) / shell["rate"]
            bound = float(decayed(stated.loop, funnel, Fraction(7, 10), Fraction(until) * stated.loop.cruise))
            assert level * (1 - 1e-13) <= bound <= level * (1 + 1e-8)
        time, high = until, low


@pytest.mark.parametrize("member", [LAG_20, "region-cruise-20-lag"])  # axes with other and with equal drag
@pytest.mark.parametrize("degrees", [0, 20, 45, 77, 90, 200, 301])
def test_the_thrust_of_every_steady_cruise_is_covered(degrees: float, member: str) -> None:
    whole = built(STRAIGHT, member, at_rest=False)
    loop = read_claim(whole["claim"]).loop
    ends = sorted({tuple(map(float, e)) for e in funnel_of(loop, whole["proof"]["loop"]).steady})
    assert len(ends) == 8 and ends[0][0] < 0 < ends[-1][0]
    for share in np.linspace(0, 1, 9):
        x = (1 - share) * ends[0][0] + share * ends[-1][0]
        first, second = np.array(ends[:4])[:, 4:], np.array(ends[4:])[:, 4:]
        low, high = ((1 - share) * f(first, axis=0) + share * f(second, axis=0) for f in (np.min, np.max))
        q = thrust_of(loop, np.array([x]), np.radians([degrees]))[0]
        assert np.all(low - 1e-12 <= q) and np.all(q <= high + 1e-12)
        assert high[0] - low[0] < 1.0 * abs(high[0])


def test_the_thrust_of_a_corner_and_of_a_start_at_rest() -> None:
    whole, psi, turn = built(SLIGHT, LAG, at_rest=False), np.linspace(0, 2 * np.pi, 721), 1.1
    stated = replace(read_claim(whole["claim"]), at_rest=True)
    loop, funnel = stated.loop, funnel_of(stated.loop, whole["proof"]["loop"])
    c, s, x = np.cos(turn), np.sin(turn), float(funnel.steady[0][0]) + 0 * psi
    before, after = thrust_of(loop, x, psi), thrust_of(loop, x, psi - turn)
    jumps = before @ np.array([[c, -s], [s, c]]) - after
    found = turned(stated, funnel, Fraction(c), Fraction(s))[1]
    assert len(found) == 16  # the heading may be any before and after the corner
    ways = np.stack([np.cos(psi), np.sin(psi)])
    for states, true in ((found, jumps), (starts(stated, funnel), -before)):
        allowed = np.array([[float(entry) for entry in state[4:]] for state in states]) @ ways
        assert np.all((true @ ways).max(axis=0) <= allowed.max(axis=0) + 1e-12)
    moving = starts(replace(stated, at_rest=False), funnel)
    assert all(state[2:] == [0, 0, 0, 0] for state in moving)


def thrust_of(loop: TurningClaim, x: Any, psi: Any) -> Any:
    """Return the command of the steady cruise at x* (n,), by the law, per mass and in the frame of the leg (n, 2)."""
    state = np.stack([x, 0 * x, 0 * x + float(loop.cruise), 0 * x], 1)
    body = commanded(loop, state, psi) / np.array([float(m) for m in loop.mass])
    c, s = np.cos(psi), np.sin(psi)
    return np.stack([c * body[:, 0] - s * body[:, 1], s * body[:, 0] + c * body[:, 1]], 1)


@pytest.mark.parametrize(("path", "member", "further"), [*CASES[:2], *CASES[3:5]])
def test_states_at_a_corner_are_in_the_next_region(path: Any, member: str, further: Any, alone: None) -> None:
    """Turn states of the border by an angle, not by the checker's exact cosines."""
    whole, rng = built(path, member, **further), np.random.default_rng(1)
    stated, levels = read_claim(whole["claim"]), whole["proof"]["levels"]
    funnel, v, points = funnel_of(stated.loop, whole["proof"]["loop"]), float(stated.loop.cruise), np.array(path)
    p, late = np.array([[float(x) for x in row] for row in funnel.p]), float(stated.overrun)
    worst, size, x = 0.0, len(p), np.array([float(funnel.steady[0][0])] * 20_000)
    for k in range(len(levels) - 1):
        before = float(decayed(stated.loop, funnel, Fraction(repr(levels[k])), leg_length(*stated.path[k : k + 2])))
        first, second = np.diff(points[k : k + 3], axis=0)
        angle = np.arctan2(second[1], second[0]) - np.arctan2(first[1], first[0])
        back = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        z, psi = rng.normal(size=(20_000, size)), rng.uniform(0, 2 * np.pi, 20_000)
        z *= np.sqrt(before / np.einsum("ni,ij,nj->n", z, p, z))[:, None]
        d = rng.choice([0.0, late], size=(len(z), 1))
        place = (z[:, :2] + x[:, None] * [1, 0] + d * [1, 0]) @ back.T - d * [1, 0]  # from the target on the next leg
        speed = (z[:, 2:4] + [v, 0]) @ back.T
        after = [place - x[:, None] * [1, 0], speed - [v, 0]]
        if size > 4:
            after.append((z[:, 4:] + thrust_of(stated.loop, x, psi)) @ back.T - thrust_of(stated.loop, x, psi - angle))
        after = np.hstack(after)
        value = float(np.einsum("ni,ij,nj->n", after, p, after).max())
        assert value <= levels[k + 1]
        worst = max(worst, value / levels[k + 1])
    assert worst > (0.9 if size == 4 else 0.1)  # the bound is not far from the worst state


def test_starts_are_in_the_region() -> None:
    whole = built(STRAIGHT)
    stated = read_claim(whole["claim"])
    funnel = funnel_of(stated.loop, whole["proof"]["loop"])
    p = np.array([[float(x) for x in row] for row in funnel.p])
    values = [np.array(list(map(float, start))) @ p @ np.array(list(map(float, start))) for start in
              starts(stated, funnel)]  # fmt: skip
    assert 0.99 < max(values) <= whole["proof"]["levels"][0]


@pytest.mark.parametrize("degrees", [10, 60, 89, 91, 120, 150, 179])
def test_the_law_does_not_leave_out_a_corner(degrees: float) -> None:
    """Where the distances of `places` hold, the law's own rule keeps the leg."""
    turn, rng, wait = np.radians(degrees), np.random.default_rng(2), 0.8
    corner = ca.DM([[0, 0], [5, 0], [5 + 5 * np.cos(turn), 5 * np.sin(turn)]])
    s, here = ca.SX.sym("s"), ca.SX.sym("here", 2)
    rule = ca.Function("rule", [s, here], [next_leg(ca.SX(corner), s, here, near=ca.SX(wait))])
    share = 1.0 if degrees <= 90 else np.sin(turn)
    u = rng.uniform(0.001, 1.0, 4000)
    allowed = np.maximum(float(ON_LEG), share * u / 2)
    way = rng.uniform(0, 2 * np.pi, len(u))
    at = np.stack([5 - u, 0 * u]) + 0.9999 * allowed * np.stack([np.cos(way), np.sin(way)])
    assert np.array_equal(rule((5 - u)[None], at).full().ravel(), 5 - u)
    skipped = rule(
        (5 - u)[None], np.stack([5 - u, 0 * u]) + 2.5 * allowed * np.stack([np.cos(way), np.sin(way)])
    ).full()
    assert np.any(skipped.ravel() != 5 - u)


def test_places_before_a_corner() -> None:
    whole = built()
    stated = read_claim(whole["claim"])
    funnel = funnel_of(stated.loop, whole["proof"]["loop"])
    (far, _, wide), (near, _, narrow) = places(stated, funnel, 0, Fraction(1))
    assert (far, wide) == (stated.loop.wait, stated.loop.wait / 2)
    assert (near, narrow) == (Fraction(1, 5), ON_LEG)


@pytest.mark.parametrize(
    ("turn", "inner", "held"), [(0.3, 20, True), (2.0, 20, True), (0.3, 20, False), (0.3, 0, False)]
)
def test_v_may_begin_to_fall_faster_while_the_robot_is_too_far_from_the_target(
    turn: float, inner: int, held: bool
) -> None:
    whole = built(BENT, EXACT, period=0.05) if held else built()
    corner = (Fraction(14 + 9 * np.cos(turn)), Fraction(9 * np.sin(turn)))
    stated = read_claim(whole["claim"])
    stated = replace(stated, path=(*stated.path[:2], corner))
    length, begin, outer = Fraction(14), Fraction(6, 10), Fraction(1, 1000)
    falls = float((length - Fraction("0.3")) / stated.loop.cruise - stated.loop.period)  # s, until 0.3 m before it
    low = begin * Fraction(np.exp(-float(outer) * falls))
    funnel = funnel_of(stated.loop, whole["proof"]["loop"])
    floor = Fraction(1, 10**4)
    shells = [((begin + low) / 2, outer), (low, outer), (floor, Fraction(inner) or outer)]
    funnel = replace(funnel, shells=shells, floor=floor)
    first, *between, last = places(stated, funnel, 0, begin)
    assert first[1] <= first[2]
    if inner:
        assert last[1] <= last[2]
        [(u, distance, bound)] = between
        assert float(u) == pytest.approx(0.3, abs=1e-6)
        assert bound == u * first[2] / first[0] < distance
    else:  # V does not bend
        assert not between


def test_the_law_decides_at_a_corner_by_the_measured_position(alone: None) -> None:
    whole = built()  # at the end of leg 1, the robot may be as far from the leg as the rule allows
    assert not reason_of(whole)
    put(whole, ("claim", "loop", "vehicle", "place_error_m"), 0.001)
    assert "may leave out the corner at the end of leg 1" in reason_of(whole)


def test_the_tube_shrinks_to_the_goal() -> None:
    whole = built()
    radii = tube_radii(whole)
    motion = whole["claim"]["motion"]
    assert [leg[0, 2] <= most for leg, most in zip(radii, motion["tube_m"], strict=True)] == [True] * 3
    assert radii[-1][-1, 2] <= motion["goal_m"] <= radii[-1][-1, 2] + 2e-4
    assert radii[1][0, :2].tolist() == list(BENT[1])


def test_a_leg_is_longer_than_a_control_period() -> None:
    document = built(BENT, EXACT, period=0.05)
    document["claim"]["path_m"][1] = [0.005, 0.0]  # 0.0075 m a period
    with pytest.raises(Rejected, match="shorter than the target moves"):
        read_claim(document["claim"])


@pytest.mark.parametrize("name", ["starts", "places"])
@pytest.mark.parametrize("first", [True, False])
def test_every_start_and_every_place_counts(
    name: str, first: bool, alone: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad, good = ([Fraction(9)] * 4, [Fraction(0)] * 4) if name == "starts" else ((1, 2, 1), (1, 1, 2))
    monkeypatch.setattr(mission, name, lambda *_: [bad, good] if first else [good, bad])
    assert ("at the start are not in" if name == "starts" else "may leave out the corner") in reason_of(built())


def some_funnel(a: int, b: int, along: tuple[int, int] = (0, 0)) -> Funnel:
    """A funnel with the variances a/7 and b/7 of x_e and y_e."""
    spread = (Fraction(a, 7), Fraction(b, 7))
    p = [[1 / spread[i] if i == j and i < 2 else Fraction(i == j) for j in range(4)] for i in range(4)]
    steady = [[Fraction(x), Fraction(0), Fraction(3, 20), Fraction(0)] for x in sorted(set(along))]
    return Funnel(p, Fraction(0), steady, spread, sum(spread) + 2, [])


@pytest.mark.parametrize(("a", "b"), [(3, 2), (2, 3)])
def test_the_extent_is_a_bound_and_close(a: int, b: int) -> None:
    level, largest = Fraction(5, 11), Fraction(max(a, b), 7) * Fraction(5, 11)
    extent = some_funnel(a, b).extent(level)
    assert largest <= extent**2 <= largest * (1 + Fraction(1, 10**7))
    angle = np.linspace(0, 2 * np.pi, 20001)
    for along in ((-1, 0), (0, 1), (-2, 1)):
        away = max(map(abs, along))
        x, y = (np.sqrt(v / 7 * float(level)) * f(angle) for v, f in ((a, np.cos), (b, np.sin)))
        far = float(np.max(np.hypot(x + away, y)))
        reached = float(some_funnel(a, b, along).extent(level))
        assert far <= reached <= float(np.sqrt(max(a, b) / 7 * float(level))) + away + 1e-6
    assert some_funnel(1, 7, (-1, 0)).extent(level) < root_up(level) + 1  # nearer than the sum of both


def test_a_sharp_turn_has_the_place_at_which_the_next_leg_is_near() -> None:
    stated = read_claim(built()["claim"])
    sharp = replace(stated, path=tuple((Fraction(x), Fraction(y)) for x, y in ((0, 0), (14, 0), (10, 6))))
    found = places(sharp, funnel_of(stated.loop, built()["proof"]["loop"]), 0, Fraction(1))
    assert len(found) == 2 and found[1][0] > Fraction(1, 5)


def test_a_corner_is_passed_within_the_errors_of_its_rotation(monkeypatch: pytest.MonkeyPatch) -> None:
    stated = read_claim(built()["claim"])
    funnel, before, after = some_funnel(3, 2, (-(10**6), 0)), Fraction(5, 11), Fraction(9, 16)
    asked: list[Fraction] = []
    monkeypatch.setattr(mission, "_inside", lambda p, b, m, w, bound, f: asked.append(bound) or True)
    assert mission._turns(stated, funnel, 0, before, after, Fraction(2))
    with localcontext(prec=60):
        root = [Decimal(x.numerator) / Decimal(x.denominator) for x in (funnel.trace * before, after, asked[0])]
        trace, whole, left = (x.sqrt() for x in root)
        moved_by = Decimal(10**6) + Decimal(stated.loop.cruise.numerator) / Decimal(stated.loop.cruise.denominator)
        p = sum(funnel.p[i][i] for i in range(4))
        error = 2 * Decimal("1e-15") * (trace + moved_by) * (Decimal(p.numerator) / Decimal(p.denominator)).sqrt()
        assert left <= whole - error
    assert not mission._turns(stated, funnel, 0, before, Fraction(1, 10**40), Fraction(2))
    answers = iter([True, False])
    monkeypatch.setattr(mission, "_inside", lambda *_: next(answers, True))
    assert not mission._turns(stated, some_funnel(3, 2, (-1, 0)), 0, before, after, Fraction(2))

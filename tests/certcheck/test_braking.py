import json
import time
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from surctl.certcheck import check_document
from surctl.certcheck.braking import bound_distance, disturbance, read_distance, thrust_ahead, upper
from surctl.certcheck.braking_claim import read_claim
from surctl.certcheck.document import Rejected
from surctl.certcheck.law_points import values_at
from surctl.marine.control import load_gains
from surctl.marine.control.closing import velocity_control
from surctl.marine.control.stopping import BARRIERS, BRAKE
from surctl.marine.guidance.braking import brakes_of
from surctl.marine.vehicle import load_vehicle
from tests.certcheck import encounters
from tests.certcheck.altering import altered, numbers, put, sealed, value_of

HERE = Path(__file__).parent
FILES = sorted(HERE.glob("braking-*.json"))
NAMES = [path.stem for path in FILES]

Change = Callable[[dict[str, Any], float], None]


def document(name: str) -> dict[str, Any]:
    return json.loads((HERE / f"{name}.json").read_text())


@pytest.mark.parametrize("name", NAMES)
def test_the_kept_certificates_are_accepted_quickly_and_are_small(name: str) -> None:
    began = time.process_time()
    found = check_document(document(name))
    assert found.accepted, found.reason
    assert time.process_time() - began < 1
    assert len((HERE / f"{name}.json").read_text()) < 10_000


def test_there_are_certificates_of_the_rule_and_of_both_barriers() -> None:
    claims = [document(name)["claim"] for name in NAMES]
    assert {c["law"]["barrier"] if c["law"] else "rule" for c in claims} == {"rule", "inertia", "simple"}
    assert {c["vehicle"]["drag"] for c in claims} == {"along", "axes"}


def scale(d: dict[str, Any], share: float) -> None:
    """Shorten all braking distances of a certificate."""
    for entry in d["distances"]:
        entry["slopes"] = [share * x for x in entry["slopes"]]


# what may be changed, and a change that asks for more than was proved
STRONGER: dict[str, Change] = {
    "lag": lambda d, f: d["claim"]["vehicle"].update(lag_s=0.5 + f),
    "mass": lambda d, f: d["claim"]["vehicle"]["mass_kg"].__setitem__(1, 300 * (1 + f)),
    "lighter": lambda d, f: d["claim"]["vehicle"]["mass_kg"].__setitem__(0, 10 * (1 - f / 2)),
    "least drag": lambda d, f: d["claim"]["vehicle"]["quadratic_drag"].__setitem__(0, 10 * (1 - f)),
    "brake": lambda d, f: d["claim"]["vehicle"].update(brake_n=2.5 * (1 - f / 2)),
    "most": lambda d, f: d["claim"]["vehicle"].update(most_n=12 * (1 + f)),
    "disturbance": lambda d, f: d["claim"]["encounter"].update(disturbance_n=1.0 + f),
    "sideways": lambda d, f: d["claim"]["encounter"].update(sideways_m_per_s=2 * (1 + f)),
    "turn": lambda d, f: d["claim"]["encounter"].update(turn_rad_per_s=2 * (1 + f)),
    "period": lambda d, f: d["claim"]["watch"].update(period_s=0.5 * (1 + f)),
    "age": lambda d, f: d["claim"]["watch"].update(age_s=0.5 * (1 + f)),
    "range error": lambda d, f: d["claim"]["watch"].update(range_error_m=0.06 + f),
    "speed error": lambda d, f: d["claim"]["watch"].update(speed_error_m_per_s=0.1 * (1 + f)),
    "limit": lambda d, f: d["claim"]["table"].update(limit_obstacle_m_per_s=0.2279 + f),
    "needed": lambda d, f: d["claim"]["table"]["needed_m"][2].__setitem__(0, 0.3 * (1 - f)),
    "slopes": lambda d, f: scale(d, 0.99 - f),
    "one slope": lambda d, f: d["distances"][0]["slopes"].__setitem__(3, 0.008 * (1 - f)),
    "short": lambda d, f: d["distances"][0]["knots"].__setitem__(-1, 0.24 * (1 - f)),
}
OF_THE_LAW: dict[str, Change] = {
    "margin": lambda d, f: d["claim"]["law"].update(margin_m=0.0),
    "counts on more": lambda d, f: d["claim"]["law"].update(brake=1.6 + f),
    "slow loop": lambda d, f: d["claim"]["law"].update(k_v_per_s=0.1 * (1 - f / 2)),
    "no gain": lambda d, f: d["claim"]["law"].update(gain=0.0, k_v_per_s=0.4),
    "believed lag": lambda d, f: d["claim"]["law"].update(
        reaction_s=0.1 * (1 - f / 2), stopping={**d["claim"]["law"]["stopping"], "lag_s": 0.0}
    ),
    "integral": lambda d, f: d["claim"]["law"].update(k_i_per_s2=0.01 + f),
    "weak": lambda d, f: d["claim"]["law"].update(limit_n=2.0 * (1 - f / 2)),
    "faster": lambda d, f: d["claim"]["encounter"].update(fastest_m_per_s=0.9 + f),
}


@pytest.mark.parametrize(
    ("kind", "name"),
    [(k, "braking-rule-20") for k in STRONGER] + [(k, "braking-inertia-ranges") for k in OF_THE_LAW],  # more: study 40
)
def test_what_asks_for_more_is_rejected_however_it_is_sealed(kind: str, name: str) -> None:
    change = {**STRONGER, **OF_THE_LAW}[kind]
    for share in np.random.default_rng(len(kind)).uniform(size=1):
        changed = document(name)
        change(changed, float(share))
        assert not check_document(changed).accepted
        assert not check_document(sealed(changed)).accepted, (kind, share)


@pytest.mark.parametrize(
    ("where", "value"),
    [
        (("claim", "system"), "other"),
        (("claim", "assumes"), []),
        (("claim", "sha256_law"), "0"),
        (("claim", "more"), 1),
        (("claim", "law"), {}),
        (("claim", "law", "barrier"), "other"),
        (("claim", "vehicle", "drag"), "none"),
        (("claim", "vehicle", "mass_kg"), [125.0, 50.0]),
        (("claim", "vehicle", "mass_kg"), [0.0, 50.0]),
        (("claim", "vehicle", "brake_n"), "3.5"),
        (("claim", "encounter", "obstacles_m_per_s"), []),
        (("claim", "encounter", "obstacles_m_per_s"), [0.0, 0.0]),
        (("claim", "encounter", "obstacles_m_per_s"), [5.0]),
        (("claim", "table", "needed_m"), [[0.1]]),
        (("claim", "table", "speeds_m_per_s"), [0.1]),
        (("claim", "watch", "period_s"), 0),
        (("distances",), []),
        (("distances", 0, "more"), 1),
        (("distances", 0, "retreats"), 1),
        (("distances", 0, "knots"), [0.0]),
        (("distances", 0, "knots"), [0.0, 0.0, 1.0]),
        (("distances", 0, "slopes"), []),
        (("proofs",), []),
        (("more",), 1),
        pytest.param(("claim", "watch", "period_s"), 10**400, id="huge"),
    ],
)
def test_what_is_malformed_is_rejected(where: tuple[str, ...], value: Any) -> None:
    assert not check_document(sealed(put(document("braking-inertia-ranges"), where, value))).accepted


# ---- a few hundred alterations of one number


def slope(ways: dict[str, Any], z: np.ndarray) -> np.ndarray:
    """G' of a certificate."""
    return np.interp(z, ways["knots"], ways["slopes"])


def refuted(changed: dict[str, Any]) -> bool:
    """Whether sums and grids in floating point show an altered certificate to be false."""
    claim = changed["claim"]
    vehicle, met, table = claim["vehicle"], claim["encounter"], claim["table"]
    if any(n < 0 for n in (value_of(claim, p) for p in numbers(claim))):
        return True
    if any(vehicle[key][0] > vehicle[key][1] for key in ("mass_kg", "linear_drag", "quadratic_drag")):
        return True
    for column, obstacle in enumerate(met["obstacles_m_per_s"]):
        for row, speed in enumerate(table["speeds_m_per_s"]):
            least = encounters.needed(changed, speed, obstacle, since=speed)
            if table["needed_m"][row][column] < least * (1 - 1e-5):
                return True
        if claim["law"] is not None and encounters.lacking(changed, obstacle) > 1e-4:
            return True
        ways, through = changed["distances"][column], obstacle + met["current_m_per_s"]
        z = np.linspace(0, ways["knots"][-1], 3000)
        left = vehicle["brake_n"] - encounters.pushed(changed, through) + encounters.drag(changed, z - through)
        steps = (np.diff(ways[key]) for key in ("knots", "slopes"))
        if any(np.any(step < 0) for step in steps) or np.any(slope(ways, z) * left < z * (1 - 1e-6)):
            return True
    return False


def test_no_altered_certificate_that_brute_force_refutes_is_accepted() -> None:
    rng, false, accepted = np.random.default_rng(5), 0, 0
    for k in range(30):
        name = NAMES[k % len(NAMES)]
        part = "claim" if rng.uniform() < 0.7 else "distances"
        _, changed = altered(document(name), [part], rng, (0.02, 0.3, 1.0))
        if changed == document(name):
            continue
        assert not check_document(changed).accepted
        good = check_document(sealed(changed)).accepted
        accepted += good
        if good:
            assert not refuted(changed), name
        elif k % 5 == 0:
            false += refuted(changed)
    assert accepted > 2 and false > 2


def test_brute_force_refutes_none_of_the_kept_ones() -> None:
    assert not any(refuted(document(name)) for name in NAMES)


# ---- the law that flies is the one that is claimed


@pytest.mark.parametrize("barrier", ["inertia", "simple"])
@pytest.mark.parametrize("obstacle", [0.0, 0.07])
def test_what_the_law_keeps_is_the_inverse_of_its_own_bound(barrier: Any, obstacle: float) -> None:
    name = {"inertia": "braking-inertia-ranges", "simple": "braking-simple-20"}[barrier]
    whole = document(name)
    whole["claim"]["encounter"]["obstacles_m_per_s"] = [obstacle]
    claim = read_claim(whole["claim"])
    assert claim.law is not None
    gains, vehicle = load_gains("default"), load_vehicle("sur540-flooded")
    own = brakes_of(vehicle)
    stopping = (*own.masses, own.most, own.lag, own.linear[1], own.quadratic[1])
    p = {
        **{key: ca.SX(gains[key]) for key in ("brake", "reaction")},
        "thrust_limit": ca.SX(list(vehicle.thrust_limit)),
        "mass": ca.SX(list(vehicle.mass)),
        "stopping": ca.SX(list(stopping)),
    }
    d = ca.SX.sym("d")
    period = float(claim.period)
    law = ca.Function("law", [d], [BARRIERS[barrier](p, period)(d, ca.SX(-obstacle))])
    distances = np.linspace(-0.05, 2.0, 40)
    bounds = np.array([[float(law(distance)) for distance in distances.tolist()]])
    text = bound_distance(claim.law, claim.obstacles[0], claim.period)
    assert values_at(["b"], bounds, {"K": text})["K"] == pytest.approx(distances, abs=1e-9)


def test_beyond_the_excess_the_velocity_loop_asks_for_the_braking_force() -> None:
    whole = document("braking-inertia-20-axes")
    claim = read_claim(whole["claim"])
    assert claim.law is not None and float(claim.law.gain) == BRAKE
    vehicle, gains, rng = load_vehicle("sur540-flooded"), load_gains("default"), np.random.default_rng(3)
    wanted, nu = ca.SX.sym("w", 4), ca.SX.sym("n", 4)
    model = {
        "mass": ca.SX(list(vehicle.mass)),
        "linear_drag": ca.SX(list(vehicle.linear_drag)),
        "quadratic_drag": ca.SX(list(vehicle.quadratic_drag)),
        "thrust_limit": ca.SX([100.0] * 4),  # what is clipped is a matter of its own
    }
    knobs = {"k_v": ca.SX(gains["k_v"]), "k_r": ca.SX(gains["k_r"]), "k_i": ca.SX(0), "dt": 0.05}
    loop = ca.Function("loop", [wanted, nu], [velocity_control(wanted, nu, ca.SX.zeros(4), model, **knobs)[0]])
    tight = np.inf
    for _ in range(400):
        bound, side = rng.uniform(-0.1, 0.25), rng.choice([-1, 0.5, 1]) * float(claim.sideways)
        angle = rng.uniform(-np.pi, np.pi)
        n, t = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        over = encounters.excess(whole, bound) * rng.choice([1.0, 1.5])
        slower = rng.choice([0.0, 0.05])  # the wish may be below the bound
        asked = (bound - slower - BRAKE * over) * n + side * t
        flown = (bound + over) * n + side * t
        thrust = np.array(loop([*asked, 0, 0], [*flown, 0, 0])).reshape(-1)[:2]
        tight = min(tight, -float(thrust @ n) - float(claim.brake))
    assert 0 <= tight < 0.3


# ---- drag axis by axis


def test_drag_by_axis_never_pushes_more_nor_helps_less_than_stated() -> None:
    whole = document("braking-inertia-20-axes")
    rng, n = np.random.default_rng(7), 40_000
    whole["claim"]["encounter"]["sideways_m_per_s"] = 0.2
    claim, from_float = read_claim(whole["claim"]), whole["claim"]["vehicle"]
    w = rng.uniform(-0.2, 0.2, n)
    along, angle = rng.uniform(-0.15, 0.4, n), rng.uniform(-np.pi, np.pi, n)
    one, two = (np.where(rng.uniform(size=(2, n)) < 0.5, *from_float[k]) for k in ("linear_drag", "quadratic_drag"))
    c, s = np.cos(angle), np.sin(angle)
    u, v = along * c - w * s, along * s + w * c
    force = c * (one[0] + two[0] * abs(u)) * u + s * (one[1] + two[1] * abs(v)) * v
    push = float(upper(disturbance(claim, str(claim.obstacles[0]))))
    turned = (whole["claim"]["encounter"]["turn_rad_per_s"] * from_float["lag_s"]) ** 2 * from_float["most_n"]
    ahead = along >= 0
    helps = encounters.drag(whole, along)
    assert np.all(force[ahead] >= helps[ahead] - (push - turned) - 1e-9)
    astern = ~ahead
    most = np.array([float(upper(disturbance(claim, f"{-a:.9f}"))) - turned for a in along[astern][:800]])
    assert np.all(-force[astern][:800] <= -helps[astern][:800] + most + 1e-9)
    still = astern.nonzero()[0][:800]
    assert np.max((-force[still] + helps[still]) / most) > 0.5  # not far too much either


# ---- the braking distance


def test_the_distance_is_never_below_the_way_and_hardly_above() -> None:
    for name in NAMES:
        whole = document(name)
        claim = read_claim(whole["claim"])
        for column, obstacle in enumerate(claim.obstacles):
            distance = read_distance(claim, obstacle, whole["distances"][column])
            for speed in (0.1, 0.2):
                least = encounters.way(whole, speed + float(obstacle), float(obstacle))
                closing = f"({speed + float(obstacle)!r})"
                stated = max(float(upper(distance.length(closing, mass))) for mass in claim.mass)
                assert least * (1 - 1e-6) <= stated <= least * 1.04 + 1e-3, (name, speed)


def test_what_the_vehicle_gains_in_a_period_counts() -> None:
    whole = document("braking-rule-20")
    whole["claim"]["watch"]["period_s"] = 0.5
    distance = read_distance(read_claim(whole["claim"]), Fraction(0), whole["distances"][0])
    least = encounters.needed(whole, 0.1, 0.0, since=0.1)
    assert least <= float(distance.needed(Fraction(1, 10))) < 1.01 * least


def reason(whole: dict[str, Any], **ways: Any) -> str:
    """Why a certificate with large figures, whose first distance is changed, is rejected."""
    table = whole["claim"]["table"]
    table["needed_m"] = [[9.0] * len(row) for row in table["needed_m"]]
    whole["distances"][0].update(ways)
    return check_document(sealed(whole)).reason


def test_with_large_figures_it_is_accepted() -> None:
    assert reason(document("braking-rule-20")) == ""


def test_a_distance_that_is_too_short_is_rejected() -> None:
    whole = document("braking-rule-20")
    scale(whole, 0.95)
    assert "inequality 1" in reason(whole)


def test_a_distance_that_is_not_convex_is_rejected_though_it_is_long_enough() -> None:
    whole = document("braking-rule-20")
    slopes = whole["distances"][0]["slopes"]
    assert "must not fall" in reason(whole, slopes=[*slopes[:-2], 2 * slopes[-1], slopes[-1]])


def test_a_knot_has_to_be_where_the_speed_through_the_water_changes_sign() -> None:
    whole = document("braking-rule-20")
    ways = whole["distances"][1]
    ways.update(knots=[0.0, ways["knots"][-1]], slopes=[0.0, ways["slopes"][-1]])
    assert "changes sign inside a piece" in reason(whole)


def test_drag_by_axis_helps_less_than_drag_along_the_velocity() -> None:
    whole = document("braking-rule-20")
    whole["claim"]["vehicle"]["drag"] = "axes"
    assert "inequality" in reason(whole)


def test_a_retreat_against_much_drag_is_not_counted_on() -> None:
    whole = document("braking-rule-20")
    whole["claim"]["vehicle"]["lag_s"] = 6.0
    whole["claim"]["vehicle"]["quadratic_drag"][1] = 900.0
    claim, entry = read_claim(whole["claim"]), {"knots": [0.0, 4.0], "slopes": [0.0, 2.0], "retreats": False}
    distance = read_distance(claim, Fraction(0), entry)
    still, astern = (upper(distance.length(s, claim.mass[0])) for s in ("0", "(-1)"))
    assert still == astern > 0
    whole["claim"]["encounter"]["turn_rad_per_s"] = 1e-9
    with pytest.raises(Rejected, match="retreat"):
        read_distance(read_claim(whole["claim"]), Fraction(0), entry)


def test_an_unequal_certificate_whose_distance_ends_or_margin_lacks_a_millimetre_is_rejected() -> None:
    whole = document("braking-inertia-20-unequal")
    knots = whole["distances"][0]["knots"]
    assert "ends at too low a speed" in reason(whole, knots=[*knots[:-1], 0.99 * knots[-1]])
    whole = document("braking-inertia-20-unequal")
    law = whole["claim"]["law"]
    law["margin_m"] = round(law["margin_m"] + encounters.lacking(whole, 0.0, bounds=120) - 1e-3, 9)
    assert "inequality" in reason(whole)


def test_thrust_across_from_before_braking_counts_although_less_may_be_commanded_while_braking() -> None:
    whole = document("braking-inertia-20-unequal")
    whole["claim"]["vehicle"]["side_n"] = 0.0
    claim = read_claim(whole["claim"])
    other = replace(claim, side=thrust_ahead(claim))
    assert read_distance(claim, Fraction(0), whole["distances"][0]).swing == (
        read_distance(other, Fraction(0), whole["distances"][0]).swing
    )
    assert disturbance(claim, "0") == disturbance(other, "0")


def test_a_command_that_is_held_while_the_hull_turns_counts_in_the_period() -> None:
    whole = document("braking-inertia-20-axes")
    claim = replace(read_claim(whole["claim"]), lag=Fraction(0))  # so that no thrust lags, which would turn too
    assert claim.turn and claim.ratio == 1 and claim.law is not None
    at, entry = np.full((2, 1), 0.1), whole["distances"][0]
    still, turning = (
        float(values_at(["b", "v"], at, {"left": distance.obligations()[-1].left})["left"][0])
        for turn in (Fraction(0), claim.turn)
        for distance in [read_distance(replace(claim, turn=turn), Fraction(0), entry)]
    )
    # the thrust across becomes thrust ahead: its impulse adds at least this much speed
    gained = float(claim.most) * (1 - np.cos(float(claim.turn * claim.period))) / float(claim.turn * claim.mass[0])
    assert turning - still >= gained * float(claim.mass[0]) * slope(entry, np.array([0.1]))[0] > 0


def test_a_period_in_which_drag_turns_everything_round_is_rejected() -> None:
    whole = document("braking-rule-20")
    whole["claim"]["watch"]["period_s"] = 3.0
    assert "period is too long" in reason(whole)

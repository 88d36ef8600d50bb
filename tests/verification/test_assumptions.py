"""No claim is offered for proof where the vehicle, the gains or the speed at hand violate what it assumes."""

from dataclasses import replace

import numpy as np
import pytest

from surctl.errors import NotApplicable
from surctl.marine.control import load_gains
from surctl.marine.simulation import load_scenario
from surctl.marine.simulation.safety import mass_difference, safety_claim, turn_rate
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.verification import claims
from surctl.marine.verification.braking import BRAKING_CLAIMS, braking_claim_named
from surctl.marine.verification.library import applicable_claims
from surctl.marine.verification.region import REGION_CLAIMS, region_statement
from surctl.marine.verification.region.turning import TurningClaim

GAINS = load_gains("default")


def plain(vehicle: Vehicle) -> Vehicle:
    """Without ranges, so that any number will do."""
    return replace(vehicle, parameters={k: replace(p, range=None) for k, p in vehicle.parameters.items()})


BASES = tuple(plain(load_vehicle(name)) for name in ("sur400", "sur540-flooded", "bluerov2-wu"))
STEPS = ("braking-keeps", "braking-retreat", "braking-mass")
KINEMATIC = tuple(c.name for c in claims() if c.name not in STEPS)


def drawn(rng: np.random.Generator) -> tuple[Vehicle, float, float]:
    """A vehicle whose surge and sway are alike or differ in one number, a cruise speed and a cap above it [m/s]."""
    vehicle = BASES[rng.integers(len(BASES))]
    values = {name: vehicle[name] * rng.uniform(0.7, 1.4) for name in ("m11", "Xu", "Xuu", "Fu_max")}
    values |= {"m22": values["m11"], "Yv": values["Xu"], "Yvv": values["Xuu"]}
    if rng.uniform() < 0.75:
        values[rng.choice(["m22", "Yv", "Yvv"], p=[0.6, 0.2, 0.2])] *= rng.uniform(0.5, 2.0)
    cruise = float(rng.uniform(0.05, 1.0))
    return vehicle.with_values(values), cruise, cruise * float(rng.uniform(1.05, 2.0))


def alike(vehicle: Vehicle, *pairs: tuple[str, str]) -> bool:
    """The numbers themselves, and where they count the ranges."""
    return all(vehicle[a] == vehicle[b] for a, b in pairs)


def same_ranges(vehicle: Vehicle, *pairs: tuple[str, str]) -> bool:
    return all(vehicle.parameters[a].range == vehicle.parameters[b].range for a, b in pairs)


REGIONS = [name for name, one in REGION_CLAIMS.items() if one.loop != "steered"]  # the drawn vehicles have a sway force
NAMES = (*BRAKING_CLAIMS, *REGIONS, *STEPS, *KINEMATIC)
MASS, DRAG = ("m11", "m22"), (("Xu", "Yv"), ("Xuu", "Yvv"))


def test_no_claim_is_offered_whose_assumptions_an_independent_look_finds_violated() -> None:
    rng = np.random.default_rng(7)
    refused = 0
    for k in range(400):
        vehicle, cruise, cap = drawn(rng)
        one_mass, one_drag = alike(vehicle, MASS), alike(vehicle, *DRAG)
        name = NAMES[k % len(NAMES)]
        at_hand = {**GAINS.values, "speed": cruise, "speed_max": cap}
        try:
            if name in BRAKING_CLAIMS:
                braking = braking_claim_named(name, vehicle, GAINS, cap=cap)
                light, heavy = sorted(vehicle[axis] for axis in MASS)
                assert braking.fastest >= cap and max(braking.speeds) >= min(cap, 0.22)
                assert braking.brakes.masses[0] <= light <= braking.brakes.masses[1] and heavy <= braking.ratio * light
                assert one_drag or braking.drag == "axes"
                rest = braking.brakes.most**2 - (braking.brakes.least**2 if braking.law else 0.0)
                assert braking.ratio == 1 or braking.side**2 == pytest.approx(rest)
            elif name in REGION_CLAIMS:
                region = region_statement(name).claim(vehicle, GAINS, cruise=cruise, cap=cap)
                kind = next(kind for kind in _PLACES if kind in name)
                needs = kind == "turning" or (one_mass and one_drag)
                document = region.document(**_PLACES[kind])
                own = region_statement(name).model_fields_set & {"cruise_m_per_s", "cap_m_per_s"}
                assert needs and (own or document["law"]["cruise"] == cruise)
                assert own or document["law"]["cap"] == cap
            elif name in STEPS:
                [_] = claims(at_hand, [name], vehicle=vehicle)
                assert one_mass and same_ranges(vehicle, MASS)
            else:
                [kinematic] = claims(at_hand, [name], vehicle=vehicle)
                speeds = [v for v in kinematic.variables if v.unit == "m/s" and v.name in ("u", "u_ob")]
                assert all(v.upper >= cap for v in speeds if v.upper > 0)
        except NotApplicable as reason:
            refused += 1
            assert not (one_mass and one_drag) or not same_ranges(vehicle, MASS, *DRAG), (name, str(reason))
            assert "; use" not in str(reason) and "because" in str(reason)
    assert 50 < refused < 220  # claims are both offered and refused


_CRUISE = {"offset": 1.0, "rest_offset": 1.0, "ultimate_bound": (1.0, 1.0), "munk_moment": 1.0}
_PLACES = {
    "cruise": _CRUISE,
    "turning": _CRUISE,
}


def test_claims_state_the_vehicle_with_its_thrusters_and_no_more_thrust_than_it_has() -> None:
    boat = plain(load_vehicle("bluerov2-thrusters"))
    limit = 40.0 * np.sqrt(2.0)  # of vectored thrusters: more than nine decimals
    vehicle = boat.with_values({"Fu_max": limit, "Fv_max": limit, "m22": boat["m11"]})
    assert vehicle.actuators is not None and round(limit, 9) > limit
    braking = braking_claim_named("braking-simple-20", vehicle, GAINS, cap=0.22)
    stated = braking.document([[0.1]], 0.0)
    turning = region_statement("region-turning-20").claim(vehicle, GAINS, cruise=0.15, cap=0.22)
    assert isinstance(turning, TurningClaim)
    assert stated["sha256_vehicle"] == turning.digests[0] == vehicle.digest()
    assert turning.thrust[0] <= limit and stated["vehicle"]["most_n"] >= limit


def test_a_refused_claim_costs_no_other_one_its_result() -> None:
    vehicle = load_vehicle("bluerov2-wu")
    found, refused = applicable_claims(GAINS.values, vehicle=vehicle)
    assert [c.name for c in found] == list(KINEMATIC) and tuple(refused) == STEPS
    assert str(refused["braking-mass"]) == (
        "braking-mass: not applicable to this vehicle, because m11 = 17 kg and m22 = 24.2 kg differ and the claim "
        "assumes equal mass in surge and sway"
    )
    with pytest.raises(NotApplicable, match=r"m22 = 24\.2 kg"):
        claims(names=["v1-printed", "braking-keeps"], vehicle=vehicle)


def test_a_claim_over_ranges_of_surge_is_not_about_a_sway_of_other_ranges() -> None:
    vehicle = load_vehicle("sur540-flooded")
    sway = replace(vehicle.parameters["m22"], range=(50.0, 200.0))
    other = replace(vehicle, parameters={**vehicle.parameters, "m22": sway})
    statement = region_statement("region-cruise-ranges")
    statement.claim(vehicle, GAINS)
    with pytest.raises(NotApplicable, match="the ranges of m11 and m22 differ"):
        statement.claim(other, GAINS)
    claim = braking_claim_named("braking-rule-ranges", other, GAINS)
    assert claim.ratio > 1


def test_kinematic_claims_are_about_the_speeds_at_hand() -> None:
    slow, fast = ({"speed": v, "speed_max": 1.5 * v} for v in (0.2, 1.0))
    for name in ("v1-speed-cap", "course-corrected"):
        statements = [claims({**GAINS.values, **speeds}, [name])[0] for speeds in (slow, fast)]
        assert str(statements[0].right - statements[0].left) != str(statements[1].right - statements[1].left) or (
            statements[0].upper.tolist() != statements[1].upper.tolist()
        )
    [cap] = claims({**GAINS.values, **fast}, ["v1-speed-cap"])
    assert "U_h ≤ 1.5 m/s" in cap.statement
    [mass] = claims({**GAINS.values, **fast}, ["braking-mass"])
    assert mass.variables[0].upper == pytest.approx(1.5 * 0.25 / 0.22 + 0.15)


def test_a_heavier_sway_pushes_a_hull_that_turns_in_the_safety_claim_too() -> None:
    mission, vehicle = replace(load_scenario("tank-static"), cruise=0.2, cap=0.3), load_vehicle("sur540-flooded")
    apart = plain(vehicle.with_values({"m11": 80.0, "m22": 110.0}))
    turning = turn_rate(mission, apart, GAINS, sonar=True)
    told = safety_claim(mission, apart, GAINS, barrier="inertia", turning=turning)
    assert told["mass difference"] == 30.0
    assert told["push"] == pytest.approx(30.0 * turning * 0.3)
    ignored = safety_claim(mission, apart, GAINS, barrier="inertia", turning=turning, difference=0.0)
    assert told["margin needed"] > ignored["margin needed"]
    assert told.holds is (told["covered difference"] >= 30.0)
    assert mass_difference(apart, 0.2) == pytest.approx(36.0)
    assert mass_difference(vehicle) == 0.0  # one mass, one range
    wide = replace(apart.parameters["m11"], range=(50.0, 125.0))
    assert mass_difference(replace(apart, parameters={**apart.parameters, "m11": wide})) == 60.0


def test_a_cap_that_is_the_cruise_speed_leaves_no_claim_about_catching_up() -> None:
    found, refused = applicable_claims({**GAINS.values, "speed": 0.22, "speed_max": 0.22})
    assert sorted(refused) == ["v1-speed-cap", "v1-speed-cap-region"] and "v1-corrected" in {c.name for c in found}
    assert "these speeds, because the speed limit of 0.22 m/s is not above" in str(refused["v1-speed-cap"])
    with pytest.raises(NotApplicable, match="not below the cap"):
        region_statement("region-cruise-20").claim(load_vehicle("sur400"), GAINS, cruise=0.22, cap=0.22)

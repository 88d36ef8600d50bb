"""Whether a certificate and an exported controller belong together: what may differ, and what is left out."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from surctl.certcheck import check_document, seal
from surctl.certcheck.belonging import Belonging, compare
from surctl.certcheck.braking_claim import read_claim as read_braking
from surctl.certcheck.bundle import Manifest, read_bundle, read_manifest
from surctl.certcheck.document import read
from surctl.certcheck.law_points import Law as Listing
from surctl.certcheck.law_points import compare_braking
from surctl.certcheck.steering import STEERED
from surctl.certcheck.turning_claim import read_claim as read_turning
from surctl.errors import InputError
from surctl.export import Bundle, write_bundle
from surctl.export.bundle import build_bundle as build_core
from surctl.export.bundle import law_id
from surctl.export.supplement import PlantLists
from surctl.ir import Layout, Port
from surctl.lyapunov import continuous_dynamics
from surctl.lyapunov.claims import _plain
from surctl.marine.control import Law, build_law, law_source, load_gains
from surctl.marine.export import build_bundle
from surctl.marine.export.origin import Origin, load_certificates, manifest_of
from surctl.marine.simulation import law_numbers, load_scenario
from surctl.marine.tuning import derived_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import claims
from surctl.system import Action, Controller, Plant, System
from surctl.verification import prove

REGION = Path(__file__).with_name("region-cruise-20.json")
MISSION = load_scenario("pool-behind")  # at the cruise of the certificate
VEHICLE = load_vehicle("sur540-flooded")
LAW, INERTIA = build_law(), build_law(barrier="inertia")
P = law_numbers(MISSION, load_gains("default"), VEHICLE)


def region(change: Callable[[dict[str, Any]], None] = lambda _: None, law: str | None = None) -> dict[str, Any]:
    """A region certificate of the law as it is now, its claim changed."""
    document = read(REGION)
    claim = json.loads(json.dumps(document["claim"]))
    claim["sha256_law"] = law or LAW.block.digest()
    change(claim)
    return seal("turning", claim, {"proof": document["proof"]})


def braking(name: str, change: Callable[[dict[str, Any]], None] = lambda _: None) -> dict[str, Any]:
    """A braking certificate of that law, or of none, its claim changed."""
    document = read(REGION.with_name(f"{name}.json"))
    claim = json.loads(json.dumps(document["claim"]))
    if claim["law"] is not None:
        claim["sha256_law"] = {"inertia": INERTIA, "simple": LAW}[claim["law"]["barrier"]].block.digest()
    change(claim)
    return seal("braking", claim, {key: document[key] for key in ("distances", "proofs")})


@cache
def parts(gains: tuple[tuple[str, float], ...], law: Law = LAW) -> tuple[str, Mapping[str, str]]:
    p = law.gains.pack({**law.gains.unpack(P), **{name: np.array([value]) for name, value in gains}})
    bundle = build_bundle(law, law.gains.unpack(p), origin=Origin(VEHICLE, law))
    return bundle.files["manifest.json"], bundle.files


def manifest_for(change: Callable[[dict[str, Any]], None] = lambda _: None, law: Law = LAW, **gains: float) -> Manifest:
    """The manifest of the bundle without its files, sealed again after a change."""
    text, files = parts(tuple(gains.items()), law)
    table = json.loads(text)
    change(table)
    table["vehicle"]["sha256"] = hashlib.sha256(
        json.dumps(table["vehicle"]["values"], sort_keys=True).encode()
    ).hexdigest()
    return read_manifest(table, files)


def bundle_of(certificates: Mapping[str, Any] | None = None, **gains: Any) -> Bundle:
    return build_bundle(LAW, {**LAW.gains.unpack(P), **gains}, origin=Origin(VEHICLE, LAW, certificates))


@pytest.fixture(scope="module")
def plain() -> Bundle:
    return bundle_of()


@pytest.fixture
def folder(plain: Bundle, tmp_path: Path) -> Path:
    write_bundle(plain, tmp_path / "bundle")
    return tmp_path / "bundle"


def written(bundle: Bundle, folder: Path) -> Manifest:
    write_bundle(bundle, folder)
    return read_bundle(folder)


def test_the_cruise_of_the_same_law_vehicle_and_gains_belongs(folder: Path) -> None:
    manifest = read_bundle(folder)
    assert manifest.wrong == () and manifest.id == law_id(LAW, P) and manifest.vehicle == VEHICLE.digest()
    told = compare(region(), manifest)
    assert told.belongs, told.differs
    assert told.excludes[0].startswith("sampling") and told.excludes[1:6] == tuple(region()["claim"]["excludes"])
    assert [text.split(":")[0] for text in told.excludes[6:]] == [
        "rounding", "mass m11", "mass m22", "quadratic drag Xuu", "quadratic drag Yvv", "thrust", "thrust",
        "thrust lag", "conditions", "conditions", "law", "yaw rate", "code",
    ]  # fmt: skip
    assert told.excludes[7] == "mass m11: 50.0 to 125.0 in the vehicle file, 76.0 to 114.0 certified"
    held = compare(region(lambda claim: claim["law"].update(period_s=0.05)), manifest)
    assert held.belongs and not any("sampling" in text for text in held.excludes)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda c: c.update(sha256_law="0" * 64), "law: SHA-256 000000000000 certified"),
        (lambda c: c.update(sha256_vehicle="0" * 64), "vehicle: SHA-256 000000000000 certified"),
        (lambda c: c["law"].update(k1=0.31), "k1[0]: 0.31 certified, 0.3 exported"),
        (lambda c: c["law"].update(lookahead=0.9), "lookahead[0]"),
        (lambda c: c["law"].update(k_v=1.4), "k_v[0]"),
        (lambda c: c["law"].update(wait=1.0), "wait[0]"),
        (lambda c: c["law"].update(cruise=0.2), "cruise[0]: 0.2 certified, 0.15 exported"),
        (lambda c: c["law"].update(cap=0.23), "cap[0]"),
        (lambda c: c["law"].update(mass_kg=[96.0, 95.0]), "mass[0]: 96.0 certified, 95.0 exported"),
        (lambda c: c["law"].update(linear_drag=[3.0, 2.0]), "linear_drag[0]"),
        (lambda c: c["law"].update(quadratic_drag=[60.0, 61.0]), "quadratic_drag[1]"),
        (lambda c: c["law"].update(period_s=0.1), "period: 0.1 s certified, 0.05 s exported"),
        (lambda c: c["vehicle"].update(thrust_n=[6.0, 5.0]), "thrust_limit of Fu_max: at least 6.0 N certified"),
        (
            lambda c: c["vehicle"].update(mass_factor=[0.8, 0.9]),
            "mass m11: 76.0 to 85.5 certified, the vehicle's m11 is 95.0",
        ),
        (lambda c: c["vehicle"].update(mass_factor=[1.1, 1.2]), "mass m11: 104.5"),
        (lambda c: c["vehicle"].update(drag_factor=[1.1, 1.2]), "linear drag Xu: 2.2"),
        (lambda c: c["vehicle"].update(drag_factor=[0.8, 0.9]), "quadratic drag Yvv: 48.0 to 54.0 certified"),
        (lambda c: c["vehicle"].update(yaw_rate_rad_per_s=0.1), "yaw rate: at most 0.1 rad/s certified, 0.45 exported"),
        (lambda c: c["vehicle"].update(lag_s=[0.1, 0.2]), "thrust_lag: 0.1 to 0.2 certified"),
    ],
)
def test_what_differs_is_named(folder: Path, change: Callable[[dict[str, Any]], None], told: str) -> None:
    found = compare(region(change), read_bundle(folder))
    assert not found.belongs and any(text.startswith(told) for text in found.differs), found.differs


def test_unlike_surge_and_sway_of_the_exported_model_differ(tmp_path: Path) -> None:
    mass = np.array(LAW.gains.unpack(P)["mass"])
    mass[1] += 1.0
    found = compare(region(), written(bundle_of(mass=mass), tmp_path / "b"))
    assert found.differs == ("mass[1]: 95.0 certified, 96.0 exported",)


@pytest.mark.parametrize(
    ("name", "gains"),
    [("inertia-20-axes", {}), ("inertia-ranges", {}), ("inertia-20-movers", {"spin": 0.0}),
     ("simple-20", {"spin": 0.0})],
)  # fmt: skip
def test_a_braking_certificate_belongs_to_the_law_and_the_vehicle_that_it_is_about(
    name: str, gains: dict[str, float]
) -> None:
    document = braking(f"braking-{name}")
    assert check_document(document).accepted
    law = LAW if name == "simple-20" else INERTIA
    told = compare(document, manifest_for(law=law, **gains))
    assert told.belongs, (told.differs, told.unbound)
    assert any(text.startswith("thrust of both axes") for text in told.excludes) != name.endswith("axes")


@pytest.mark.parametrize("name", ["rule-20", "rule-ranges"])
def test_a_braking_rule_without_a_law_is_bound_to_no_controller(name: str) -> None:
    found = compare(braking(f"braking-{name}"), manifest_for(spin=0.0))
    assert found.differs == ("law: the certificate is about a braking rule alone, to which it binds no law",)


@pytest.mark.parametrize(
    ("name", "change", "told"),
    [
        ("inertia-ranges", lambda c: c.update(sha256_law="0" * 64), "law: SHA-256 000000000000 certified"),
        ("inertia-ranges", lambda c: c["vehicle"].update(mass_kg=[50.0, 94.0]), "mass: 50.0 to 94.0 certified"),
        ("inertia-ranges", lambda c: c["vehicle"].update(brake_n=5.5), "thrust_limit: at least 5.5 N certified"),
        ("inertia-ranges", lambda c: c["vehicle"].update(most_n=4.0), "thrust: at most 4.0 N certified, 5.0 exported"),
        ("inertia-ranges", lambda c: c["vehicle"].update(side_n=4.0), "thrust across: at most 4.0 N certified"),
        ("inertia-ranges", lambda c: c["vehicle"].update(lag_s=0.1), "thrust_lag: at most 0.1 s certified, 0.3"),
        (
            "inertia-ranges",
            lambda c: c["encounter"].update(turn_rad_per_s=0.1),
            "yaw rate: at most 0.1 rad/s certified",
        ),
        (
            "inertia-ranges",
            lambda c: c["encounter"].update(fastest_m_per_s=0.2),
            "speed: at most 0.2 m/s certified, 0.22",
        ),
        ("inertia-ranges", lambda c: c["watch"].update(period_s=0.1), "period: 0.1 s certified, 0.05 s exported"),
        ("inertia-ranges", lambda c: c["law"].update(margin_m=0.06), "margin[0]: 0.06 certified, 0.05 exported"),
        ("inertia-ranges", lambda c: c["law"].update(k_v_per_s=1.0), "k_v[0]: 1.0 certified"),
        ("inertia-ranges", lambda c: c["law"].update(mass_kg=[90.0, 95.0]), "mass[0]: 90.0 certified"),
        ("inertia-ranges", lambda c: c["law"].update(limit_n=6.0), "thrust_limit: at least 6.0 N certified"),
        ("inertia-ranges", lambda c: c["law"]["stopping"].update(lightest_kg=60.0), "stopping[0]: 60.0 certified"),
        ("rule-20", lambda _: None, "yaw rate: at most 0.0 rad/s certified, 0.45 exported"),
    ],
)
def test_what_differs_from_a_braking_certificate_is_named(
    name: str, change: Callable[[dict[str, Any]], None], told: str
) -> None:
    found = compare(braking(f"braking-{name}", change), manifest_for(law=INERTIA))
    assert not found.belongs and any(text.startswith(told) for text in found.differs), found.differs


def test_a_law_that_believes_in_a_smaller_hull_comes_nearer_than_certified() -> None:
    document, radius = braking("braking-inertia-ranges"), VEHICLE["radius"]
    for hull in (radius, 1.1 * radius):
        assert not compare(document, manifest_for(law=INERTIA, hull=hull)).differs
    told = f"hull: the vehicle has a radius of {radius!r} m, {0.99 * radius!r} m exported"
    assert compare(document, manifest_for(law=INERTIA, hull=0.99 * radius)).differs == (told,)


def test_another_vehicle_s_numbers_do_not_belong_though_every_hash_is_pasted() -> None:
    def pasted(change: Callable[[dict[str, Any]], None]) -> tuple[str, ...]:
        manifest = manifest_for(change, spin=0.0)
        found = [
            compare(certificate, manifest).differs
            for certificate in (
                region(lambda claim: claim.update(sha256_vehicle=manifest.vehicle)),
                braking("braking-simple-20", lambda claim: claim.update(sha256_vehicle=manifest.vehicle)),
            )
        ]
        assert len(found[0]) == len(found[1])
        return found[1]

    def vehicle(**numbers: float) -> Callable[[dict[str, Any]], None]:
        return lambda table: table["vehicle"]["values"].update(numbers)

    assert pasted(vehicle()) == ()
    assert pasted(vehicle(m22=96.0)) == ("mass: equal for surge and sway certified, 95.0 kg and 96.0 kg exported",)
    assert pasted(vehicle(Xuu=47.0, Yvv=47.0)) == (
        "quadratic drag: 48.0 to 72.0 certified, the vehicle's Xuu is 47.0",
        "quadratic drag: 48.0 to 72.0 certified, the vehicle's Yvv is 47.0",
    )
    alike = compare(region(), manifest_for(vehicle(Yvv=64.0))).differs
    assert alike[1].startswith("drag: factors that differ by a share of 0.05 certified, factors that differ by 0.0667")


def test_what_the_manifest_does_not_say_is_not_known() -> None:
    def lacking(change: Callable[[dict[str, Any]], None]) -> tuple[str, ...]:
        found = [compare(one, manifest_for(change)).differs for one in (region(), braking("braking-inertia-ranges"))]
        return tuple(text for text in found[0] if text in found[1] and "does not state" in text)

    told = "{}: the bundle does not state it; export the controller again"
    assert lacking(lambda table: table["vehicle"].pop("ranges")) == (told.format("ranges of the vehicle"),)
    assert lacking(lambda table: table["vehicle"]["values"].pop("m22")) == (told.format("m22"),)

    def without_spin(table: dict[str, Any]) -> None:
        table["gains"]["values"] = [row for row in table["gains"]["values"] if row["name"] != "spin"]

    assert lacking(without_spin) == (told.format("yaw rate"),)


@cache
def steered(vehicle: str = "otter", cruise: float = 1.1, file: str = "") -> tuple[dict[str, Any], Manifest]:
    """The claim about the heading loop of a craft, and the manifest of the bundle of its law."""
    law, boat = build_law("steered"), load_vehicle(vehicle)
    gains = derived_gains(boat.at_speed(cruise), cruise=cruise).with_own(law_source("steered").gains)
    mission = replace(MISSION, cruise=cruise, cap=round(cruise * 0.22 / 0.15, 9))
    bundle = build_bundle(law, law.gains.unpack(law_numbers(mission, gains, boat)), origin=Origin(boat, law))
    claim = read(REGION.with_name(f"region-steered-20{file}.json"))["claim"]
    return claim, read_manifest(json.loads(bundle.files["manifest.json"]), bundle.files)


@pytest.mark.parametrize(
    ("name", "ends", "difference"),
    [
        ("m22", [134.0, 141.0], ""),
        ("m22", [137.6, 141.0], "m22: "),
        ("m44", [38.3, 39.3], "m44: "),
        ("Yv", [138.0, 165.0], "Yv: "),
        ("Nrr", [330.0, 422.0], "Nrr: "),
        ("u", [1.11, 1.21], "speed: "),
        ("u", [0.99, 1.09], "speed: "),
        ("share", [0.9255, 0.999], "share: "),
        ("share", [0.99, 1.0], "share: "),
        ("share", None, "bundle: its entries"),
        ("m24", None, "vehicle: it has m24, which the certificate does not cover"),
        ("Yuv", [1.0, 2.0], "Yuv: the bundle does not state it"),
    ],
)
def test_a_steering_certificate_is_compared_with_the_vehicle(name: str, ends: Any, difference: str) -> None:
    claim, manifest = steered()
    rows = [row for row in claim["parameters"] if row["name"] != name]
    rows += [{"name": name, "unit": "1", "lower": ends[0], "upper": ends[1]}] if ends else []
    result = compare(seal("lyapunov", claim | {"parameters": rows}, {}), manifest)
    assert result.belongs is (not difference), result.differs
    assert any(text.startswith(difference) for text in result.differs) is bool(difference)


def test_the_speed_of_fins_is_that_of_the_law_s_own_model() -> None:
    claim, manifest = steered("remus100", 1.5, "-remus100")
    assert compare({"kind": "lyapunov", "claim": claim}, manifest).belongs
    assert not compare({"kind": "lyapunov", "claim": claim}, replace(manifest, fins={"moment_nm": 10.0})).belongs
    says = ("law: the law for fins, and no other, has a surge speed u_model of its own",)
    claim, manifest = steered()
    finned = replace(manifest, fins={"moment_nm": 1e3})
    assert compare({"kind": "lyapunov", "claim": claim}, finned).differs == says
    row = {"name": "u_model", "unit": "1", "lower": 0.9, "upper": 1.3}
    assert (
        compare({"kind": "lyapunov", "claim": {**claim, "parameters": [*claim["parameters"], row]}}, manifest).differs
        == says
    )


def test_the_name_of_a_steering_certificate_is_a_label_and_every_other_text_is_bound() -> None:
    claim, manifest = steered()
    other = compare({"kind": "lyapunov", "claim": {**claim, "name": "x"}}, manifest)
    assert other.belongs and "name: 'x' is a label, which nothing is compared with" in other.excludes
    assert compare({"kind": "lyapunov", "claim": {**claim, "more": "x"}}, manifest).unbound == ("more = 'x'",)
    for name, text in claim["dynamics"].items():
        for changed in (f"{text} + 2e-4*max(0, 1 - abs(psi - 0.1)/1e-3)", f"({text})*(1 + 1e-30)", "0"):
            result = compare(
                {"kind": "lyapunov", "claim": {**claim, "dynamics": {**claim["dynamics"], name: changed}}}, manifest
            )
            text_ = f"dynamics: the rate of {name} is not that of the heading loop with these gains"
            assert result.differs == (text_,)


@pytest.mark.parametrize("name", ["N0", "Yu", "m14", "Ywv", "other"])
def test_a_parameter_that_the_heading_loop_lacks_does_not_belong(name: str) -> None:
    claim, manifest = steered()
    row = {"name": name, "unit": "1", "lower": 0.0, "upper": 1.0}
    manifest = replace(manifest, values={**manifest.values, name: 0.5})
    assert compare(seal("lyapunov", claim | {"parameters": [*claim["parameters"], row]}, {}), manifest).differs


@pytest.mark.parametrize(("group", "name"), [("states", name) for name in STEERED] + [("parameters", "Yv")])
def test_the_units_of_a_steering_certificate_are_bound(group: str, name: str) -> None:
    claim, manifest = steered()
    rows = [row | {"unit": "km"} if row["name"] == name else row for row in claim[group]]
    result = compare(seal("lyapunov", claim | {group: rows}, {}), manifest)
    assert [text for text in result.differs if text.startswith(f"{name}: in km certified")], result.differs


def test_the_states_of_a_steering_certificate_are_those_of_the_loop() -> None:
    claim, manifest = steered()
    states = claim["states"][1::-1] + claim["states"][2:]
    dynamics = {name: text for name, text in claim["dynamics"].items() if name != "sway"}
    for change in ({"states": states}, {"dynamics": dynamics}, {"dynamics": {**claim["dynamics"], "more": "1"}}):
        result = compare({"kind": "lyapunov", "claim": {**claim, **change}}, manifest)
        assert result.differs == ("law: the states are not those of the heading loop",)


def test_a_steering_certificate_is_about_continuous_time() -> None:
    claim, manifest = steered()
    result = compare(seal("lyapunov", claim | {"time": "discrete"}, {}), manifest)
    assert result.differs == ("time: the heading loop is compared in continuous time",)


@pytest.mark.parametrize(
    ("key", "value", "difference"),
    [
        ("excludes", [], "law: the restrictions"),
        ("system", "cruise", "law: the restrictions"),
        ("sha256_vehicle", "0" * 64, "vehicle: SHA-256"),
        ("sha256_law", "0" * 64, "law: SHA-256"),
    ],
)
def test_the_restrictions_and_digests_of_a_steering_certificate_are_bound(
    key: str, value: object, difference: str
) -> None:
    claim, manifest = steered()
    result = compare(seal("lyapunov", claim | {"about": claim["about"] | {key: value}}, {}), manifest)
    assert not result.belongs and any(text.startswith(difference) for text in result.differs), result.differs


@pytest.mark.parametrize(
    ("name", "at", "factor"),
    [  # the share of the law's sway speed that the cap leaves is not compared, so that munk is bound up to this share
        ("k_psi", 0, 1.001), ("k_r", 0, 1.001), ("lookahead", 0, 1.001), ("munk", 0, 1.3), ("crab_time", 0, 1.001),
        ("thrust_limit", 3, 1.001),
    ],
)  # fmt: skip
def test_the_numbers_of_the_dynamics_of_a_steering_certificate_are_bound(name: str, at: int, factor: float) -> None:
    claim, manifest = steered()
    value = manifest.gains[name][at] * (manifest.gains["mass"][3] if name == "k_r" else 1)
    number, count = re.compile(r"(?<![\w.])\d+(\.\d+)?(?!\w)"), 0

    def other(text: re.Match[str]) -> str:
        nonlocal count
        same = abs(float(text.group()) - value) < 1e-12 * value
        count += same
        return repr(factor * value) if same else text.group()

    dynamics = {key: number.sub(other, text) for key, text in claim["dynamics"].items()}
    assert count
    assert not compare(seal("lyapunov", claim | {"dynamics": dynamics}, {}), manifest).belongs


def test_a_law_that_senses_for_itself_says_so() -> None:
    sensing = build_law(sonar=True, equipment=MISSION.sensors.on(VEHICLE["radius"]))
    manifest = manifest_of(sensing, P, Origin(VEHICLE, LAW))
    found = compare(region(), manifest)
    assert found.belongs and any(text.startswith("perception:") for text in found.excludes)
    own = compare(region(law=sensing.block.digest()), manifest)
    assert own.differs == ("law: the law has no eta among its inputs",)


def altered(folder: Path, change: Callable[[dict[str, Any]], None]) -> tuple[str, ...]:
    path = folder / "manifest.json"
    table = json.loads(path.read_text())
    change(table)
    path.write_text(json.dumps(table))
    found = compare(region(), read_bundle(folder))
    assert not found.belongs
    return found.differs


def test_hashes_are_worked_out_anew(folder: Path) -> None:
    """Who changes a number has to change hashes that the C source bears, too."""

    def faster(table: dict[str, Any]) -> None:
        row = next(row for row in table["gains"]["values"] if row["name"] == "k_r")
        row["values"] = [row["values"][0] * 2]

    differs = altered(folder, faster)
    assert "the stated hash of the gains is wrong" in differs
    assert any("the id does not match law" in text for text in differs)


def test_an_id_that_the_source_does_not_return_is_found(folder: Path) -> None:
    other = hashlib.sha256(b"other").hexdigest()

    def renamed(table: dict[str, Any]) -> None:
        table["id"] = other

    assert any("returns an id that is not the manifest's" in text for text in altered(folder, renamed))


@pytest.mark.parametrize(
    "name", ["surctl_guarded.c", "surctl_guarded_law.c", "link.c", "README.md", "freertos/control_task.c"]
)
def test_an_altered_or_missing_file_is_found(folder: Path, name: str) -> None:
    path = folder / name
    path.write_text(path.read_text() + " ")
    assert compare(region(), read_bundle(folder)).differs == (f"{name} was altered",)
    path.unlink()
    assert compare(region(), read_bundle(folder)).differs == (f"{name} is missing",)


def test_a_vehicle_whose_numbers_were_changed_is_found(folder: Path) -> None:
    def lighter(table: dict[str, Any]) -> None:
        table["vehicle"]["values"]["m11"] = 1.0

    assert "the stated hash of the vehicle is wrong" in altered(folder, lighter)


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"law": 1, "sha256": {}}', "\xff"])
def test_what_is_no_manifest(folder: Path, text: str) -> None:
    (folder / "manifest.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=r"manifest\.json: is not (JSON|the manifest)"):
        read_bundle(folder)


def test_no_folder_and_a_file_name_that_leads_out(folder: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_bundle(folder / "nowhere")
    table = json.loads((folder / "manifest.json").read_text())
    for name in ("../secret", "zephyr/../../secret", "/secret", "zephyr//secret"):
        more = {**table, "sha256": {**table["sha256"], name: "0" * 64}}
        (folder / "manifest.json").write_text(json.dumps(more))
        with pytest.raises(InputError, match="is not the manifest"):
            read_bundle(folder)


@pytest.fixture(scope="module")
def tracking() -> dict[str, Any]:
    """A certificate of an inequality, for these gains."""
    (claim,) = claims(load_gains("default").values, ["v1-corrected"])
    document = prove(claim).certificate
    assert document is not None
    return dict(document)


def test_an_inequality_belongs_if_it_is_stated_for_these_gains(
    tracking: dict[str, Any], folder: Path, tmp_path: Path
) -> None:
    told = compare(tracking, read_bundle(folder))
    assert told.belongs and told.excludes[0].startswith("dynamics")
    for gains in ({"k1": np.array([0.31])}, {"cruise": np.array([0.16])}):
        found = compare(tracking, written(bundle_of(**gains), tmp_path / "other"))
        message = "claim 'v1-corrected' is not the one for the bundle's gains, vehicle and cruise speed"
        assert found.differs == (message,)


def test_an_inequality_about_a_part_that_the_law_has_not(tracking: dict[str, Any], tmp_path: Path) -> None:
    manifest = written(bundle_of(), tmp_path / "b")
    assert "v1-corrected" in manifest.claims and not {"v2-static", "braking-keeps"} & set(manifest.claims)
    claim = {**tracking["claim"], "name": "v2-static"}
    found = compare(seal("interval", claim, {"cases": tracking["cases"]}), manifest)
    assert "does not concern the exported law" in found.differs[0]
    paper = build_law("paper", avoidance="corrected")
    other = build_bundle(paper, paper.gains.unpack(P), origin=Origin(VEHICLE, paper))
    named = written(other, tmp_path / "paper").claims
    assert "clearance-corrected" in named and "clearance-printed" not in named


def test_certificates_travel_and_those_of_another_controller_do_not(
    tracking: dict[str, Any], folder: Path, tmp_path: Path
) -> None:
    path = tmp_path / "v1 corrected.json"
    path.write_text(json.dumps(tracking))
    loaded = load_certificates([path])
    bundle = bundle_of(loaded)
    assert json.loads(bundle.files["certificate-v1-corrected.json"]) == tracking
    assert "certificate-v1-corrected.json" in json.loads(bundle.files["manifest.json"])["sha256"]
    with pytest.raises(InputError, match="is not about this controller: claim 'v1-corrected'"):
        bundle_of(loaded, k1=np.array([0.4]))
    with pytest.raises(InputError, match="the same name in the bundle as another certificate"):
        load_certificates([path, path])
    path.write_text(json.dumps({**tracking, "cases": []}))
    with pytest.raises(InputError, match="is rejected: the hash"):
        load_certificates([path])
    with pytest.raises(InputError, match="is not a file of format"):
        load_certificates([folder / "manifest.json"])


# what a certificate says of the law, against the law's instruction list


@pytest.mark.parametrize(
    ("law", "differs"),
    [({"law": "paper"}, True), ({"barrier": "inertia"}, True), ({}, False)],
)
def test_a_braking_certificate_with_the_digest_of_another_law(law: dict[str, Any], differs: bool) -> None:
    other = build_law(**law)
    found = compare(
        braking("braking-simple-20", lambda c: c.update(sha256_law=other.block.digest())),
        manifest_for(law=other, spin=0.0),
    )
    assert not found.unbound and bool(found.differs) == differs, found
    assert all(text.startswith("law: speed towards a") for text in found.differs)


@pytest.mark.parametrize(
    ("law", "differs"),
    [({"guidance": "ilos"}, True), ({"guidance": "alos"}, True), ({"law": "closed_form"}, True),
     ({"barrier": "inertia"}, False)],
)  # fmt: skip
def test_a_region_certificate_with_the_digest_of_another_law(law: dict[str, Any], differs: bool) -> None:
    """In open water, the barrier changes no command that the certificate states; the others do."""
    other = build_law(**law)
    found = compare(region(law=other.block.digest()), manifest_for(law=other))
    assert bool(found.differs) == differs, found
    assert all(text.startswith("law: thrust at x_e = ") for text in found.differs)


@pytest.mark.parametrize("gain", [0.0, 3.9, 4.1, 1e8])
def test_the_braking_gain_is_that_of_the_law(gain: float) -> None:
    found = compare(braking("braking-simple-20", lambda c: c["law"].update(gain=gain)), manifest_for(spin=0.0))
    assert [text[:20] for text in found.differs] == ["law: speed towards an"[:20], "law: speed towards a wall"[:20]], (
        found
    )


def test_the_velocity_loop_is_that_of_the_law() -> None:
    manifest = manifest_for(spin=0.0)
    law, claim = (
        Listing(manifest.lists[manifest.laws[0]], manifest),
        read_braking(braking("braking-simple-20")["claim"]),
    )
    assert claim.law is not None
    for faster, count in ((1, 0), (Fraction(1000001, 1000000), 2)):
        messages: list[str] = []
        other = replace(claim, law=replace(claim.law, k_v=claim.law.k_v * faster))
        compare_braking(law, other, messages.append)
        assert len(messages) == count and all(text.startswith("law: thrust at a clearance") for text in messages)


def test_a_number_that_is_new_in_a_claim_is_not_bound() -> None:
    document = region()
    claim = {**document["claim"], "more": {"speed": 3.0}}
    with pytest.MonkeyPatch.context() as patch:  # a later version of the claim, whose reader knows the entry
        patch.setattr("surctl.certcheck.belonging.read_turning", lambda _: read_turning(document["claim"]))
        found = compare({"kind": "turning", "claim": claim}, manifest_for())
    assert not found.differs and found.unbound == ("more.speed = 3.0",) and not found.belongs


def test_the_slack_of_an_inequality_is_rounding(tracking: dict[str, Any], folder: Path) -> None:
    manifest = read_bundle(folder)
    for slack, belongs in ((0.0, True), (1e-12, True), (1e6, False)):
        found = compare({"kind": "interval", "claim": {**tracking["claim"], "slack": slack}}, manifest)
        assert found.belongs == belongs, found
    for key, value in (("unit", "km"), ("statement", "0 = 1"), ("name", "v1"), ("more", 1.0)):
        assert not compare({"kind": "interval", "claim": {**tracking["claim"], key: value}}, manifest).belongs


# the folder


def test_files_that_are_not_of_the_export(folder: Path) -> None:
    def wrong() -> tuple[str, ...]:
        return read_bundle(folder).wrong

    (folder / "sil").write_bytes(b"\x7fELF rest")
    (folder / "link.o").write_bytes(b"anything")
    assert wrong() == () and read_bundle(folder).extra == ("link.o", "sil")
    assert any(
        text.startswith("files: link.o, sil are results") for text in compare(region(), read_bundle(folder)).excludes
    )
    for name in ("math.h", "ros2/more.c", "run.log", "program"):
        (folder / name).write_text("text")
        assert wrong() == (f"{name} is not part of the export: remove it, or build in another folder",)
        (folder / name).unlink()


def test_what_is_no_regular_file(folder: Path) -> None:
    path, body = folder / "link.c", (folder / "link.c").read_bytes()
    for kind, make in (
        ("not a regular file", os.mkfifo),
        ("a link", lambda p: p.symlink_to("/dev/zero")),
        ("a link", lambda p: p.symlink_to("link.h")),
    ):
        path.unlink()
        make(path)
        assert read_bundle(folder).wrong == (f"link.c is {kind}",)
    path.unlink()
    path.mkdir()
    assert read_bundle(folder).wrong == ("link.c is missing",)
    path.rmdir()
    path.write_bytes(body)
    assert read_bundle(folder).wrong == ()


def test_two_ports_of_a_vector_with_one_name_are_refused(folder: Path) -> None:
    path = folder / "manifest.json"
    table = json.loads(path.read_text())
    ports = table["lists"]["law.txt"]["inputs"]
    ports.append(ports[0])
    path.write_text(json.dumps(table))
    with pytest.raises(InputError, match="is not the manifest"):
        read_bundle(folder)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), True, "5.0", None])
def test_numbers_of_the_manifest_are_finite_numbers(folder: Path, bad: object) -> None:
    path = folder / "manifest.json"
    text = path.read_text()
    for name in ("thrust_limit", "spin"):
        table = json.loads(text)
        next(row for row in table["gains"]["values"] if row["name"] == name)["values"][0] = bad
        with pytest.raises(InputError, match=r"is not JSON|is not the manifest"):
            path.write_text(json.dumps(table))
            read_bundle(folder)


def test_a_bundle_of_an_older_version(folder: Path) -> None:
    path = folder / "manifest.json"
    table = json.loads(path.read_text())
    del table["lists"]
    path.write_text(json.dumps(table))
    with pytest.raises(InputError, match=r"an older version wrote it; export the controller again"):
        read_bundle(folder)


def test_a_changed_list_or_manifest_is_found(folder: Path) -> None:
    def layout(table: dict[str, Any]) -> None:
        table["lists"]["law.txt"]["inputs"][0] = "pose[4] m, rad"

    assert "the manifest was altered: its seal does not match" in altered(folder, layout)
    path = folder / "law.txt"
    path.write_text(path.read_text().replace("const", "const", 1).replace("add", "sub", 1))
    assert "law.txt was altered" in read_bundle(folder).wrong


# dynamics of a system of one's own


def loop(k: float = 2.0, a: float = 1.0, unit: str = "m") -> System:
    place, goal = Port("place", (1,), unit, "of the cart"), Port("goal", (1,), "m", "reference")
    speed = Port("speed", (1,), "m/s", "of the cart")
    drive = Layout((Port("a", (1,), "1/s", "drive", a),))
    plant = Plant("cart", Layout((place,)), Layout((speed,)), parameters=drive,
                  ode=lambda x, f, d, p: p["a"] * ca.sin(x["place"]) + f["speed"])  # fmt: skip
    law = Controller(
        "hold", 0.05, Layout((place, goal)), plant.inputs,
        lambda x, u, p: Action(p["k"] * (u["goal"] - u["place"]) - x["sum"], {"sum": x["sum"] + 0.05 * u["place"]}),
        state=Layout((Port("sum", (1,), "m s", "integral"),)), gains=Layout((Port("k", (1,), "1/s", "gain", k),)),
    )  # fmt: skip
    return System(plant, law)


def bundled(system: System) -> Manifest:
    law, lists = system.controller, PlantLists(system.plant, system.plant.parameters.pack())
    files = build_core(law, law.gains.unpack(law.gains.pack()), supplement=lists).files
    return read_manifest(json.loads(files["manifest.json"]), files)


def about(system: System, **ranges: tuple[float, float]) -> dict[str, Any]:
    named = {name.replace("_", "."): ends for name, ends in ranges.items()}
    dynamics = continuous_dynamics(system, {"place": (-1.0, 1.0), "controller.sum": (-1.0, 1.0)}, ranges=named)
    plain: dict[str, Any] = json.loads(json.dumps(_plain(dynamics, "stability")))
    return plain


def test_the_dynamics_of_a_certificate_are_those_of_the_bundle() -> None:
    manifest = bundled(loop())

    def compared(change: Callable[[dict[str, Any]], Any], claim: dict[str, Any] | None = None) -> Belonging:
        claim = json.loads(json.dumps(claim or about(loop())))
        change(claim)
        return compare({"kind": "lyapunov", "claim": claim}, manifest)

    good = compared(lambda c: None)
    assert good.belongs, good
    assert "reference: it is assumed to be 0.0" in good.excludes
    for have, end in ((0.0, ""), (0.5, ", but is 0.5 in the run of the bundle")):
        told = compare({"kind": "lyapunov", "claim": about(loop())}, replace(manifest, reference=(have,)))
        assert told.belongs and f"reference: it is assumed to be 0.0{end}" in told.excludes
    assert compared(lambda c: None, about(loop(), k=(1.9, 2.1), plant_a=(0.9, 1.1))).belongs
    for name, change, message in (
        ("copied", lambda c: c["dynamics"].update(place="-2*place"), "dynamics: rate of place at place = "),
        (
            "coefficient",
            lambda c: c["dynamics"].update(controller_sum="1.000001*place"),
            "dynamics: rate of controller_sum",
        ),
        ("period", lambda c: c["about"].update(period_s=0.1), "period: 0.1 s certified, 0.05 s exported"),
        (
            "mass",
            lambda c: c["about"].update(parameters=[0.5]),
            "parameter of the plant[0]: 0.5 certified, 1.0 exported",
        ),
        ("gain", lambda c: c["about"]["gains"].update(k=[3.0]), "k[0]: 3.0 certified, 2.0 exported"),
        ("reference", lambda c: c["about"].update(reference=[0.5]), "dynamics: rate of place"),
        ("plant", lambda c: c["about"].update(plant="0" * 128), "plant: the bundle does not contain the plant"),
        ("more", lambda c: c["about"].update(plant=c["about"]["plant"] + "0"), "plant: the bundle does not contain "),
        ("nothing", lambda c: c.update(about={}), "dynamics: the certificate does not state the loop"),
        ("unit", lambda c: c["states"][0].update(unit="km"), "place: in km certified, in m exported"),
        ("name", lambda c: c.update(name="ship"), "plant: 'ship' certified"),
        (
            "state",
            lambda c: c["about"].update(controller_state=["place"]),
            "dynamics: the certificate does not say which",
        ),
    ):
        found = compared(change)
        assert [text[: len(message)] for text in found.differs] == [message], (name, found)
    assert compared(lambda c: c.update(more=1)).unbound == ("more = 1",)
    with pytest.warns(UserWarning, match="leaves out the nominal value"):
        document = about(loop(), k=(2.1, 2.2))
    outside = compared(lambda c: None, document)
    assert outside.differs == ("k[0]: the range of k does not contain the exported number",)
    without = bundled_without_plant(loop())
    assert compare({"kind": "lyapunov", "claim": about(loop())}, without).differs == (
        "plant: the bundle does not contain the plant that the certificate is about",
    )


def bundled_without_plant(system: System) -> Manifest:
    law = system.controller
    files = build_core(law, law.gains.unpack(law.gains.pack())).files
    return read_manifest(json.loads(files["manifest.json"]), files)


# a vehicle with unequal masses

OWN = load_vehicle("bluerov2-vonbenzon")
OWN_P = law_numbers(MISSION, load_gains("default"), OWN)


def turning(change: Callable[[dict[str, Any]], None] = lambda _: None) -> dict[str, Any]:
    document = read(REGION.with_name("region-turning-20.json"))
    claim = json.loads(json.dumps(document["claim"]))
    claim["sha256_law"] = LAW.block.digest()
    change(claim)
    return seal("turning", claim, {"proof": document["proof"]})


def own_manifest(**values: float) -> Manifest:
    return manifest_of(LAW, OWN_P, Origin(OWN.with_values(values), LAW))


def test_a_turning_certificate_belongs_to_the_vehicle_with_its_masses() -> None:
    found = compare(turning(), own_manifest())
    assert found.belongs, found.differs
    assert set(turning()["claim"]["excludes"]) <= set(found.excludes)


def test_a_mission_belongs_where_the_claim_about_its_legs_does() -> None:
    mission = {"kind": "mission", "claim": {"loop": turning()["claim"]}}
    found, leg = compare(mission, own_manifest()), compare(turning(), own_manifest())
    assert (found.belongs, found.excludes[1:]) == (True, leg.excludes)
    assert found.excludes[0].startswith("path: ")
    assert compare(mission, own_manifest(Xuu=1.3 * 141.0)).differs


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda c: c.update(sha256_law="0" * 64), "law: SHA-256 000000000000 certified"),
        (lambda c: c.update(sha256_vehicle="0" * 64), "vehicle: SHA-256 000000000000 certified"),
        *((lambda c, key=key: c["law"].update({key: 0.7}), f"{key}[0]: 0.7 certified")
          for key in ("k1", "lookahead", "k_v", "wait", "cruise", "cap")),
        (lambda c: c["law"].update(mass_kg=[19.8567, 20.0]), "mass[1]: 20.0 certified"),
        (lambda c: c["law"].update(linear_drag=[14.0, 0.0]), "linear_drag[0]: 14.0 certified"),
        (lambda c: c["law"].update(quadratic_drag=[141.0, 218.0]), "quadratic_drag[1]: 218.0 certified"),
        (lambda c: c["vehicle"].update(mass_factor=[0.9, 0.99]), "mass m11: "),
        (lambda c: c["vehicle"].update(drag_factor=[1.1, 1.2]), "quadratic drag Yvv: "),
        (lambda c: c["vehicle"].update(thrust_n=[40.0, 41.0]), "thrust_limit of Fv_max: at least 41.0 N certified"),
        (lambda c: c["vehicle"].update(thrust_n=[41.0, 40.0]), "thrust_limit of Fu_max: at least 41.0 N certified"),
        (lambda c: c["vehicle"].update(yaw_rate_rad_per_s=0.4), "yaw rate: at most 0.4 rad/s certified, 0.45 exported"),
        (lambda c: c["vehicle"].update(munk_moment_nm=11.0), "thrust_limit of yaw: at least 11.0 N m certified"),
    ],
)  # fmt: skip
def test_what_differs_from_a_turning_certificate_is_named(change: Callable[[dict[str, Any]], None], told: str) -> None:
    found = compare(turning(change), own_manifest())
    assert not found.belongs and any(text.startswith(told) for text in found.differs), found.differs


def test_factors_that_differ_more_than_certified_are_named() -> None:
    found = compare(turning(), own_manifest(Xuu=1.15 * 141.0))
    assert any(text.startswith("drag: factors that differ by a share of 0.05 certified") for text in found.differs)
    own = compare(turning(), own_manifest(Xu=1.15 * 13.7)).differs  # linear and quadratic drag have their own factors
    assert not any(text.startswith("drag: factors") for text in own)
    found = compare(turning(), own_manifest(m11=0.96 * 19.8567, m22=1.04 * 20.6206))
    assert any(text.startswith("mass: factors that differ by a share of 0.05 certified") for text in found.differs)


def test_a_folder_that_cannot_be_listed_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(folder: Path) -> None:
        raise PermissionError(13, "Permission denied", folder)

    monkeypatch.setattr(os, "scandir", denied)
    with pytest.raises(InputError, match=r"cannot be read \(Permission denied\)"):
        read_bundle(tmp_path)


def test_instruction_lists_have_a_limit_together(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("surctl.certcheck.bundle.LARGEST", (folder / "manifest.json").stat().st_size)
    with pytest.raises(InputError, match="has instruction lists of more than"):
        read_bundle(folder)

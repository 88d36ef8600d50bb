"""Comparisons of a certificate with a controller in which one line alone decides."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from surctl.certcheck import seal
from surctl.certcheck.belonging import Belonging, compare
from surctl.certcheck.bundle import Manifest, stated_sha256
from tests.certcheck.test_bundle import about, braking, bundled, loop, manifest_for, own_manifest, steered
from tests.certcheck.test_bundle import turning as turning_document


def says(texts: tuple[str, ...], begin: str) -> bool:
    return any(text.startswith(begin) for text in texts)


def otherwise(manifest: Manifest, vector: str, change: Callable[[Any], Any]) -> Manifest:
    """The manifest with other ports in a vector of its law."""
    law = manifest.lists[manifest.laws[0]]
    ports = tuple(map(change, law.vectors[vector]))
    return replace(manifest, lists={manifest.laws[0]: replace(law, vectors={**law.vectors, vector: ports})})


def another_law(claim: dict[str, Any]) -> None:
    claim["sha256_law"] = "0" * 64  # so that the law is not evaluated


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("turning", "thrust: 1.0 N in the vehicle file, 40.0 N certified"),
        ("turning", "conditions: curvature_per_m = 0.0"),
        ("steering", "conditions: u = [0.99, 1.21]"),
        ("braking", "thrust: 1.0 N in the vehicle file, 4.25 N certified"),
        ("braking", "speed across the direction of the obstacle: up to 0.05 m/s certified, up to 0.22 m/s"),
    ],
)
def test_what_a_certificate_does_not_cover_is_named(kind: str, text: str) -> None:
    if kind == "turning":
        document, manifest = turning_document(another_law), own_manifest()
    elif kind == "steering":
        claim, manifest = copy.deepcopy(steered()[0]), steered()[1]
        claim["about"]["sha256_law"] = "0" * 64  # so that the law is not evaluated
        document = seal("lyapunov", claim, {})
    else:
        document = braking("braking-simple-20", another_law)
        document["claim"]["encounter"]["sideways_m_per_s"] = 0.05
        manifest = manifest_for(spin=0.0)
    found = compare(document, replace(manifest, ranges={"Fu_max": (1.0, 50.0), "Fv_max": (2.0, 50.0)}))
    assert says(found.excludes, text), found.excludes


def test_the_rounding_of_single_precision_is_not_covered() -> None:
    found = compare(turning_document(another_law), replace(own_manifest(), real="float32"))
    assert says(found.excludes, "rounding: the proof holds for exact real numbers; the bundle rounds constants, gains")


def test_the_law_of_a_turning_certificate_has_the_stated_units() -> None:
    other = otherwise(own_manifest(), "inputs", lambda p: replace(p, unit="km, rad") if p.name == "eta" else p)
    assert compare(turning_document(), other).differs == ("law: eta of the law is in km, rad, not in m, rad",)


def test_the_law_of_a_steering_certificate_is_evaluated() -> None:
    claim, manifest = steered()
    swapped = {"k_psi": "k_r", "k_r": "k_psi"}
    other = otherwise(manifest, "gains", lambda p: replace(p, name=swapped.get(p.name, p.name)))
    assert says(compare(seal("lyapunov", claim, {}), other).differs, "law: moment at ")


def test_a_steering_certificate_is_about_a_law_without_integral_action() -> None:
    claim, manifest = steered()
    other = replace(manifest, gains={**manifest.gains, "k_i": (0.1,)})
    assert says(compare(seal("lyapunov", claim, {}), other).differs, "k_i: 0.0 certified, 0.1 exported")


def test_a_steering_certificate_covers_the_moment_of_the_law_and_the_fastest_drift() -> None:
    claim, manifest = copy.deepcopy(steered()[0]), steered()[1]
    claim["about"]["sha256_law"] = "0" * 64  # so that the law is not evaluated
    limits = (*manifest.gains["thrust_limit"][:3], 1e9)
    other = replace(manifest, gains={**manifest.gains, "thrust_limit": limits})
    text = "thrust_limit of yaw: at least 1000000000.0 N m certified"
    assert says(compare(seal("lyapunov", claim, {}), other).differs, text)
    rows = {row["name"]: row for row in (*claim["states"], *claim["parameters"])}
    rows["sway"]["lower"], rows["share"]["lower"] = -1e-9, 0.9999
    assert says(compare(seal("lyapunov", claim, {}), manifest).differs, "share: 0.9999 to 1.0 certified")


def test_drag_along_the_motion_is_equal_in_surge_and_sway() -> None:
    manifest = manifest_for(lambda table: table["vehicle"]["values"].update(Yvv=64.0), spin=0.0)
    found = compare(braking("braking-simple-20"), replace(manifest, wrong=()))
    assert says(found.differs, "quadratic drag: surge and sway may differ by a share of 0.0")


def test_the_bundle_contains_the_certified_law_and_the_exported_one_computes_the_same() -> None:
    manifest = own_manifest()
    text = "law: the bundle does not contain the instruction list of the certified law"
    assert compare(turning_document(), replace(manifest, lists={})).differs == (text,)
    good, other = manifest.laws[0], otherwise(manifest, "inputs", lambda p: replace(p, unit=f"k{p.unit}"))
    both = {good: manifest.lists[good], "0" * 64: other.lists[good]}
    found = compare(turning_document(), replace(manifest, laws=("0" * 64, good), lists=both))
    assert says(found.differs, "law: eta of the law is in km, rad")


# inequalities


def inequality(change: Callable[[dict[str, Any]], None] = lambda _: None, **values: float) -> Belonging:
    """A claim about the vehicle's mass, with the digest that a bundle states of it."""
    claim: dict[str, Any] = {
        "name": "braking-keeps", "statement": "", "unit": "1", "left": "0", "right": "m", "constraints": [],
        "slack": 0.0, "variables": [{"name": "m", "unit": "kg", "lower": 90.0, "upper": 100.0}],
    }  # fmt: skip
    change(claim)
    manifest = manifest_for()
    stated = {claim["name"]: stated_sha256(claim)}
    return compare(
        {"kind": "interval", "claim": claim}, replace(manifest, claims=stated, values={**manifest.values, **values})
    )


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({}, ""),
        ({"m11": 89.0}, "m: 90.0 to 100.0 certified, the vehicle's m11 is 89.0"),
        ({"m22": 101.0}, "m: 90.0 to 100.0 certified, the vehicle's m22 is 101.0"),
        ({"m24": 1.0}, "vehicle: it has m24, which the certificate does not cover"),
    ],
)
def test_a_braking_inequality_is_about_the_vehicle_of_the_bundle(values: dict[str, float], text: str) -> None:
    assert inequality(**values).differs == ((text,) if text else ())


def test_an_inequality_without_its_bounds_does_not_belong() -> None:
    def unbounded(claim: dict[str, Any]) -> None:
        claim.update(name="other", variables=[{"name": "m", "unit": "kg"}], slack=1e-15)

    assert says(inequality(unbounded).differs, "bundle: its entries and those of the certificate do not fit together")


# dynamics


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda c: c["about"].update(controller="0" * 64), "controller: the certificate is about another controller"),
        (lambda c: c.update(time="discrete"), "time: the loop of a bundle is compared in continuous time, or sampled"),
    ],
)
def test_the_loop_of_another_controller_or_time_does_not_belong(
    change: Callable[[dict[str, Any]], None], text: str
) -> None:
    claim = about(loop())
    change(claim)
    assert compare({"kind": "lyapunov", "claim": claim}, bundled(loop())).differs == (text,)


def test_what_a_certificate_proves_about_the_loop_needs_no_comparison() -> None:
    proved = {"function": "place^2", "level": 1.0, "rate": None, "equilibrium": {"place": 0.0}, "inner": 0.0,
              "gains": {}, "initial": [], "unsafe": [], "multiplier": "1", "stays": True}  # fmt: skip
    found = compare({"kind": "lyapunov", "claim": {**about(loop()), **proved}}, bundled(loop()))
    assert found.belongs, found
    assert says(found.excludes, "sampling: the certificate is about the control law in continuous time")

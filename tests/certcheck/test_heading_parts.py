"""The parts of the checker of the heading-steered loop: each condition fails alone, and each bound has 40 digits."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpmath import mp, mpf

from surctl.certcheck import check_document
from surctl.certcheck.document import Rejected
from surctl.certcheck.heading import _check_extent, _check_heave, _heave_bounds
from surctl.certcheck.heading_cells import check_cells
from surctl.certcheck.heading_claim import HeadingClaim, read_claim
from surctl.certcheck.region_exact import Matrix
from tests.certcheck.altering import put, sealed

FILE = Path(__file__).with_name("region-heading-20.json")
STORED: dict[str, Any] = json.loads(FILE.read_text())
ONE = Fraction(1)


def simple(**changes: Any) -> HeadingClaim:
    """A claim with law parameters 1, so that the surge commands at rest are the ends of `surge_linear`."""
    claim = read_claim(STORED["claim"])
    law = dict.fromkeys(claim.law, ONE) | {"quadratic_drag": Fraction(0)}
    ranges = dict.fromkeys(claim.ranges, (ONE, ONE)) | {"surge_quadratic": (Fraction(0), Fraction(0))}
    small = Fraction(1, 10)
    limits = dict.fromkeys(claim.limits, Fraction(100))
    plain = replace(claim, law=law, offset=small, beside=small, extent=(small,) * 3, depth=small, rate=small,
                    ultimate_bound=Fraction(1, 2), limits=limits)  # fmt: skip
    ranges = ranges | changes.pop("ranges", {})
    return replace(plain, ranges=ranges, **changes)


def eye(size: int, **entries: int | Fraction) -> Matrix:
    return [[Fraction(entries.get(f"d{i}", 1)) if i == j else Fraction(0) for j in range(size)] for i in range(size)]


def ends(low: str, high: str) -> dict[str, Any]:
    return {"ranges": {"surge_linear": (Fraction(low), Fraction(high))}}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({}, ""),
        (ends("0", "1") | {"ultimate_bound": Fraction(2)}, "would have to move backwards"),
        (ends("0.499", "1"), "0.501 m from its target"),
        (ends("1", "1.501"), "0.501 m from its target"),
        (ends("0.5", "1.5"), ""),
        (ends("0.5", "1") | {"offset": Fraction(9, 10)}, "a cross-track offset of 0.9 m"),
        (ends("1", "1.5") | {"offset": Fraction(9, 10)}, "a cross-track offset of 0.9 m"),
        ({"offset": ONE}, ""),
        ({"beside": Fraction(1001, 1000)}, "a point 1.001 m beside"),
        *(({"extent": tuple(Fraction(1001, 1000) if k == at else ONE for k in range(3))}, f"{name} = 1.001")
          for at, name in enumerate(("x_e", "y_e", "psi"))),
        ({"extent": (ONE, ONE, ONE)}, ""),
        ({"depth": Fraction(1001, 1000)}, "a depth error of 1.001 m"),
    ],
)  # fmt: skip
def test_each_extent_of_a_region_is_compared(changes: dict[str, Any], says: str) -> None:
    if not says:
        _check_extent(simple(**changes), eye(6), eye(2))
        return
    with pytest.raises(Rejected, match=says):
        _check_extent(simple(**changes), eye(6), eye(2))


def test_bounds_of_heave_are_rounded_outward() -> None:
    claim = simple(ranges={"heave_linear": (ONE, 2 * ONE), "heave_quadratic": (ONE, 3 * ONE)},
                   limits={**simple().limits, "heave_n": Fraction(1, 3)})  # fmt: skip
    with mp.workdps(60):
        for numerator in (2, 3, 5, 7):
            covariance = [[Fraction(numerator + 1), Fraction(1, 7)], [Fraction(1, 7), Fraction(numerator)]]
            (low, high), share = _heave_bounds(claim, covariance)
            largest, along = 2 + 3 * mp.sqrt(numerator), mp.sqrt(mpf(2) / 7 + 2 * numerator + 1)
            assert low == 1
            assert 0 <= mpf(high.numerator) / high.denominator - largest < 3 * 2e-9  # three roots
            assert 0 <= 1 / (3 * along) - mpf(share.numerator) / share.denominator < 1e-9
    assert _heave_bounds(simple(), covariance)[1] == 1


def heave(mass: tuple[Any, Any], drag: tuple[Any, Any], limit: Any, rate: str) -> None:
    """Check V_z = z² + w² + z w, about m ẇ = −φ (w + z) − σ w."""
    claim = simple(ranges={"heave_mass_kg": tuple(map(Fraction, mass)), "heave_linear": tuple(map(Fraction, drag)),
                           "heave_quadratic": (Fraction(0), Fraction(0))}, rate=Fraction(rate))  # fmt: skip
    shape = [[ONE, ONE / 2], [ONE / 2, ONE]]
    _check_heave(replace(claim, limits={**claim.limits, "heave_n": Fraction(limit)}), shape)


def decay(mass: float, drag: float, share: float) -> float:
    """The rate at which V_z decays for one vehicle [1/s]."""
    a, p = np.array([[0.0, 1.0], [-share / mass, -(share + drag) / mass]]), np.array([[1.0, 0.5], [0.5, 1.0]])
    return float(-np.linalg.eigvals(np.linalg.solve(p, p @ a + a.T @ p)).real.max())


@pytest.mark.parametrize(("mass", "drag", "limit"), [
    ((1, "1.2"), (0, "0.2"), 100), ((1, 4), (0, "0.1"), 100), ((1, "1.1"), (0, 6), 100),
    ((1, "1.1"), (0, "0.1"), "0.5"), (("0.2", 1), ("0.5", "0.6"), 100), (("0.25", 1), (0, 3), "0.5"),
])  # fmt: skip
def test_the_decay_of_heave_is_that_of_the_slowest_vehicle(mass: Any, drag: Any, limit: Any) -> None:
    share = min(1.0, float(Fraction(limit)) / np.sqrt(4 / 3))
    slowest = min(
        decay(float(m), float(d), s) for m in map(Fraction, mass) for d in map(Fraction, drag) for s in (share, 1)
    )
    if slowest > 0:
        heave(mass, drag, limit, repr(slowest * (1 - 1e-6)))
    with pytest.raises(Rejected, match="V_z does not decay"):
        heave(mass, drag, limit, repr(max(slowest * (1 + 1e-6), 1e-6)))


# the whole certificate, and its claim


def changed(path: tuple[Any, ...], value: Any) -> dict[str, Any]:
    return sealed(put(copy.deepcopy(STORED), path, value))


MIRRORED = [(i, j) for i in range(6) for j in range(i) if (i in (0, 3)) != (j in (0, 3))]


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        (("more",), 1, "the certificate"),
        (("proof", "P", 5, 5), -1.0, "P is not positive definite"),
        (("proof", "P_z", 1, 1), -1.0, "P_z is not positive definite"),
        *((("proof", "P", i, j), 1e-6, "not symmetric under reflection") for i, j in MIRRORED),
        (("claim", "motion", "offset_m"), 9.0, "a cross-track offset of 9 m"),
        (("claim", "vehicle", "heave_linear"), [0.0, 1e9], "V_z does not decay"),
    ],
)
def test_each_condition_of_a_certificate_is_checked(path: tuple[Any, ...], value: Any, says: str) -> None:
    assert says in check_document(changed(path, value)).reason


CLAIM: dict[str, Any] = STORED["claim"]


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        (("system",), "cruise", "claim.system 'cruise' is not known"),
        (("excludes",), CLAIM["excludes"][1:], "claim.excludes differs"),
        *((("sha256_vehicle",), value, "is not a SHA-256") for value in (5, "0" * 63, "0" * 65, "G" * 64)),
        *((("vehicle", name), value, f"claim.vehicle.{name} must have two entries")
          for name in ("mass_kg", "yaw_quadratic") for value in ({"a": 1.0, "b": 2.0}, [1.0, 2.0, 3.0], [1.0])),
        *((("vehicle", name), [2.0, 1.0], f"claim.vehicle.{name}: the least") for name in ("mass_kg", "yaw_quadratic")),
        *((("motion", "extent"), value, "must be [x, y, psi]") for value in ({"a": 1, "b": 1, "c": 1}, [1.0], "abc")),
    ],
)  # fmt: skip
def test_each_entry_of_a_claim_has_its_form(path: tuple[str, ...], value: Any, says: str) -> None:
    with pytest.raises(Rejected) as reason:
        read_claim(put(copy.deepcopy(CLAIM), path, value))
    assert says in str(reason.value)


# the cells


def test_a_region_beyond_the_known_headings_or_without_spare_thrust_is_rejected() -> None:
    claim, lower = read_claim(CLAIM), STORED["proof"]["P"]
    matrix = np.array([[lower[max(i, j)][min(i, j)] for j in range(6)] for i in range(6)])
    with pytest.raises(Rejected, match=r"beyond a heading error of 1\.5 rad"):
        check_cells(claim, matrix * 1e-3)
    with pytest.raises(Rejected, match="the steady cruise needs all the thrust"):
        check_cells(replace(claim, limits={**claim.limits, "surge_n": claim.trim[1]}), matrix)

"""Each erratum is shown by its computation, and by nothing else: another formula gives another verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import pytest

from surctl.marine.reproduction import errata
from surctl.marine.reproduction.errata import errata_items
from surctl.marine.sensing import SonarArray
from surctl.marine.sensing.ranging.filters import lms_step
from surctl.marine.verification import tracking_claims

ITEMS = {item.id: item for item in errata_items()}

along_command, load_scenario, avoidance_course = (
    tracking_claims.along_command,
    errata.load_scenario,
    errata.avoidance_course,
)
printed_step, cross_track_rate, loop_terms = errata.printed_step, errata.cross_track_rate, errata.loop_terms
quadratic_form, first_line, clearance_rate = errata.quadratic_form, errata.first_line, errata.clearance_rate
largest_error, printed_gradient, pushed = errata.largest_error, errata.printed_gradient, errata.inertial_motion


def corrected_lms(*values: object, **named: object) -> object:
    return lms_step(*values, **{**named, "step": "corrected"})


def turned_terms(setting: object) -> tuple[float, float, float]:
    rate, speed, slant = loop_terms(setting)
    return -rate, speed, slant


# id: where the formula stands, its name, and another formula
MUTATIONS: dict[str, list[tuple[object, str, object]]] = {
    "E1": [(errata, "printed_obstacle_rate", lambda u, psi: (u * errata.cos(psi), u * errata.sin(psi)))],
    "E2": [(errata, "table_ii", lambda: sensing_table(3.5)), (errata, "table_ii", lambda: sensing_table(1.0))],
    "E3": [(errata, "largest_error", lambda test: 1.5 * largest_error(test))],
    "E4": [(errata, "SonarArray", partial(SonarArray, bits=10))],
    "E5": [
        (errata, "lms_step", corrected_lms),
        (errata, "printed_step", lambda x, residual: 0.5 * printed_step(x, residual)),
    ],
    "E6": [(errata, "printed_step", lambda x, residual: 0.5 * printed_step(x, residual))],
    "E7": [
        (errata, "cross_track_rate", lambda y, u, v, **k: cross_track_rate(y, u, v, **{**k, "course": True})),
        (errata, "cross_track_rate", lambda y, u, v, **k: cross_track_rate(y, u, v, **{**k, "course": False})),
    ],
    "E8": [(errata, "loop_terms", turned_terms)],
    "E8-diagonal": [
        (errata, "quadratic_form", lambda s, middle, third: quadratic_form(s, middle, s.k2)),
        (errata, "quadratic_form", lambda s, middle, third: quadratic_form(s, third, middle)),
    ],
    "E9": [(tracking_claims, "along_command", lambda *v, **k: along_command(*v, **{**k, "repaired": True}))],
    "E10": [(errata, "printed_side", lambda phi: 1), (errata, "encounter_side", lambda v, n: -1)],
    "E11": [(errata, "avoidance_course", lambda *v, **k: avoidance_course(*v, **{**k, "delta": 0}))],
    "E12": [(errata, "clearance_rate", lambda c, phi, **k: clearance_rate(c, phi, **{**k, "closing": 0}))],
    "E13": [(errata, "inertial_motion", lambda start, s, a: pushed(start - [1.0, 0, 0, 0], s, a))],
    "E14": [(errata, "printed_position_error", lambda x, y, z: (x * x + y * y + z * z) ** 0.5)],
    "E15": [(errata, "PRINTED_HULL", "sur400")],
    "E16": [(errata, "load_scenario", lambda name: replace(load_scenario(name), depth=-0.3))],
    "E17": [(errata, "printed_turn", errata.mended_turn), (errata, "mended_turn", errata.printed_turn)],
    "E18": [
        (errata, "first_line", lambda s, speed, factor: first_line(s, speed, factor=1.0)),
        (errata, "first_line", lambda s, speed, factor: first_line(s, speed, factor=0.4 / 0.41**0.5)),
    ],
    "E19": [(errata, "printed_gradient", lambda theta, x, x_n: -printed_gradient(theta, x, x_n))],
    "E20": [(errata, "largest_error", lambda test: 0.6 * largest_error(test))],
    "E21": [(errata, "followed_path", lambda x, y: x + 2 * y)],
}


def sensing_table(percent: float) -> object:
    """Table II with another percentage at 85 cm in water: 3.5 is right; 1.0 beside a wrong one makes two."""
    test = TABLE()
    printed = test.water.printed_percent.copy()
    printed[6] = percent
    if percent == 1.0:
        printed[7] = percent
    return replace(test, water=replace(test.water, printed_percent=printed))


TABLE: Callable[[], object] = errata.table_ii


def test_every_erratum_has_a_row_and_a_mutation() -> None:
    assert {f"E{k}" for k in range(1, 22)} <= set(ITEMS)
    assert set(MUTATIONS) == set(ITEMS)


@pytest.mark.parametrize("name", ITEMS)
def test_the_computation_shows_the_erratum(name: str) -> None:
    row = ITEMS[name].row()
    assert row.as_expected, row.result
    assert row.result.word != "agrees"


@pytest.mark.parametrize(
    ("name", "place", "formula", "other"),
    [(name, *one) for name, several in MUTATIONS.items() for one in several],
    ids=[f"{name}-{one[1]}-{k}" for name, several in MUTATIONS.items() for k, one in enumerate(several)],
)
def test_another_formula_is_noticed(
    name: str, place: object, formula: str, other: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(place, formula, other)
    assert not ITEMS[name].row().as_expected


def test_the_figures_are_those_of_the_formulas() -> None:
    numbers = {name: ITEMS[name].row().result.numbers for name in ("E2", "E4", "E7", "E12", "E15", "E16")}
    assert numbers["E2"]["percent"] == pytest.approx(100 * 3 / 85)
    assert numbers["E4"]["step_mm"] == pytest.approx(4500 / 255)
    assert numbers["E7"]["heading_m"] == pytest.approx(0.5 / 3, abs=1e-6)
    assert numbers["E12"]["settles_m"] == pytest.approx(-0.5 * (15 / 22) / (1 - (15 / 22) ** 2) ** 0.5, abs=1e-6)
    assert numbers["E15"] == pytest.approx({"inside_wall_m": 0.02, "off_obstacle_m": 0.0440055}, abs=1e-7)
    assert numbers["E16"]["above_m"] == pytest.approx(0.12)

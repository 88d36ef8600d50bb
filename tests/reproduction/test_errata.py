"""Each erratum is shown by its computation, and by nothing else: another formula gives another verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import pytest

from surctl.marine.reproduction import avoidance_errata as avoidance
from surctl.marine.reproduction import scenario_errata as scenario
from surctl.marine.reproduction import sensing_errata as sensing
from surctl.marine.reproduction import tracking_errata as tracking
from surctl.marine.reproduction.errata import errata_items
from surctl.marine.sensing import SonarArray
from surctl.marine.sensing.ranging.filters import lms_step
from surctl.marine.verification import tracking_claims

ITEMS = {item.id: item for item in errata_items()}

along_command, load_scenario, avoidance_course = (
    tracking_claims.along_command,
    scenario.load_scenario,
    avoidance.avoidance_course,
)
printed_step, cross_track_rate, loop_terms = sensing.printed_step, tracking.cross_track_rate, tracking.loop_terms
quadratic_form, first_line, clearance_rate = tracking.quadratic_form, tracking.first_line, avoidance.clearance_rate
largest_error, printed_gradient, pushed = sensing.largest_error, sensing.printed_gradient, avoidance.inertial_motion


def corrected_lms(*values: object, **named: object) -> object:
    return lms_step(*values, **{**named, "step": "corrected"})


def turned_terms(setting: object) -> tuple[float, float, float]:
    rate, speed, slant = loop_terms(setting)
    return -rate, speed, slant


# id: where the formula stands, its name, and another formula
MUTATIONS: dict[str, list[tuple[object, str, object]]] = {
    "E1": [(avoidance, "printed_obstacle_rate", lambda u, psi: (u * avoidance.cos(psi), u * avoidance.sin(psi)))],
    "E2": [(sensing, "table_ii", lambda: sensing_table(3.5)), (sensing, "table_ii", lambda: sensing_table(1.0))],
    "E3": [(sensing, "largest_error", lambda test: 1.5 * largest_error(test))],
    "E4": [(sensing, "SonarArray", partial(SonarArray, bits=10))],
    "E5": [
        (sensing, "lms_step", corrected_lms),
        (sensing, "printed_step", lambda x, residual: 0.5 * printed_step(x, residual)),
    ],
    "E6": [(sensing, "printed_step", lambda x, residual: 0.5 * printed_step(x, residual))],
    "E7": [
        (tracking, "cross_track_rate", lambda y, u, v, **k: cross_track_rate(y, u, v, **{**k, "course": True})),
        (tracking, "cross_track_rate", lambda y, u, v, **k: cross_track_rate(y, u, v, **{**k, "course": False})),
    ],
    "E8": [(tracking, "loop_terms", turned_terms)],
    "E8-diagonal": [
        (tracking, "quadratic_form", lambda s, middle, third: quadratic_form(s, middle, s.k2)),
        (tracking, "quadratic_form", lambda s, middle, third: quadratic_form(s, third, middle)),
    ],
    "E9": [(tracking_claims, "along_command", lambda *v, **k: along_command(*v, **{**k, "repaired": True}))],
    "E10": [(avoidance, "printed_side", lambda phi: 1), (avoidance, "encounter_side", lambda v, n: -1)],
    "E11": [(avoidance, "avoidance_course", lambda *v, **k: avoidance_course(*v, **{**k, "delta": 0}))],
    "E12": [(avoidance, "clearance_rate", lambda c, phi, **k: clearance_rate(c, phi, **{**k, "closing": 0}))],
    "E13": [(avoidance, "inertial_motion", lambda start, s, a: pushed(start - [1.0, 0, 0, 0], s, a))],
    "E14": [(tracking, "printed_position_error", lambda x, y, z: (x * x + y * y + z * z) ** 0.5)],
    "E15": [(scenario, "PRINTED_HULL", "sur400")],
    "E16": [(scenario, "load_scenario", lambda name: replace(load_scenario(name), depth=-0.3))],
    "E17": [(avoidance, "printed_turn", avoidance.mended_turn), (avoidance, "mended_turn", avoidance.printed_turn)],
    "E18": [
        (tracking, "first_line", lambda s, speed, factor: first_line(s, speed, factor=1.0)),
        (tracking, "first_line", lambda s, speed, factor: first_line(s, speed, factor=0.4 / 0.41**0.5)),
    ],
    "E19": [(sensing, "printed_gradient", lambda theta, x, x_n: -printed_gradient(theta, x, x_n))],
    "E20": [(sensing, "largest_error", lambda test: 0.6 * largest_error(test))],
    "E21": [(tracking, "followed_path", lambda x, y: x + 2 * y)],
}


def sensing_table(percent: float) -> object:
    """Table II with another percentage at 85 cm in water: 3.5 is right; 1.0 beside a wrong one makes two."""
    test = TABLE()
    printed = test.water.printed_percent.copy()
    printed[6] = percent
    if percent == 1.0:
        printed[7] = percent
    return replace(test, water=replace(test.water, printed_percent=printed))


TABLE: Callable[[], object] = sensing.table_ii


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

"""Compare the printed statement with the computed result for each of the errata E1–E21."""

from __future__ import annotations

from collections.abc import Callable

from surctl.marine.reproduction import avoidance_errata as avoidance
from surctl.marine.reproduction import scenario_errata as scenario
from surctl.marine.reproduction import sensing_errata as sensing
from surctl.marine.reproduction import tracking_errata as tracking
from surctl.marine.reproduction.row import Item, Result, Word

__all__ = ["errata_items"]

_WRONG: Word = "wrong in print"
_UNREADABLE: Word = "unreadable in our copy"

# id, what, as printed, expected verdict, computation
_ERRATA: tuple[tuple[str, str, str, Word, Callable[[], Result]], ...] = (
    ("E1", "positive direction of angles", "(17): ẏ_OB = −u_OB sin ψ_OB", _WRONG, avoidance.e1),
    ("E2", "a percentage of Table II", "Table II: 3.6 % at 85 cm in water", _WRONG, sensing.e2),
    ("E3", "largest absolute error of Table II", "II-C: less than 4.5 cm", "differs", sensing.e3),
    ("E4", "resolution of the converter", "Table I: about 5 mm; II-B: 8-bit", _WRONG, sensing.e4),
    ("E5", "step size of Algorithm 1", "S5: μ = gᵀg/(gᵀRg), S4: θ + 2μℜX", _WRONG, sensing.e5),
    ("E6", "the t in the step size of (6)", "(6): 2μtℜX", _UNREADABLE, sensing.e6),
    ("E7", "heading or course in (9)", "(9): ẏ_e = U_h sin(ψ − γ_d) − x_e γ̇_d", _WRONG, tracking.e7),
    ("E8", "last inequality of (12)", "(12): −eᵀMe ≤ ‖e‖²‖M‖ ≤ 0", _WRONG, tracking.e8),
    ("E8-diagonal", "M's third diagonal entry", "(12): U_h/√(y_e² + Δ_h²) twice", _UNREADABLE, tracking.e8_diagonal),
    ("E9", "the region with V̇1 ≤ 0", "(12): V̇1 ≤ 0 everywhere", _WRONG, tracking.e9),
    ("E10", "rule for the side λ2", "III-C: λ2 depends on the range of φ", _WRONG, avoidance.e10),
    ("E11", "the safety distance δ", "(24): V̇2 ≤ 0 for δ", _WRONG, avoidance.e11),
    ("E12", "the obstacle's own velocity in V̇2", "(24): omitted", _WRONG, avoidance.e12),
    ("E13", "whether V2 → 0 implies safety", "III-D: avoids obstacles effectively", _WRONG, avoidance.e13),
    ("E14", "the square root in E_p", "VI-B: E_p = √Δ… + …", _UNREADABLE, tracking.e14),
    ("E15", "clearance of the 0.54 m hull in the pool", "V-B: all obstacles passed", _WRONG, scenario.e15),
    ("E16", "depth of the hull", "IV-B: z = −0.15 m", "differs", scenario.e16),
    ("E17", "dimension of σ_0", "(19): √((a/R_OB)·t)", _UNREADABLE, avoidance.e17),
    ("E18", "the two lines of (12)", "(12): both lines are equal", _WRONG, tracking.e18),
    ("E19", "gradient of Algorithm 1", "S3: ∇ = +2ℜX; S1: x_n in X_n", _WRONG, sensing.e19),
    ("E20", "total ranging error", "II-B: less than 0.02 m", _WRONG, sensing.e20),
    ("E21", "definition of T in (10)", "(10): T = x + y", _WRONG, tracking.e21),
)


def errata_items() -> list[Item]:
    """Return the comparisons for all errata; E8 has two, for the sign of ‖e‖²‖M‖ and for the diagonal of M."""
    return [
        Item(name, "errata", what, paper, expected, compute, f"surctl reproduce {name}")
        for name, what, paper, expected, compute in _ERRATA
    ]

"""Study 1: the paper's two stability claims, as printed and as corrected, and the figures that decide them.

    python analysis/01_two_claims/run.py [--quick]

Prints Markdown. The exit status is 0 if every verdict is the expected one and every figure agrees, and 1 otherwise.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path

from surctl.errors import InputError
from surctl.files import Strict, load_model
from surctl.marine.reproduction import reproduce
from surctl.marine.verification import claims, settling_intrusion
from surctl.verification import Claim, Verdict, decide, evaluate, falsify, replay, setting_from
from surctl.verification.setting import Setting

CONFIG = Path(__file__).with_name("config.toml")
QUICK = [
    *("v1-printed", "v1-corrected", "v1-speed-cap", "course-printed", "clearance-printed", "clearance-corrected"),
    *("v2-printed", "v2-obstacle", "v2-clockwise"),
]
"""The claims that `--quick` decides: those of the figures and two corrected ones."""


class Config(Strict):
    """The contents of config.toml."""

    seed: int
    samples: int
    fraction_samples: int
    tolerance: float
    gains: dict[str, float]
    figures: dict[str, float]


def main(arguments: list[str]) -> int:
    """Run the study, print the results, and return the exit status."""
    unknown = [a for a in arguments if a != "--quick"]
    if unknown:
        print(f"{unknown[0]}: unknown option; the only one is --quick", file=sys.stderr)
        return 2
    try:
        return study(load_model(CONFIG, Config), quick="--quick" in arguments)
    except InputError as error:
        print(error, file=sys.stderr)
        return error.exit_status


def study(config: Config, *, quick: bool) -> int:
    """Print verdicts and figures; return 0 if all are as expected."""
    samples, starts, names = (config.samples // 8, 4, QUICK) if quick else (config.samples, 16, None)
    verdicts = [
        decide(claim, samples=samples, starts=starts, seed=config.seed) for claim in claims(config.gains, names)
    ]
    replays_hold = print_verdicts(verdicts)
    by_name = {v.claim.name: v for v in verdicts}
    found = tracking_figures(by_name, config) | avoidance_figures(by_name, config)
    figures_agree = print_figures(found, expected_figures(config), config.tolerance)
    return 0 if replays_hold and figures_agree and all(v.as_expected for v in verdicts) else 1


def expected_figures(config: Config) -> dict[str, float]:
    """Return the expected figures: those of config.toml, and −δ (E11), e2* (E12), lines of (12) (E18) from formulas."""
    setting, printed = setting_from(config.gains), Setting()
    x, y = 0.1, 0.4
    apart = (printed.speed - printed.k1 * x) / printed.lookahead * y * (math.hypot(y, printed.lookahead) - y)
    return {
        **config.figures,
        "intrusion_delta": -setting.delta,
        "intrusion_obstacle": settling_intrusion(setting),
        "lines_of_12": -apart,
    }


def print_verdicts(verdicts: list[Verdict]) -> bool:
    """Print one row per claim; return whether the replays confirm all counterexamples."""
    confirmed = True
    print("| claim | says | errata | expected | verdict | worst margin | share of samples | replay |")
    print("|---|---|---|---|---|---|---|---|")
    for v in verdicts:
        c, shown = v.claim, "–"
        if v.counterexample is not None:
            run = replay(c, v.counterexample)
            confirmed = confirmed and run.confirmed
            # `watched` is empty if the claim bounds no rate: then only the margin shows the violation
            path = (
                f"{run.name} {run.watched[0]:.4g} → {run.watched[-1]:.4g} {run.unit}"
                if run.watched.size
                else "algebraic"
            )
            shown = f"{path} in {run.time[-1]:.2g} s" if run.time.size else path
        row = (
            f"`{c.name}`",
            cell(c.statement),
            ", ".join(c.errata),
            c.expected,
            v.verdict,
            f"{v.worst_margin:.2g} {c.unit}",
            f"{100 * v.fraction:.1f} %",
            cell(shown),
        )
        print("| " + " | ".join(row) + " |")
    return confirmed


def tracking_figures(verdicts: dict[str, Verdict], config: Config) -> dict[str, tuple[str, float]]:
    """Return the figures of V1: description and value by key."""
    printed = verdicts["v1-printed"]
    # two starts suffice: only the share of the samples is used
    fine = falsify(printed.claim, samples=config.fraction_samples, starts=2, seed=config.seed)
    cap_x, cap_y = first_violation_under_cap(verdicts["v1-speed-cap"].claim, config.seed)
    return {
        "v1_rate": ("V̇1 at (0.6, 1, 0), surge signed [m²/s]", printed.witnesses[0].margin),
        "v1_fraction": ("share of [−2, 2]³ where V̇1 > 0", fine.fraction),
        "cap_x": ("first violation with 0 ≤ U_h ≤ 0.25: x_e [m]", cap_x),
        "cap_y": ("… at |y_e| [m]", cap_y),
        "sway_offset": (
            "|y_e| that sway 0.05 m/s at u = 0.15 m/s leaves [m]",
            sway_offset(verdicts["course-printed"].claim, config.seed),
        ),
        "lines_of_12": ("line 1 less line 2 of (12) at (0.1, 0.4, 0.2), default gains [m²/s]", lines_of_12()),
    }


def avoidance_figures(verdicts: dict[str, Verdict], config: Config) -> dict[str, tuple[str, float]]:
    """Return the figures of V2: description and value by key."""
    printed, obstacle, clockwise = (verdicts[n] for n in ("v2-printed", "v2-obstacle", "v2-clockwise"))
    at = clockwise.witnesses[0].values
    receding, approaching = obstacle.witnesses
    right = evaluate(printed.claim, at)[0] / at["e2"]
    static = {**printed.witnesses[0].values}
    least = -0.999 * config.gains["radius"]
    return {
        "v2_delta": ("V̇2 at e2 = −0.05, δ = 0.1, static [m²/s]", printed.witnesses[0].margin),
        "v2_receding": ("V̇2 at e2 = 0.3, receding at 0.15 m/s [m²/s]", receding.margin),
        "rate_right": ("l̇ at ζ = 1, angle counter-clockwise [m/s]", right),
        "rate_clockwise": (
            "l̇ there, angle clockwise as printed [m/s]",
            clockwise.witnesses[0].margin / at["e2"],
        ),
        "intrusion_delta": (
            "e2 where it settles, δ = 0.1, static [m]",
            settles(printed.claim, static, least),
        ),
        "intrusion_obstacle": (
            "e2* before 0.15 m/s head-on, δ = 0 [m]",
            settles(obstacle.claim, dict(approaching.values), least),
        ),
    }


def lines_of_12() -> float:
    """Return the first minus the second line of (12) (E18) [m²/s], both as printed."""
    found = reproduce(["E18"]).rows[0].result.numbers
    return found["line_1"] - found["line_2"]


def first_violation_under_cap(claim: Claim, seed: int) -> tuple[float, float]:
    """Return (x_e, |y_e|) [m] of the violation nearest to the target: shrink the box until it has no violation."""

    def box(x: float) -> Claim:
        return claim.on({"x_e": (-x, 0.0), "z_e": (0.0, 0.0), "turn": (0.0, 0.0)})

    reach = bisect(lambda x: refuted(box(x), seed), -claim.variables[0].lower, 0.0)
    nearest = falsify(box(reach), samples=512, starts=4, seed=seed).counterexample
    return (-reach, abs(nearest.values["y_e"])) if nearest is not None else (float("nan"), float("nan"))


def sway_offset(claim: Claim, seed: int) -> float:
    """Return the largest y_e [m] that still grows at surge 0.15 m/s and sway 0.05 m/s."""
    still = {"u": (0.15, 0.15), "v": (0.05, 0.05)}
    top = claim.variables[0].upper
    return bisect(lambda y: refuted(claim.on({**still, "y_e": (y, top)}), seed), 0.01, top)


def settles(claim: Claim, values: dict[str, float], least: float) -> float:
    """Return the e2 < 0 [m] at which l̇ = V̇2/e2 changes its sign, with all other values fixed."""
    return bisect(lambda e2: evaluate(claim, {**values, "e2": e2})[0] / e2 < 0, -1e-3, least)


def refuted(claim: Claim, seed: int) -> bool:
    """Return whether a small search refutes the claim."""
    return falsify(claim, samples=512, starts=4, seed=seed).verdict == "refuted"


def bisect(holds: Callable[[float], bool], yes: float, no: float, *, width: float = 1e-4) -> float:
    """Return the last value from `yes` towards `no` where `holds`; NaN unless it holds at `yes` and fails at `no`."""
    if not holds(yes) or holds(no):
        return float("nan")
    while abs(yes - no) > width:
        middle = (yes + no) / 2
        yes, no = (middle, no) if holds(middle) else (yes, middle)
    return yes


def print_figures(found: dict[str, tuple[str, float]], expected: dict[str, float], tolerance: float) -> bool:
    """Print one row per figure; return whether all agree."""
    agree = set(found) == set(expected)
    print("\n| figure | expected | computed | off by | |\n|---|---|---|---|---|")
    for key, (what, value) in found.items():
        wanted = expected.get(key, float("nan"))
        off = abs(value - wanted) / abs(wanted)
        good = off <= tolerance  # false for NaN
        agree = agree and good
        word = "agrees" if good else "**differs**"
        print(f"| {cell(what)} | {wanted:.4g} | {value:.5g} | {100 * off:.2f} % | {word} |")
    return agree


def cell(text: str) -> str:
    """Escape the bars of a text for a cell of a Markdown table."""
    return text.replace("|", "\\|")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""The reproduction of the paper: select and compute comparisons, and check that no required one is missing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from surctl.errors import InputError, nearest
from surctl.marine.reproduction.claims import FULL, claim_items
from surctl.marine.reproduction.errata import errata_items
from surctl.marine.reproduction.instants import instant_items
from surctl.marine.reproduction.row import Item, Row
from surctl.marine.reproduction.scenarios import hull_items, limit_items, position_items, scenario_items
from surctl.marine.reproduction.simulations import Simulations, scenario_names
from surctl.marine.reproduction.tables import table_items
from surctl.marine.sensing.calibration.table2 import MEDIA, table_ii
from surctl.marine.verification import claims

__all__ = ["QUICK_SAMPLES", "QUICK_SEEDS", "SEEDS", "Reproduction", "items", "reproduce", "required"]

SEEDS, QUICK_SEEDS = 20, 3
QUICK_SAMPLES = 512


@dataclass(frozen=True, eq=False)
class Reproduction:
    """Computed comparisons of the paper with the results of this project.

    Attributes:
        rows: the computed comparisons, in order.
        missing: ids of required comparisons that nothing computes; empty if only a selection is computed.
        seeds: number of seeds (runs) of each scenario.
        simulations: the simulations of the scenarios, from which the comparisons are computed.
    """

    rows: tuple[Row, ...]
    missing: tuple[str, ...]
    seeds: int
    simulations: Simulations

    @property
    def passed(self) -> bool:
        """Whether no comparison is missing and every comparison has the expected result."""
        return not self.missing and all(row.as_expected for row in self.rows)

    def to_dict(self) -> dict[str, Any]:
        """Return the reproduction as plain data for JSON; the writer must handle numbers that are not finite."""
        return {
            "passed": self.passed,
            "seeds": self.seeds,
            "missing": list(self.missing),
            "seconds": round(sum(row.seconds for row in self.rows), 3),
            "rows": [row.to_dict() for row in self.rows],
        }


def items(simulations: Simulations, *, samples: int = FULL) -> list[Item]:
    """Return all comparisons, not yet computed: claims, tables, errata, scenarios, position errors.

    Example:
        >>> from surctl.marine.reproduction import Simulations, items
        >>> [item] = [item for item in items(Simulations(3)) if item.id == "E12"]
        >>> print(item.what, "|", item.paper, "|", item.expected)
        the obstacle's own velocity in V̇2 | (24): omitted | wrong in print
    """
    return [
        *claim_items(simulations.gains.values, samples=samples),
        *table_items(),
        *errata_items(),
        *scenario_items(simulations),
        *hull_items(simulations),
        *limit_items(simulations),
        *instant_items(simulations),
        *position_items(simulations),
    ]


def required() -> list[str]:
    """Return the ids of all required comparisons: claims, percentages, errata, scenarios and position errors.

    Example:
        >>> from surctl.marine.reproduction import required
        >>> ids = required()
        >>> ids[0], ids[-1], [name for name in ids if name.startswith("tank-s")][:2]
        ('v1-printed', 'position-error-pool', ['tank-slalom', 'tank-speed-010'])
    """
    percentages = [f"table-ii-{medium}-{round(100 * d):03d}" for medium in MEDIA for d in table_ii().desired]
    return [
        *(claim.name for claim in claims() if claim.paper),
        *percentages,
        *(f"E{k}" for k in range(1, 22)),
        *scenario_names(),
        "position-error-tank",
        "position-error-pool",
    ]


def reproduce(
    names: Sequence[str] = (),
    *,
    quick: bool = False,
    seeds: int | None = None,
    independent: bool = False,
    webots: bool = False,
    progress: Callable[[str], None] = lambda _: None,
    done: Callable[[Row], None] = lambda _: None,
) -> Reproduction:
    """Compute the comparisons with the given ids, or all comparisons.

    Args:
        names: ids of the comparisons; an empty sequence selects all comparisons.
        quick: whether to use fewer seeds and samples.
        seeds: number of seeds of the compiled loop for each scenario; default: 20, or 3 if `quick` is true.
        independent: whether each scenario is simulated in MuJoCo, too (seed 0, six degrees of freedom).
        webots: whether each scenario with sonars is simulated with echoes as in the paper's simulator, too.
        progress: function that is called with the id of each comparison before its computation.
        done: function that is called with each comparison as soon as it is computed.

    Raises:
        InputError: an id is unknown (the error suggests the nearest known id), the number of seeds is less than 1, or
            `independent` or `webots` has no effect on any of the comparisons.
        ToolMissing: MuJoCo is requested, but it is not installed.

    Example:
        >>> from surctl.marine.reproduction import reproduce
        >>> [row] = reproduce(["E3"]).rows
        >>> print(row.item.paper, "|", row.result.ours, "|", row.result.word)
        II-C: less than 4.5 cm | largest error 3.0 cm | differs
    """
    count = seeds if seeds is not None else QUICK_SEEDS if quick else SEEDS
    simulations = Simulations(count, independent=independent, webots=webots)
    known = {item.id: item for item in items(simulations, samples=QUICK_SAMPLES if quick else FULL)}
    for name in names:
        if name not in known:
            raise InputError("no such row", key="row", value=name, remedy=nearest(name, known))
    for option, chosen, rows_with in (
        ("independent", independent, "a scenario, such as tank-static"),
        ("webots", webots, "a scenario with sonars, such as tank-static-sonar"),
    ):
        if chosen and names and not any(option in known[name].options for name in names):
            raise InputError(
                f"has no effect on {', '.join(names)}",
                key=f"--{option}",
                remedy=f"drop this option, or name the row of {rows_with}",
            )
    if independent:
        from surctl.marine.engine.library import mujoco_library

        mujoco_library()
    rows = []
    for name in names or known:
        progress(name)
        rows.append(known[name].row())
        done(rows[-1])
    missing = () if names else tuple(name for name in required() if name not in known)
    return Reproduction(tuple(rows), missing, simulations.seeds, simulations)

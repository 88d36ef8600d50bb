"""The linear analysis in the HTML report: disk margins, poles, and stability of the sampled loop.

The disk margins hold for simultaneous perturbations of all loops. For the sampled loop, the report gives the largest
control period and the largest delay up to which the loop is stable.
"""

from __future__ import annotations

from collections.abc import Sequence

from surctl.marine.verification.linear import LinearSide
from surctl.report.document import Block, Cell, Paragraph, Table, outcome_cell
from surctl.report.numbers import number

__all__ = ["linear_blocks"]


def linear_blocks(sides: Sequence[LinearSide]) -> list[Block]:
    """Return a table of disk margins and a table of poles and sampling; empty if there is no analysis."""
    if not sides:
        return []
    text = (
        "All loops at once: the gains and phases of all loops may vary together, in any combination, within the disk "
        "margin. The guaranteed margin holds at every frequency. The upper bound is the size of a perturbation that "
        "destabilises the loop. The sampled loop is computed without approximation: thrust is constant over each "
        "control period, and delays are whole periods."
    )
    return [Paragraph(text), _disks(sides), _sampled(sides)]


def _disks(sides: Sequence[LinearSide]) -> Table:
    rows: tuple[tuple[Cell | str, ...], ...] = tuple(
        (
            side.of,
            Cell(disk.place, code=True),
            outcome_cell(disk.stable, "stable", "UNSTABLE"),
            *(Cell(number(v, digits=3), number=True) for v in (disk.guaranteed, disk.reached, disk.frequency_rad_s)),
            Cell(f"{number(disk.gain[0], digits=3)} to {number(disk.gain[1], digits=3)}", number=True),
            Cell(number(disk.phase_deg, digits=3), number=True),
        )
        for side in sides
        for disk in side.disks
    )
    heads = (
        "vehicle", "opened at", "closed loop", "guaranteed [1]", "upper bound [1]", "at [rad/s]",
        "tolerated gain factors [1]", "tolerated phase errors [deg]",
    )  # fmt: skip
    return Table("Disk margins of all loops at once", heads, rows)


def _sampled(sides: Sequence[LinearSide]) -> Table:
    rows: tuple[tuple[Cell | str, ...], ...] = tuple(
        (
            side.of,
            outcome_cell(side.stable, "stable", "UNSTABLE"),
            *(Cell(number(v, digits=3), number=True) for v in (side.slowest_per_s, side.least_damping)),
            *(Cell(number(v, digits=3), number=True) for v in side.sampled.largest_period_s),
            Cell(str(side.sampled.delay_periods), number=True),
        )
        for side in sides
    )
    periods = tuple(f"largest period [s], {d}" for d in ("no delay", "1 period of delay", "2 periods of delay"))
    heads = (
        "vehicle", "closed loop", "slowest pole [1/s]", "least damping [1]", *periods,
        f"tolerated periods of delay at {number(sides[0].sampled.period_s)} s",
    )  # fmt: skip
    return Table("Poles, and the sampled loop", heads, rows)

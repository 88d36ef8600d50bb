"""The linear side on the page: all loops at once, and the loop as it is sampled."""

from __future__ import annotations

from collections.abc import Sequence

from surctl.report.document import Block, Cell, Paragraph, Table, outcome_cell
from surctl.report.words import number
from surctl.verification.linear import LinearSide

__all__ = ["linear_blocks"]


def linear_blocks(sides: Sequence[LinearSide]) -> list[Block]:
    """A table of disk margins, and one of poles and sampling; none without sides."""
    if not sides:
        return []
    text = (
        "All loops at once: every gain and phase may be off together, in any combination, by as much as the disk "
        "margin says. The guaranteed one holds at every frequency; a perturbation of the reached size was found that "
        "destabilises. Sampled: thrust held over a control period, whole periods of delay, no approximation."
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
        "of", "opened at", "closed loop", "guaranteed [1]", "reached [1]", "at [rad/s]", "gains borne [1]",
        "phases borne [deg]",
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
        "of", "closed loop", "slowest pole [1/s]", "least damping [1]", *periods,
        f"periods of delay borne at {number(sides[0].sampled.period_s)} s",
    )  # fmt: skip
    return Table("Poles, and the sampled loop", heads, rows)

"""`surctl reproduce`: compare our results with the results in the paper, one by one; --independent, --webots."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from surctl.cli.options import Count, out_folder
from surctl.cli.output import as_json, finish, progress, result_command, saving, stoppable
from surctl.marine.cli import lib


@click.command
@click.argument("rows", nargs=-1)
@click.option("--quick", is_flag=True, help="Faster: 3 seeds for each scenario and fewer points per claim.")
@click.option("--seeds", type=Count(1), help="Number of runs (seeds) of each scenario (default 20).")
@click.option(
    "--independent", is_flag=True, help="Simulate each scenario in MuJoCo, too (one more column of the output)."
)
@click.option(
    "--webots", is_flag=True, help="Simulate sonars also with the echo model of the simulator Webots (one more column)."
)
@out_folder
@as_json
def reproduce(rows: tuple[str, ...], out: Path | None, as_json: bool, **how: Any) -> None:
    """Compute the results of the robot's paper again, and compare them with the results in the paper. Each result is a
    row of the output; name ROWS to compute only some results.

    Exit status: 1 if a row is missing, a verdict differs from the recorded verdict, or a simulated run collides or does
    not arrive. If a travel time differs from that in the paper, the row gives the reason. --out writes a page with the
    figures of the paper, drawn again.

    Examples: surctl reproduce --quick; surctl reproduce tank-static E5 v1-printed; surctl reproduce --out paper
    """
    if out is not None:
        lib.prepare_folder(out)
    lines = list[str]()
    above, message = "the rows above are finished", "for the other rows: surctl reproduce ROW"
    with stoppable(message, lines, above=above, as_json=as_json):
        done = lib.reproduce(rows, **how, progress=progress, done=lambda row: lines.extend(row_lines(row)))
    lines += [f"FAIL {name}: the row is missing" for name in done.missing]
    total = f"{done.counts}, {sum(row.seconds for row in done.rows):.1f} s"
    lines.append(total)
    result = done.to_dict()
    if out is not None:
        with saving("page"):
            page = lib.write_reproduction(done, out / "reproduction.html", command=result_command())
            lines.append(f"page {page}")
            result["page"] = str(page)
    brief = [total, *(line for line in lines if line.startswith("FAIL"))]
    files = [f"page {result['page']}"] if "page" in result else []
    finish(result, lines, as_json=as_json, passed=done.passed, brief=brief, files=files)


def row_lines(row: lib.Row) -> list[str]:
    """Return the lines of one comparison: the paper's result, our result, the verdict and the command."""
    item, mark = row.item, "ok  " if row.as_expected else "FAIL"
    return [
        f"{mark} {item.id:<26} {item.what}",
        f"       paper   {item.paper}",
        f"       ours    {row.result.ours}",
        *([f"       MuJoCo  {row.result.independent}"] if row.result.independent else []),
        *([f"       Webots  {row.result.webots}"] if row.result.webots else []),
        f"       verdict {row.result.verdict}   [{item.command}, {row.seconds:.2f} s]",
    ]

"""`surctl calibrate`: bias, scale and noise of range sensors from a CSV file of measured distances."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.output import as_json, finish, out_folder, saving

if TYPE_CHECKING:
    from surctl.marine.sensing import Estimate, SensorCalibration


@click.command
@click.argument("file")
@out_folder
@as_json
def calibrate(file: str, out: Path | None, as_json: bool) -> None:
    """Calibrate range sensors from a CSV file of true and measured distances, with 95 % confidence intervals.

    The CSV file has the columns true_m and measured_m (or both in _cm or _mm), and for several sensors or media the
    columns sensor and medium. Each sensor needs, in each medium, at least 6 rows at 3 or more distances. --out writes
    a plot of the residuals and a [sonar] table to paste into a scenario file. The name table-ii in place of FILE stands
    for the measured distances of Table II in the robot's paper.

    Examples: surctl calibrate table-ii; surctl calibrate range-test.csv --out lab
    """
    from surctl.files import prepare_folder, write_file
    from surctl.marine.sensing import OUTLIER_RULE
    from surctl.marine.sensing.calibration.file import (
        BUILT_IN,
        calibration_rows,
        file_stems,
        pick_calibration,
        sonar_fragment,
    )

    if out is not None:
        prepare_folder(out)
    results = pick_calibration(file)
    data: dict[str, Any] = {"results": [one.to_dict() for one in results], "outlier_rule": OUTLIER_RULE, "files": []}
    lines = [line for one in results for line in [*_lines(one), ""]]
    if file == BUILT_IN:
        data["percentages"], percentage_lines = _percentages()
        lines += [*percentage_lines, ""]
    if any(len(one.calibration.outliers) for one in results):
        lines += [OUTLIER_RULE, ""]
    if out is not None:
        stems = file_stems(results)
        rows = write_file(out / "calibration.csv", calibration_rows(results))
        fragments = [
            write_file(out / f"sonar{stem}.toml", sonar_fragment(one)) for one, stem in zip(results, stems, strict=True)
        ]
        pictures = list[Path]()
        with saving("plots"):
            from surctl.marine.report import plot_calibration
            from surctl.report.theme import save_figure

            for one, stem in zip(results, stems, strict=True):
                pictures.append(save_figure(plot_calibration(one), out, (f"calibration{stem}",)))
        lines += [f"sonar {path}" for path in fragments] + [f"rows  {rows}"] + [f"plot  {path}" for path in pictures]
        data["files"] = [str(path) for path in (*fragments, rows, *pictures)]
    where = [] if out is None else [f"files {out}"]
    finish(data, lines[:-1] if not lines[-1] else lines, as_json=as_json, passed=True, files=where)


def _lines(one: SensorCalibration) -> list[str]:
    f = one.calibration
    worst = f"{_mm(f.errors[f.largest])} mm at {f.true[f.largest]:.4g} m"
    lines = [
        f"{one.title}: {len(f.true)} rows from {f.true[0]:.4g} to {f.true[-1]:.4g} m",
        f"  measured = scale * true + bias + noise         95 % confidence interval{', weighted' * f.varies}",
        _row("scale", "1", f.scale, 1.0),
        _row("bias", "mm", f.bias, 1e3),
        _row("noise sd", "mm", f.noise_sd, 1e3),
        *(f"  {text}" for text in _noise(one)),
        "  errors measured - true, without calibration",
        _row("mean", "mm", f.mean_error, 1e3),
        _row("sd", "mm", f.error_sd, 1e3),
        f"    rms {_mm(f.rms)} mm, largest {worst}",
    ]
    for k in f.outliers[:10]:
        where = f"line {one.lines[k]}" if one.lines[k] else "row"
        lines.append(f"  outlier: {where}, {f.measured[k]:.4g} m at {f.true[k]:.4g} m ({f.studentised[k]:+.1f} sd)")
    if len(f.outliers) > 10:
        lines.append(f"  and {len(f.outliers) - 10} more outliers, see --json")
    return lines + [f"  note: {text}" for text in one.notes]


def _noise(one: SensorCalibration) -> list[str]:
    from surctl.marine.sensing.calibration.estimation import LEAST_ROWS_OF_SLOPE

    f = one.calibration
    if f.noise_slope is None or f.noise_slope_p is None:
        few = f"fewer than {LEAST_ROWS_OF_SLOPE} rows: not tested whether the noise depends on range"
        return [few if len(f.true) < LEAST_ROWS_OF_SLOPE else "the rows lie on a line: no noise"]
    slope = f"slope of the sd {_span(f.noise_slope)} mm/m (p = {f.noise_slope_p:.2g})"
    if f.noise_at_zero is None:
        return [f"{slope} does not differ from 0: one sd for all ranges"]
    return [
        f"{slope} differs from 0: the noise depends on range,",
        f"sd = {_span(f.noise_at_zero)} mm + slope * range, and at least {_mm(f.least_sd)} mm;",
        "noise sd above is its root mean square over the rows",
    ]


def _percentages() -> tuple[dict[str, Any], list[str]]:
    from surctl.marine.sensing.calibration.file import MEDIA, table_ii

    table = table_ii()
    wrong = []
    for medium in MEDIA:
        column = table.column(medium)
        wrong += [
            {
                "medium": medium,
                "true_m": float(table.desired[k]),
                "measured_m": float(column.measured[k]),
                "printed_percent": float(column.printed_percent[k]),
                "recomputed_percent": float(table.percent(medium)[k]),
            }
            for k in table.disagreeing(medium)
        ]
    count = 2 * len(table.desired)
    lines = [f"{count - len(wrong)} of the {count} printed percentages agree with their readings"]
    lines += [
        f"  {w['medium']}, {w['true_m']:g} m: reading {w['measured_m']:g} m, printed {w['printed_percent']:g} %, "
        f"recomputed {w['recomputed_percent']:.1f} %"
        for w in wrong
    ]
    return {"printed": count, "agree": count - len(wrong), "disagree": wrong}, lines


def _row(name: str, unit: str, e: Estimate, factor: float) -> str:
    digits = 5 if unit == "1" else 2
    value, low, high = (f"{factor * v:.{digits}f}" for v in e.to_list())
    return f"    {name:<9} {value:>10} {unit if unit != '1' else '':<3}  {low:>10} to {high}"


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.4g}"


def _span(e: Estimate) -> str:
    return f"{1e3 * e.value:.3g} ({1e3 * e.low:.3g} to {1e3 * e.high:.3g})"

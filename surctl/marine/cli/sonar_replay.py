"""`surctl sonar-replay`: run recorded readings through the sonar filter; range, bound and health at each step."""

from __future__ import annotations

from dataclasses import asdict
from math import isfinite
from pathlib import Path

import click

from surctl.cli.output import FOLDER, Count, FiniteRange, as_json, finish, saving
from surctl.errors import InputError

_METRES = FiniteRange(min=0.0, min_open=True)


@click.command("sonar-replay")
@click.argument("file")
@click.option("--sensors", type=Count(1, 16), default=4, help="Number of sonars on the robot (default 4).")
@click.option(
    "--minimum", type=_METRES, default=0.2, metavar="M", help="Shortest range that a sonar measures [m] (default 0.2)."
)
@click.option(
    "--maximum",
    type=_METRES,
    default=4.5,
    metavar="M",
    help="Longest range that a sonar measures, and its reading without an echo [m] (default 4.5).",
)
@click.option("--bits", type=Count(1, 24), default=8, help="Bits of the sonar's A/D converter (default 8).")
@click.option(
    "--bias",
    type=float,
    default=0.0,
    metavar="M",
    help="Reading minus scale times distance [m], from surctl calibrate (default 0).",
)
@click.option(
    "--scale",
    type=_METRES,
    default=1.0,
    metavar="X",
    help="Change of the reading per change of the distance, from surctl calibrate (default 1).",
)
@click.option(
    "--noise-sd",
    type=FiniteRange(min=0.0),
    default=0.015,
    metavar="M",
    help="Standard deviation of a reading [m], from surctl calibrate (default 0.015).",
)
@click.option(
    "--out",
    type=FOLDER,
    default=Path("surctl-out", "sonar-replay"),
    help="Folder for results (default surctl-out/sonar-replay).",
)
@as_json
def sonar_replay(
    file: str,
    sensors: int,
    minimum: float,
    maximum: float,
    bits: int,
    bias: float,
    scale: float,
    noise_sd: float,
    out: Path,
    as_json: bool,
) -> None:
    """Run recorded sonar readings through the filter of the controller. At each step, the sonar filter gives the range
    of each sonar, the bound of its error, and whether the range is reliable.

    The CSV file has the columns time_s, sensor (counted from 0), and range_m or, with several samples per reading,
    sample_1_m, sample_2_m and so on. Optional columns are closing_m_per_s (own speed along the beam) and turn_rad_per_s
    (yaw rate).

    Examples: surctl sonar-replay log.csv --out replay; surctl sonar-replay log.csv --maximum 6 --noise-sd 0.02
    """
    from surctl.files import prepare_folder, write_file
    from surctl.marine.sensing.replay import filtered_rows, read_readings, replay_readings, sonar_array

    if not isfinite(scale):
        raise InputError("must be finite", key="--scale", value=scale, remedy="give the scale from surctl calibrate")
    array = sonar_array(
        sensors, minimum=minimum, maximum=maximum, bits=bits, bias=bias / scale, noise_sd=noise_sd / scale
    )
    recording = read_readings(Path(file), array, scale=scale)
    prepare_folder(out)
    replayed = replay_readings(recording.readings)
    rows = write_file(out / "filtered.csv", filtered_rows(replayed))
    files = [rows]
    with saving("plot"):
        from surctl.marine.report import plot_sonar_replay
        from surctl.report.theme import save_figure

        files.append(save_figure(plot_sonar_replay(replayed, title=recording.name), out, ("sonar-replay",)))
    summaries = [replayed.summary(sensor) for sensor in replayed.sensors]
    span = recording.readings.time[-1] - recording.readings.time[0]
    lines = [
        f"{recording.name}: {recording.rows} rows over {span:.4g} s, each sensor reads every {recording.cycle:.3g} s",
        "sensor  readings  refused  healthy  gaps  longest gap  median bound",
    ]
    lines += [
        f"{s.sensor:>6}  {s.readings:>8}  {s.refused:>7}  {100 * s.healthy_share:>6.1f}%  {s.gaps:>4}  "
        f"{f'{s.longest_gap_s:.3g} s' if s.gaps else '-':>11}  {_bound(s.median_bound_m):>12}"
        for s in summaries
    ]
    lines += [f"note: {text}" for text in recording.notes]
    lines += ["", f"table {rows}", *(f"plot  {picture}" for picture in files[1:])]
    data = {
        "file": recording.name,
        "rows": recording.rows,
        "duration_s": float(span),
        "cycle_s": recording.cycle,
        "step_s": recording.readings.dt,
        "skipped_incomplete": recording.incomplete,
        "skipped_back_in_time": recording.back,
        "skipped_crowded": recording.crowded,
        "beyond_maximum": recording.beyond,
        "restarts": len(recording.readings.first) - 1,
        "sensors": [asdict(s) for s in summaries],
        "notes": recording.notes,
        "files": [str(path) for path in files],
    }
    poor = min(summaries, key=lambda one: one.healthy_share)
    brief = [lines[0], f"least healthy: sensor {poor.sensor}, {poor.healthy_share:.1%} of the steps"]
    brief += [f"note: {text}" for text in recording.notes]
    finish(data, lines, as_json=as_json, passed=True, brief=brief, files=[f"files {out}"])


def _bound(metres: float) -> str:
    return f"{metres:.3f} m" if metres == metres else "-"

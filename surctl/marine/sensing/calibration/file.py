"""Calibration from a CSV file or Table II: columns, units, skipped rows; output as CSV or as `[sonar]` table."""

from __future__ import annotations

import csv
import io
import os
import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.marine.sensing.calibration.estimation import Calibration, Estimate, calibrate
from surctl.recorded import Recorded, read_recorded, shown

Medium: TypeAlias = Literal["air", "water"]
MEDIA: tuple[Medium, ...] = ("air", "water")


@dataclass(frozen=True)
class MediumTest:
    """The readings of a range test in one medium: (n,) measured [m], and (n,) printed relative errors [%]."""

    measured: NDArray[np.float64]
    printed_percent: NDArray[np.float64]


@dataclass(frozen=True)
class RangeTest:
    """A range test in air and in water: true distances `desired` (n,) [m], readings, and origin of the numbers."""

    desired: NDArray[np.float64]
    air: MediumTest
    water: MediumTest
    provenance: str

    def errors(self, medium: Medium) -> NDArray[np.float64]:
        """Return measured minus desired distance (n,) [m]."""
        error: NDArray[np.float64] = self.column(medium).measured - self.desired
        return error

    def percent(self, medium: Medium) -> NDArray[np.float64]:
        """Return the relative errors |measured − desired| / desired (n,) [%], recomputed from the readings."""
        relative: NDArray[np.float64] = 100.0 * np.abs(self.errors(medium)) / self.desired
        return relative

    def disagreeing(self, medium: Medium) -> NDArray[np.intp]:
        """Return the indices of readings whose printed percentage differs from the recomputed value (erratum E2)."""
        gap = np.abs(self.percent(medium) - self.column(medium).printed_percent)
        return np.flatnonzero(gap > 0.05 + 1e-9)

    def column(self, medium: Medium) -> MediumTest:
        """Return the readings in one medium."""
        return self.air if medium == "air" else self.water


def table_ii() -> RangeTest:
    """Return Table II: readings at 18 distances from 0.25 to 1.95 m."""
    table = tomllib.loads(Path(__file__).with_name("table2.toml").read_text(encoding="utf-8"))
    air, water = (
        MediumTest(np.array(table[medium]["measured"]) / 100.0, np.array(table[medium]["error_percent"]))
        for medium in MEDIA
    )
    return RangeTest(np.array(table["desired"]["values"]) / 100.0, air, water, table["provenance"])


BUILT_IN = "table-ii"
"""Name of the built-in Table II on the command line of `surctl calibrate`."""
_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_PAIRS = [(f"true_{unit}", f"measured_{unit}") for unit in _UNITS]
_FAR = 20.0  # m; a longer range suggests a wrong unit
_MOST_SENSORS = 64


@dataclass(frozen=True, kw_only=True)
class SensorCalibration:
    """The calibration of one sensor in one medium.

    Attributes:
        sensor: name of the sensor in the file, "" if the file has no such column.
        medium: medium in the file, "" if the file has no such column.
        source: origin of the data, as one printable line.
        calibration: the calibration.
        lines: (n,) line number in the file for each reading of `calibration`; 0 for built-in data.
        skipped: number of file lines skipped because a number was missing, NaN or infinite.
        unsorted: number of file lines whose true distance was below the true distance of the previous line; the
            readings were then sorted.
    """

    sensor: str
    medium: str
    source: str
    calibration: Calibration
    lines: NDArray[np.int64]
    skipped: int
    unsorted: int

    @property
    def title(self) -> str:
        """Names of sensor and medium as text; "one sensor" if the file names neither a sensor nor a medium."""
        parts = [f"sensor {self.sensor}" if self.sensor else "", self.medium]
        return ", ".join(p for p in parts if p) or "one sensor"

    @property
    def notes(self) -> list[str]:
        """Notes for the user on skipped, sorted or otherwise noteworthy data, one sentence per note."""
        said = []
        if self.skipped:
            said.append(f"rows skipped because a number is missing, NaN or infinite: {self.skipped}")
        if self.unsorted:
            said.append(f"rows that were not in ascending order of true distance, and were sorted: {self.unsorted}")
        if self.calibration.rests_on_outliers:
            said.append("with the outliers, the noise would depend on range: check these rows")
        if self.calibration.too_many_outliers:
            said.append("many rows deviate from the line: the sensor may not be linear, or it fails often")
        if self.calibration.other_medium:
            ratio = self.calibration.scale.value
            here, there = ("water", "air") if ratio < 1 else ("air", "water")
            said.append(
                f"readings are {ratio:.3g} times the true distances, as if a converter with the speed of sound of "
                f"{there} were used in {here}; scale in [sonar] contains this ratio"
            )
        if self.calibration.true[-1] > _FAR:
            said.append(f"distances reach {self.calibration.true[-1]:.4g} m: check the unit of the columns")
        return said

    def to_dict(self) -> dict[str, Any]:
        """Return the calibration for JSON, with the line numbers of its outliers in the file."""
        f = self.calibration
        return {
            "sensor": self.sensor,
            "medium": self.medium,
            **f.to_dict(),
            "skipped_rows": self.skipped,
            "unsorted_rows": self.unsorted,
            "outlier_lines": self.lines[f.outliers].tolist(),
            "outliers": [
                {"true_m": float(f.true[k]), "measured_m": float(f.measured[k]), "studentised": float(f.studentised[k])}
                for k in f.outliers
            ],
            "notes": self.notes,
        }


def calibrate_file(path: Path) -> list[SensorCalibration]:
    """Return a calibration of every sensor and medium in a CSV file, in the order of their first lines in the file.

    The file has the columns `true_m` and `measured_m`, or both with the suffix `_cm` or `_mm`. A file with several
    sensors or media also has the text columns `sensor` and `medium`. Columns with other names are ignored. Lines with a
    missing, NaN or infinite number are skipped and counted. Lines whose true distances are not in ascending order are
    sorted and counted. A negative distance raises InputError.

    Raises:
        InputError: if `read_recorded` or `calibrate` raises InputError, a column is missing, or units are mixed.

    Example:
        >>> from pathlib import Path
        >>> import numpy as np
        >>> from surctl.marine.sensing import calibrate_file
        >>> true = np.linspace(50, 300, 11)
        >>> rows = np.column_stack((true, 1.02 * true + 3))
        >>> np.savetxt("tank.csv", rows, delimiter=",", header="true_cm,measured_cm", comments="")
        >>> (one,) = calibrate_file(Path("tank.csv"))
        >>> round(one.calibration.scale.value, 3), round(one.calibration.bias.value, 3)  # bias in m
        (1.02, 0.03)
    """
    table = read_recorded(path)
    true_column, measured_column, factor = _columns(table)
    x, y = table.numbers(true_column), table.numbers(measured_column)
    for column, values in ((true_column, x), (measured_column, y)):
        below = np.flatnonzero(values < 0)
        if len(below):
            raise InputError(
                "is below 0", file=table.at(below[0]), key=column, value=float(values[below[0]]),
                remedy="give distances",
            )  # fmt: skip
    x, y = x * factor, y * factor
    results = []
    for (sensor, medium), rows in _groups(table):
        good = rows[np.isfinite(x[rows]) & np.isfinite(y[rows])]
        try:
            calibration = calibrate(x[good], y[good])
        except InputError as error:
            which = ", ".join(p for p in (f"sensor {sensor}" if sensor else "", medium) if p)
            skipped = len(rows) - len(good)
            more = f" ({skipped} more skipped: a number is missing, NaN or infinite)" if skipped else ""
            raise InputError(
                error.problem + more, file=table.name, key=which or error.key, remedy=error.remedy
            ) from None
        results.append(
            SensorCalibration(
                sensor=sensor, medium=medium, source=table.name, calibration=calibration,
                lines=table.lines[good][calibration.order],
                skipped=len(rows) - len(good), unsorted=int(np.count_nonzero(np.diff(x[good]) < 0)),
            )
        )  # fmt: skip
    return results


def calibrate_table_ii() -> list[SensorCalibration]:
    """Return the calibrations of Table II, in air and in water.

    Example:
        >>> from surctl.marine.sensing import calibrate_table_ii
        >>> for one in calibrate_table_ii():
        ...     bias, sd = one.calibration.bias.value, one.calibration.noise_sd.value
        ...     print(f"{one.title}: {100 * bias:.2f} cm, sd {100 * sd:.2f} cm")
        sensor U1, air: -0.19 cm, sd 1.24 cm
        sensor U1, water: -0.80 cm, sd 1.63 cm
    """
    table = table_ii()
    results = []
    for medium in MEDIA:
        calibration = calibrate(table.desired, table.column(medium).measured)
        results.append(
            SensorCalibration(
                sensor="U1", medium=medium, source=table.provenance, calibration=calibration,
                lines=np.zeros(len(calibration.true), dtype=np.int64), skipped=0, unsorted=0,
            )
        )  # fmt: skip
    return results


def sonar_fragment(one: SensorCalibration) -> str:
    """Return the `[sonar]` table of a scenario file: bias_m, scale, noise_sd_m, and 95 % intervals as comments."""
    f = one.calibration
    head = [
        f"# {shown(one.title)}: {len(f.true)} rows from {shown(one.source)}",
        f"# {f.true[0]:.6g} to {f.true[-1]:.6g} m; measured = scale * true + bias + noise; 95 % confidence intervals",
    ]
    body = ["[sonar]"]
    for key, estimate in (("bias_m", f.bias), ("scale", f.scale), ("noise_sd_m", f.noise_sd)):
        body.append(f"{key} = {_number(estimate.value)}  # {estimate.low:.6g} to {estimate.high:.6g}")
    if f.varies and f.noise_at_zero is not None and f.noise_slope is not None:
        body += [
            "# the noise depends on range; noise_sd_m is its root mean square over the rows:",
            f"# sd = {_span(f.noise_at_zero)} m + {_span(f.noise_slope)} m/m * range, and at least {f.least_sd:.6g} m",
        ]
    body += [
        "# alternative with the scale fixed at 1 (then write scale = 1.0):",
        f"# bias_m = {_number(f.mean_error.value)}  # {f.mean_error.low:.6g} to {f.mean_error.high:.6g}",
        f"# noise_sd_m = {_number(f.error_sd.value)}  # {f.error_sd.low:.6g} to {f.error_sd.high:.6g}",
        "# noise_sd_m is the sd of one recorded reading and includes rounding",
    ]
    return "\n".join([*head, *body]) + "\n"


def calibration_rows(results: Sequence[SensorCalibration]) -> str:
    """Return CSV text with each reading's line in the file, error, residual, and whether the reading is an outlier."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    head = ("sensor", "medium", "line", "true_m", "measured_m", "error_m", "residual_m", "studentised", "outlier")
    writer.writerow(head)
    for one in results:
        f = one.calibration
        marked = np.zeros(len(f.true), dtype=int)
        marked[f.outliers] = 1
        numbers = [np.char.mod("%.9g", v) for v in (f.true, f.measured, f.errors, f.residuals, f.studentised)]
        writer.writerows(
            (one.sensor, one.medium, *row)
            for row in zip(one.lines.tolist(), *(v.tolist() for v in numbers), marked.tolist(), strict=True)
        )
    return out.getvalue()


def _columns(table: Recorded) -> tuple[str, str, float]:
    """Return the names of the two distance columns, and the factor that converts their unit to metres."""
    there = [unit for unit, pair in zip(_UNITS, _PAIRS, strict=True) if set(pair) <= set(table.columns)]
    if len(there) > 1:
        remedy = "give one pair of columns"
        raise InputError(f"gives the distances twice, in {' and in '.join(there)}", file=table.name, remedy=remedy)
    if there:
        return f"true_{there[0]}", f"measured_{there[0]}", _UNITS[there[0]]
    true = [name for name, _ in _PAIRS if name in table.columns]
    measured = [name for _, name in _PAIRS if name in table.columns]
    if true and measured:
        raise InputError(f"{true[0]} and {measured[0]} differ in unit", file=table.name, remedy="give both in one unit")
    if true or measured:
        absent = measured[0].replace("measured", "true") if measured else true[0].replace("true", "measured")
        table.need([absent])
    table.need(_PAIRS[0])
    return (*_PAIRS[0], 1.0)


def _groups(table: Recorded) -> Iterator[tuple[tuple[str, str], NDArray[np.intp]]]:
    count = len(table.lines)
    names = [[c.strip() for c in table.columns.get(key, [""] * count)] for key in ("sensor", "medium")]
    rows: dict[tuple[str, str], list[int]] = {}
    for k, name in enumerate(zip(*names, strict=True)):
        rows.setdefault(name, []).append(k)
    if len(rows) > _MOST_SENSORS:
        problem = f"has {len(rows)} combinations of sensor and medium"
        remedy = f"give at most {_MOST_SENSORS}, and check that this column contains names"
        raise InputError(problem, file=table.name, key="sensor", remedy=remedy)
    for (sensor, medium), indices in rows.items():
        yield (shown(sensor), shown(medium)), np.array(indices)


def _number(value: float) -> str:
    # text of a TOML float
    text = f"{value:.6g}"
    return text if any(c in text for c in ".en") else text + ".0"


def _span(estimate: Estimate) -> str:
    return f"{estimate.value:.6g} ({estimate.low:.6g} to {estimate.high:.6g})"


def file_stems(results: Sequence[SensorCalibration]) -> list[str]:
    """Return a distinct file-name suffix for each calibration: "-sensor-medium", or "" for a single unnamed sensor."""
    stems: list[str] = []
    for k, one in enumerate(results):
        parts = [re.sub(r"[^A-Za-z0-9_.]+", "-", part).strip("-.")[:40] for part in (one.sensor, one.medium)]
        stem = "".join(f"-{part}" for part in parts if part)
        if stem in stems or (not stem and len(results) > 1):
            stem = f"-{k + 1}{stem}"
        stems.append(stem)
    return stems


def pick_calibration(name: str) -> list[SensorCalibration]:
    """Return the calibrations for the command-line argument FILE: the name of the built-in table, or a file path."""
    if name == BUILT_IN:
        return calibrate_table_ii()
    path = Path(name)
    if not path.suffix and len(path.parts) == 1 and not os.path.exists(path):  # noqa: PTH110  # Path.exists raises for a long name
        raise InputError("no such file", file=shown(name), remedy=nearest(name, [BUILT_IN]))
    return calibrate_file(path)

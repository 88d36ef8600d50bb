from __future__ import annotations

import csv
import tomllib
from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.sensing import SensorCalibration, calibrate, calibrate_file
from surctl.marine.sensing.calibration.file import (
    calibrate_table_ii,
    calibration_rows,
    file_stems,
    pick_calibration,
    sonar_fragment,
)

TRUE = np.linspace(0.3, 3.0, 20)
MEASURED = 1.01 * TRUE + 0.01 * np.sin(40 * TRUE)
GOLDEN = Path(__file__).parents[1] / "golden" / "table_ii.csv"


def written(folder: Path, text: str, name: str = "c.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def table(factor: float = 1.0, unit: str = "m", extra: str = "") -> str:
    rows = "".join(f"{factor * x:.12g},{factor * y:.12g}\n" for x, y in zip(TRUE, MEASURED, strict=True))
    return f"true_{unit},measured_{unit}\n{rows}{extra}"


@pytest.mark.parametrize(("unit", "factor"), [("m", 1.0), ("cm", 100.0), ("mm", 1000.0)])
def test_units_go_by_the_suffix(tmp_path: Path, unit: str, factor: float) -> None:
    (one,) = calibrate_file(written(tmp_path, table(factor, unit)))
    assert one.calibration.bias.to_list() == pytest.approx(calibrate(TRUE, MEASURED).bias.to_list(), abs=1e-9)
    assert one.notes == [] and one.title == "one sensor" and one.lines.tolist() == list(range(2, 22))


def test_rows_without_numbers_are_skipped_and_unsorted_ones_sorted(tmp_path: Path) -> None:
    (one,) = calibrate_file(written(tmp_path, table(extra="NaN,1\n1,\ninf,2\n0.5,0.5\n0.25,0.25\n")))
    assert one.skipped == 3 and one.unsorted == 2
    assert one.lines[0] == 26 and one.calibration.true[0] == 0.25
    assert np.all(np.diff(one.calibration.true) >= 0)
    assert [note.split()[-1] for note in one.notes] == ["3", "2"]


def test_each_sensor_and_medium_has_its_own(tmp_path: Path) -> None:
    rows = []
    for k, (x, y) in enumerate(zip(TRUE, MEASURED, strict=True)):
        rows += [f"{x},{y},front,air", f"{x},{y + 0.05},rear,air", f"{x},{y + 0.001 * k},front,water"]
    results = calibrate_file(written(tmp_path, "true_m,measured_m,sensor,medium\n" + "\n".join(rows)))
    assert [(r.sensor, r.medium) for r in results] == [("front", "air"), ("rear", "air"), ("front", "water")]
    assert results[1].calibration.bias.value - results[0].calibration.bias.value == pytest.approx(0.05)
    assert results[2].lines.tolist() == list(range(4, 62, 3))
    assert file_stems(results) == ["-front-air", "-rear-air", "-front-water"]


def test_file_stems_are_distinct_and_harmless(tmp_path: Path) -> None:
    names = ["../../x", "x", "", "é", "?", "."]
    rows = [f"{x},{y},{name}" for name in names for x, y in zip(TRUE, MEASURED, strict=True)]
    stems = file_stems(calibrate_file(written(tmp_path, "true_m,measured_m,sensor\n" + "\n".join(rows))))
    assert len(set(stems)) == len(names) and not any("/" in stem for stem in stems)


REFUSED = {
    "mixed units": ("true_m,measured_cm\n1,100\n", "true_m and measured_cm differ in unit"),
    "two pairs": ("true_m,measured_m,true_cm,measured_cm\n1,1,100,100\n", "in m and in cm"),
    "no measured": ("true_cm,measured\n1,1\n", "'measured_cm' is missing; did you mean 'measured'"),
    "no true": ("tru_mm,measured_mm\n1,1\n", "'true_mm' is missing; did you mean 'tru_mm'"),
    "neither": ("x,y\n1,1\n", "'true_m' is missing; known: x, y"),
    "negative": (table(extra="-1,1\n"), r"c\.csv:22: true_m = -1\.0: is below 0"),
    "negative reading": (table(extra="1,-1\n"), r"c\.csv:22: measured_m = -1\.0"),
    "text": (table(extra="1,far\n"), r"c\.csv:22: measured_m = 'far'"),
    "too few": ("true_m,measured_m\n1,1\nnan,2\n3,3\n", r"2 complete rows are too few \(1 more skipped"),
    "all NaN": ("true_m,measured_m\n" + "nan,1\n" * 20, "0 complete rows"),
    "too few of one sensor": ("true_m,measured_m,sensor\n1,1,rear\n", "sensor rear: 1 complete row"),
    "readings of another unit": (table().replace("measured_m", "x").replace("true_m", "measured_m"), "'true_m'"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_files_are_refused(tmp_path: Path, case: str) -> None:
    text, words = REFUSED[case]
    with pytest.raises(InputError, match=words):
        calibrate_file(written(tmp_path, text))


def test_centimetres_in_a_column_of_metres_are_refused_or_noted(tmp_path: Path) -> None:
    rows = "".join(f"{x},{100 * y}\n" for x, y in zip(TRUE, MEASURED, strict=True))
    with pytest.raises(InputError, match="times the true ones; check the units"):
        calibrate_file(written(tmp_path, "true_m,measured_m\n" + rows))
    (one,) = calibrate_file(written(tmp_path, table(100.0)))
    assert "unit" in one.notes[0] and "300" in one.notes[0]


@pytest.mark.parametrize(("ratio", "there"), [(343.2 / 1482.4, "air"), (1482.4 / 343.2, "water")])
def test_a_converter_of_the_other_medium_is_calibrated_and_told(tmp_path: Path, ratio: float, there: str) -> None:
    rows = "".join(f"{x},{ratio * y}\n" for x, y in zip(TRUE, MEASURED, strict=True))
    (one,) = calibrate_file(written(tmp_path, "true_m,measured_m\n" + rows))
    assert one.calibration.scale.value == pytest.approx(ratio, rel=0.05)
    assert f"speed of sound of {there} were used in" in one.notes[0]


@pytest.mark.parametrize("ratio", [1 / 0.3048, 0.3048, 10.0, 0.1, 25.4, 0.0254, 1000.0])
def test_units_of_length_are_not_taken_for_a_medium(tmp_path: Path, ratio: float) -> None:
    rows = "".join(f"{x},{ratio * y}\n" for x, y in zip(TRUE, MEASURED, strict=True))
    with pytest.raises(InputError, match="times the true ones; check the units"):
        calibrate_file(written(tmp_path, "true_m,measured_m\n" + rows))


def test_a_column_that_is_no_name_is_refused(tmp_path: Path) -> None:
    rows = "".join(f"1,1,{k}\n" for k in range(1000))
    with pytest.raises(InputError, match="1000 combinations of sensor and medium"):
        calibrate_file(written(tmp_path, "true_m,measured_m,sensor\n" + rows))


@pytest.mark.parametrize("varies", [False, True])
def test_a_fragment_is_toml_with_three_numbers(tmp_path: Path, varies: bool) -> None:
    rng = np.random.default_rng(4)
    x = np.repeat(TRUE, 5)
    y = x + 0.004 + (0.004 + 0.02 * x * varies) * rng.standard_normal(len(x))
    text = "true_m,measured_m,sensor\n" + "".join(f'{a},{b},"e""[vil]\n = 1 é"\n' for a, b in zip(x, y, strict=True))
    (one,) = calibrate_file(written(tmp_path, text, "a \"quoted\" 'name'\nkey = 1.csv"))
    assert one.calibration.varies is varies
    fragment = sonar_fragment(one)
    read = tomllib.loads(fragment)
    assert set(read) == {"sonar"} and set(read["sonar"]) == {"bias_m", "scale", "noise_sd_m"}
    assert all(type(v) is float for v in read["sonar"].values())
    assert read["sonar"]["scale"] == pytest.approx(one.calibration.scale.value, rel=1e-5)
    assert f"# {one.calibration.bias.low:.6g} to {one.calibration.bias.high:.6g}" in fragment
    assert ("depends on range" in fragment) is varies
    other = fragment.replace("# bias_m", "bias_m2").replace("# noise_sd_m =", "noise_sd_m2 =")
    assert tomllib.loads(other)["sonar"]["bias_m2"] == pytest.approx(one.calibration.mean_error.value, rel=1e-5)


def test_whole_numbers_are_written_as_floats(tmp_path: Path) -> None:
    (one,) = calibrate_file(written(tmp_path, "true_m,measured_m\n" + "".join(f"{k},{k}\n" for k in range(1, 9))))
    read = tomllib.loads(sonar_fragment(one))["sonar"]
    assert read["scale"] == 1.0 and read["noise_sd_m"] == 0.0 and all(type(v) is float for v in read.values())


def test_rows_are_told_with_line_residual_and_mark(tmp_path: Path) -> None:
    (one,) = calibrate_file(written(tmp_path, table(extra="0.25,0.75\n")))
    rows = list(csv.DictReader(calibration_rows([one]).splitlines()))
    assert len(rows) == 21 and rows[0]["line"] == "22" and rows[0]["outlier"] == "1"
    assert [r["outlier"] for r in rows[1:]] == ["0"] * 20
    assert float(rows[3]["residual_m"]) == pytest.approx(one.calibration.residuals[3], rel=1e-6)
    assert one.to_dict()["outlier_lines"] == [22]


def test_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert [r.medium for r in pick_calibration("table-ii")] == ["air", "water"]
    with pytest.raises(InputError, match="did you mean 'table-ii'"):
        pick_calibration("table-iii")
    written(tmp_path, table(), "bare")
    assert len(pick_calibration("bare")) == 1


def golden_rows(results: list[SensorCalibration]) -> list[tuple[str, str, str, float]]:
    found = []
    for one in results:
        for key, value in one.to_dict().items():
            if isinstance(value, list) and key in (
                "bias_m",
                "scale",
                "noise_sd_m",
                "noise_slope",
                "mean_error_m",
                "error_sd_m",
            ):
                found += [(one.medium, key, end, v) for end, v in zip(("value", "low", "high"), value, strict=True)]
            elif key in ("noise_slope_p", "rms_error_m", "largest_error_m", "largest_error_at_m", "rows"):
                found.append((one.medium, key, "value", float(value)))
    return found


def test_table_ii_gives_what_it_gave() -> None:
    with GOLDEN.open() as file:
        kept = [(r["medium"], r["quantity"], r["what"], float(r["number"])) for r in csv.DictReader(file)]
    found = golden_rows(calibrate_table_ii())
    assert [row[:3] for row in found] == [row[:3] for row in kept]
    assert [row[3] for row in found] == pytest.approx([row[3] for row in kept], rel=1e-7)


def test_table_ii_says_what_is_known_of_it() -> None:
    """Bias +0.11 cm, sd 1.64 cm, largest 3 cm in water, worked out by hand."""
    water = calibrate_table_ii()[1].calibration
    by_hand = np.array([1, -1, 2, -1, 0, -2, -3, -2, 1, 0, -1, 2, 3, 1, 0, 1, 2, -1]) / 100
    assert water.errors == pytest.approx(by_hand, abs=1e-12)
    assert round(100 * water.mean_error.value, 2) == 0.11
    assert round(100 * water.error_sd.value, 2) == 1.64
    assert abs(water.errors[water.largest]) == pytest.approx(0.03)
    assert not water.varies and len(water.outliers) == 0
    assert water.scale.low < 1 < water.scale.high

import json
import os
import tomllib

import numpy as np
import pytest

from tests.cli.process import surctl, surctl_here

RNG = np.random.default_rng(8)
TRUE = np.linspace(0.3, 3.0, 30)
ROWS = "".join(
    f"{x:.4f},{1.01 * x + 0.005 + e:.4f}\n" for x, e in zip(TRUE, 0.01 * RNG.standard_normal(30), strict=True)
)
GOOD = "true_m,measured_m\n" + ROWS


def test_table_ii(tmp_path):
    done = surctl("calibrate", "table-ii", "--json", cwd=tmp_path)
    assert done.status == 0 and done.said == ""
    air, water = done.json["results"]
    assert (air["medium"], water["medium"]) == ("air", "water")
    assert water["mean_error_m"][0] == pytest.approx(0.0011, abs=5e-5)
    assert water["error_sd_m"][0] == pytest.approx(0.0164, abs=5e-5)
    assert done.json["percentages"]["agree"] == 35 and len(done.json["percentages"]["disagree"]) == 1
    told = surctl("calibrate", "table-ii", cwd=tmp_path).out
    for words in (
        "1.11 mm",
        "16.41 mm",
        "-30 mm at 0.85 m",
        "35 of the 36",
        "printed 3.6 %, recomputed 3.5 %",
        "water: 18 rows",
    ):
        assert words in told


def test_a_file_gives_fragment_rows_and_plot(tmp_path):
    (tmp_path / "c.csv").write_text(GOOD + "0.2,NaN\n0.25,0.9\n")
    done = surctl("calibrate", "c.csv", "--out", "out", cwd=tmp_path)
    assert done.status == 0 and done.said == ""
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"sonar.toml", "calibration.csv", "calibration.png"}
    for words in (
        "NaN or infinite: 1",
        "sorted: 1",
        "outlier: line 33, 0.9 m at 0.25 m",
        "outlier: a row whose externally studentised residual",
    ):
        assert words in done.out
    table = tomllib.loads((tmp_path / "out" / "sonar.toml").read_text())["sonar"]
    found = surctl("calibrate", "c.csv", "--json", cwd=tmp_path).json["results"][0]
    assert table["bias_m"] == pytest.approx(found["bias_m"][0], rel=1e-5)
    assert found["rows"] == 31 == len(found["residuals_m"]) and found["skipped_rows"] == 1
    assert found["outlier_lines"] == [33]


def test_two_sensors_give_two_of_each(tmp_path):
    body = "".join(f"{line},{name}\n" for name in ("a", "b") for line in ROWS.split())
    (tmp_path / "c.csv").write_text("true_m,measured_m,sensor\n" + body)
    done = surctl("calibrate", "c.csv", "--out", "out", "--json", cwd=tmp_path)
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert names == {"sonar-a.toml", "sonar-b.toml", "calibration.csv", "calibration-a.png", "calibration-b.png"}
    assert set(done.json["files"]) == {f"out/{name}" for name in names}


NAMES = ["it's.csv", '"$HOME"; ls\nline.csv', os.fsdecode(b"caf\xe9.csv")]


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
def test_names_that_need_quotes(tmp_path, name):
    (tmp_path / name).write_text(GOOD)
    done = surctl("calibrate", name, "--out", "out", cwd=tmp_path)
    assert done.status == 0, done.err
    tomllib.loads((tmp_path / "out" / "sonar.toml").read_text())
    assert surctl("calibrate", name, "--json", cwd=tmp_path).status == 0
    (tmp_path / name).write_text("true_m,measured_m\n1,x\n")
    assert ":2: measured_m = 'x'" in surctl("calibrate", name, cwd=tmp_path).complaint


MISTAKES = {
    "no such file": (None, "no.csv: no such file"),
    "empty": ("", "is empty"),
    "no rows": ("true_m,measured_m\n", "no rows"),
    "missing column": ("true_m,measured\n1,1\n", "did you mean 'measured'"),
    "mixed units": ("true_m,measured_cm\n1,1\n", "differ in unit"),
    "text": (GOOD + "1,one\n", "m.csv:32: measured_m = 'one': is not a number"),
    "negative": (GOOD + "-1,1\n", "m.csv:32: true_m = -1.0"),
    "semicolons": (GOOD.replace(",", ";"), "semicolons"),
    "too few": ("true_m,measured_m\n1,1\n2,2\nnan,1\n", "2 complete rows are too few (1 more skipped"),
    "centimetres": (GOOD.replace("measured_m", "x").replace("true_m", "measured_m").replace("x", "true_cm"), "unit"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_is_one_line_and_status_2(tmp_path, case):
    text, words = MISTAKES[case]
    if text is not None:
        (tmp_path / "m.csv").write_text(text)
    done = surctl_here("calibrate", "no.csv" if text is None else "m.csv", "--out", "out", cwd=tmp_path)
    assert done.status == 2 and done.out == ""
    assert words in done.complaint
    assert not list((tmp_path / "out").glob("*")), "nothing is left behind"


def test_bytes_that_are_no_text_and_folders(tmp_path):
    (tmp_path / "b.csv").write_bytes(b"true_m,measured_m\n\xff\xfe\n")
    assert "b.csv:2: is not text" in surctl_here("calibrate", "b.csv", cwd=tmp_path).complaint
    (tmp_path / "d.csv").mkdir()
    assert "d.csv" in surctl_here("calibrate", "d.csv", cwd=tmp_path).complaint
    (tmp_path / "c.csv").write_text(GOOD)
    done = surctl_here("calibrate", "c.csv", "--out", "/proc/surctl", cwd=tmp_path)
    assert done.status == 2 and "/proc/surctl" in done.complaint
    done = surctl_here("calibrate", "c.csv", "--out", "c.csv/in", cwd=tmp_path)
    assert done.status == 2 and "c.csv/in" in done.complaint


def test_json_is_one_object_of_finite_numbers(tmp_path):
    body = "".join(f"{k},{k}\n" for k in range(1, 30))
    (tmp_path / "c.csv").write_text("true_m,measured_m\n" + body)
    done = surctl("calibrate", "c.csv", "--json", cwd=tmp_path)
    assert done.json["results"][0]["noise_sd_m"] == [0.0, 0.0, 0.0]
    assert json.loads(done.out) == done.json

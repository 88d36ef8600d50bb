import csv

import pytest

from tests.cli.process import surctl, surctl_here
from tests.sensing.recording import HEADER, recorded, write

ROWS = recorded(6.0)


def test_a_recording_gives_rows_and_a_plot(tmp_path):
    write(tmp_path, [*ROWS[:100], "102.6,0,nan,2,2,2,2,0,0", *ROWS[100:]])
    done = surctl("sonar-replay", "log.csv", "--bias", "0.0011", "--out", "out", "--json", cwd=tmp_path)
    assert done.status == 0 and done.said == ""
    found = done.json
    assert found["rows"] == 241 and found["skipped_incomplete"] == 1 and found["skipped_back_in_time"] == 0
    assert found["cycle_s"] == pytest.approx(0.1, rel=1e-2) and found["restarts"] == 0
    assert [s["sensor"] for s in found["sensors"]] == [0, 1, 2, 3]
    assert all(s["readings"] == 60 and s["gaps"] == 0 and s["healthy_share"] > 0.9 for s in found["sensors"])
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"filtered.csv", "sonar-replay.png"}
    with (tmp_path / "out" / "filtered.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["time_s", "sensor", "reading_m", "range_m", "bound_m", "healthy", "age_s"]
    assert sum(1 for r in rows if r["reading_m"]) == 240
    told = surctl("sonar-replay", "log.csv", cwd=tmp_path)
    assert told.status == 0 and "NaN or infinite: 1" in told.out
    assert (tmp_path / "surctl-out" / "sonar-replay" / "filtered.csv").exists()


def test_a_calibration_goes_in(tmp_path):
    """Readings 4 % too long and 5 cm off: with scale and bias told, the range is the true one."""
    rows = []
    for row in ROWS:
        cells = row.split(",")
        rows.append(",".join([*cells[:2], *(f"{1.04 * float(c) + 0.05:.5f}" for c in cells[2:7]), *cells[7:]]))
    write(tmp_path, rows, name="off.csv")
    write(tmp_path, ROWS)
    surctl("sonar-replay", "off.csv", "--scale", "1.04", "--bias", "0.05", "--out", "a", cwd=tmp_path)
    surctl("sonar-replay", "log.csv", "--noise-sd", f"{0.015 / 1.04}", "--out", "b", cwd=tmp_path)
    tables = []
    for name in "ab":
        with (tmp_path / name / "filtered.csv").open() as file:
            tables.append([float(r["range_m"]) for r in csv.DictReader(file) if r["sensor"] == "1"])
    # not to the last digit: the minimum and the conversion's steps are scaled as well
    assert tables[0][20:] == pytest.approx(tables[1][20:], abs=2e-3)


MISTAKES = {
    "missing column": (HEADER.replace("time_s", "time"), ROWS, [], "'time_s' is missing; did you mean 'time'"),
    "unknown sensor": (HEADER, ROWS, ["--sensors", "2"], "log.csv:4: sensor = 2.0: no such sensor; give 0 to 1"),
    "time goes back": (HEADER, ROWS[::-1], [], "time goes back"),
    "milliseconds": (HEADER, [f"{100 * k},0,2,2,2,2,2,0,0" for k in range(50)], [], "give seconds"),
    "text": (HEADER, [*ROWS, "107,0,2,2,two,2,2,0,0"], [], "log.csv:242: sample_3_m = 'two'"),
    "negative": (HEADER, [*ROWS, "107,0,2,2,-2,2,2,0,0"], [], "sample_3_m = -2.0"),
    "ragged": (HEADER, [*ROWS, "107,0,2,2"], [], "log.csv:242: has 4 cells"),
    "no rows": (HEADER, [], [], "no rows"),
    "no sensors": (HEADER, ROWS, ["--sensors", "0"], "--sensors"),
    "minimum above maximum": (HEADER, ROWS, ["--minimum", "9"], "0 < minimum < maximum"),
    "scale of 0": (HEADER, ROWS, ["--scale", "0"], "--scale"),
    "scale of NaN": (HEADER, ROWS, ["--scale", "nan"], "scale"),
    "bias of NaN": (HEADER, ROWS, ["--bias", "nan"], "bias"),
    "no such option": (HEADER, ROWS, ["--filter", "x"], "--filter"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_is_one_line_and_status_2(tmp_path, case):
    header, rows, options, words = MISTAKES[case]
    write(tmp_path, rows, header=header)
    done = surctl_here("sonar-replay", "log.csv", *options, "--out", "out", cwd=tmp_path)
    assert done.status == 2 and done.out == "", done
    assert words in done.complaint


def test_files_and_folders_that_are_none(tmp_path):
    assert "no such file" in surctl("sonar-replay", "log.csv", cwd=tmp_path).complaint
    write(tmp_path, ROWS, name='it\'s "here".csv')
    done = surctl("sonar-replay", 'it\'s "here".csv', "--out", "/proc/surctl", cwd=tmp_path)
    assert done.status == 2 and "/proc/surctl" in done.complaint
    assert surctl("sonar-replay", 'it\'s "here".csv', "--out", "out", cwd=tmp_path).status == 0
    (tmp_path / "b.csv").write_bytes(HEADER.encode() + b"\n\xff\n")
    assert "b.csv:2: is not text" in surctl("sonar-replay", "b.csv", cwd=tmp_path).complaint

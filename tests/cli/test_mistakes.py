"""A user's mistake: one line with file, key, value and remedy; exit status 2; never a traceback."""

import re
import sys

import pytest

from tests.cli.process import LIBRARY, surctl_here
from tests.cli.test_lost_output import LOOP

VEHICLE = (LIBRARY / "marine" / "vehicle" / "library" / "sur400.toml").read_text()
GAINS = (LIBRARY / "marine" / "control" / "library" / "default.toml").read_text()
SCENARIO = (LIBRARY / "marine" / "simulation" / "library" / "pool-static.toml").read_text()
STUDY = (LIBRARY / "marine" / "study" / "library" / "default.toml").read_text()

FILES = {
    "missing key": (VEHICLE.replace("m33 =", "# m33 ="), ["m.toml", "inertia.m33", "is missing", "kg"]),
    "wrong unit": (VEHICLE.replace('unit = "kg m^2"', 'unit = "kg m"'), ["inertia.m44", "'kg m'", "kg m^2"]),
    "wrong sign": (VEHICLE.replace("value = 50.0", "value = -50.0", 1), ["inertia.m11", "-50.0", "greater than 0"]),
    "not a number": (VEHICLE.replace("value = 50.0", "value = nan", 1), ["inertia.m11", "nan"]),
    "text for a number": (VEHICLE.replace("value = 50.0", 'value = "50 kg"', 1), ["inertia.m11.value", "50 kg"]),
    "unknown key": (VEHICLE.replace("m33 =", "m_33 ="), ["inertia.m_33", "unknown key", "'m33'"]),
    "no provenance": (VEHICLE.replace("provenance", "# provenance", 2), ["provenance", "hull.radius"]),
    "empty file": ("", ["m.toml", "is empty"]),
    "not TOML": ("kind = vehicle\n", ["m.toml", "not valid TOML"]),
    "another kind": ('kind = "boat"\n', ["kind", "boat", "vehicle"]),
    "a study without a vehicle": (STUDY.replace("vehicle =", "# vehicle =", 1), ["vehicle", "is missing"]),
    "a study of unknown claims": ('claims = ["v1-printd"]\n' + STUDY, ["v1-printed"]),
    "an unknown guidance": ('guidance = "ilo"\n' + STUDY, ["guidance", "'ilo'", "'ilos'"]),
    "a sweep of an unknown gain": (STUDY.replace('gain = "k_v"', 'gain = "kv"'), ["kv", "'k_v'"]),
    "a sweep of a value twice": (
        re.sub(r"(k_v.*\nvalues = )\[.*\]", r"\1[1.0, 1.0]", STUDY),
        ["k_v", "ascending"],
    ),
}


@pytest.mark.parametrize("case", FILES)
def test_study_of_a_bad_file(tmp_path, case):
    text, words = FILES[case]
    (tmp_path / "m.toml").write_text(text)
    done = surctl_here("study", "m.toml", cwd=tmp_path)
    assert done.status == 2, done
    for word in words:
        assert word in done.complaint
    assert done.out == ""


def test_binary_file_and_missing_file_and_folder(tmp_path):
    (tmp_path / "b.toml").write_bytes(bytes(range(256)))
    assert "not text" in surctl_here("study", "b.toml", cwd=tmp_path).complaint
    assert "no such file" in surctl_here("study", "c.toml", cwd=tmp_path).complaint
    (tmp_path / "d.toml").mkdir()
    done = surctl_here("study", "d.toml", cwd=tmp_path)
    assert done.status == 2
    assert "d.toml" in done.complaint


GAIN_MISTAKES = {
    "gain of 0": (GAINS.replace("value = 1.5", "value = 0", 1), ["gains.k_v", "= 0", "greater than 0"]),
    "gain below 0": (GAINS.replace("value = 1.5", "value = -1.5", 1), ["gains.k_v", "-1.5"]),
    "unknown gain": (GAINS.replace("k_psi =", "kpsi ="), ["gains.kpsi", "'k_psi'"]),
    "missing gain": (GAINS.replace("k_psi =", "# k_psi ="), ["gains.k_psi", "is missing"]),
}


@pytest.mark.parametrize("case", GAIN_MISTAKES)
def test_bad_gain_file(tmp_path, case):
    text, words = GAIN_MISTAKES[case]
    (tmp_path / "g.toml").write_text(text)
    done = surctl_here("simulate", "pool-static", "--gains", "g.toml", cwd=tmp_path)
    assert done.status == 2
    for word in ["g.toml", *words]:
        assert word in done.complaint


SCENARIO_MISTAKES = {
    "starts inside an obstacle": (
        SCENARIO.replace("[[0.25, 0.25]", "[[0.55, 0.35]"),
        ["path_m", "inside obstacle", "Obstacle1"],
    ),
    "one point": (SCENARIO.replace("[[0.25, 0.25], [2.75, 1.0]]", "[[0.25, 0.25]]"), ["path_m", "at least 2 points"]),
    "negative speed": (
        SCENARIO.replace("cruise_m_per_s = 0.15", "cruise_m_per_s = -0.15"),
        ["cruise_m_per_s", "-0.15"],
    ),
    "obstacles that overlap": (
        SCENARIO.replace("centre_m = [1.2, 0.7]", "centre_m = [0.65, 0.35]"),
        ["s.toml", "obstacles.Obstacle2.centre_m = [0.65, 0.35]", "overlaps obstacle 'Obstacle1' by 0.050 m", "move"],
    ),
    "target inside an obstacle": (
        SCENARIO.replace("centre_m = [2.0, 1.0]", "centre_m = [2.75, 0.96]"),
        ["s.toml", "path_m = [2.75, 1.0]", "inside obstacle 'Obstacle4'", "move the target or the obstacle"],
    ),
    "unit in the key": (SCENARIO.replace("cruise_m_per_s", "cruise_km_per_h"), ["cruise_km_per_h", "'cruise_m_per_s'"]),
    "depth in the air": (SCENARIO.replace("depth_m = -0.15", "depth_m = 0.15"), ["depth_m", "0.15", "z points up"]),
    "a quote in a name": (
        SCENARIO.replace('"Obstacle1"', "'Ob\"1'").replace("[[0.25, 0.25]", "[[0.55, 0.35]"),
        ['Ob"1'],
    ),
    "unknown vehicle": (SCENARIO.replace('"sur400"', '"sur4000"'), ["vehicle", "'sur400'"]),
}


@pytest.mark.parametrize("case", SCENARIO_MISTAKES)
def test_bad_scenario_file(tmp_path, case):
    text, words = SCENARIO_MISTAKES[case]
    (tmp_path / "s.toml").write_text(text)
    done = surctl_here("simulate", "s.toml", cwd=tmp_path)
    assert done.status == 2, done
    for word in words:
        assert word in done.complaint


WORDS = {
    "unknown scenario": (["simulate", "tank-statik"], ["tank-static"]),
    "unknown vehicle": (["simulate", "tank-static", "--vehicle", "sur54"], ["vehicle", "sur54"]),
    "unknown law": (["simulate", "tank-static", "--law", "papr"], ["law", "'paper'"]),
    "unknown form": (["simulate", "tank-static", "--law", "paper", "--avoidance", "print"], ["avoidance", "'printed'"]),
    "unknown guidance": (["simulate", "tank-static", "--guidance", "iloss"], ["guidance", "'iloss'", "ilos"]),
    "form that the law does not take": (
        ["simulate", "tank-static", "--avoidance", "printed"],
        ["guarded", "corrected"],
    ),
    "unknown mode": (["simulate", "tank-static", "--priority-mode", "nbs"], ["priority-mode", "'nsb'"]),
    "unknown ladder": (
        ["simulate", "tank-static", "--priority-mode", "projected", "--fallback", "bounde"],
        ["fallback", "'bounded'"],
    ),
    "a ladder without limits": (["export", "--fallback", "bounded"], ["fallback", "mode nsb has none", "projected"]),
    "a ladder that is not explained": (
        ["simulate", "tank-static", "--priority-mode", "projected", "--fallback", "bounded", "--explain"],
        ["--fallback", "cannot be explained"],
    ),
    "a ladder in a campaign": (
        ["simulate", "tank-static", "--priority-mode", "filter", "--fallback", "bounded", "--monte-carlo"],
        ["--fallback", "single runs"],
    ),
    "unknown sensing": (["simulate", "tank-static", "--sensing", "sonr"], ["sensing", "'sonar'"]),
    "a window of NaN": (
        ["vehicle", "from-log", "a.csv", "--start", "sur400", "--window", "nan"],
        ["--window", "finite"],
    ),
    "negative seed": (["simulate", "tank-static", "--seed", "-1"], ["--seed"]),
    "no row with sonars": (["reproduce", "E5", "tank-static", "--webots"], ["--webots", "tank-static-sonar"]),
    "no row with a simulation": (["reproduce", "E5", "--independent"], ["--independent", "no effect on E5"]),
    "unknown claim": (["verify", "v1-print"], ["claim", "'v1-printed'"]),
    "too fast a cruise": (["verify", "--cruise", "9"], ["--cruise = 9.0", "thrust"]),
    "one of several is too fast": (["verify", "--cruise", "0.1,9"], ["--cruise = 9.0", "thrust"]),
    "no list of speeds": (["verify", "--cruise", "0.1..0.2"], ["--cruise = '0.1..0.2'", "LOW..HIGH:COUNT"]),
    "a negative speed of a tuning": (["tune", "--cruise", "0.1,-0.1"], ["--cruise = -0.1", "greater than 0"]),
    "a speed of a tuning above the cap": (["tune", "--cruise", "0.1,9"], ["surctl: --cruise = 9", "above the cap"]),
    "a speed of a sweep above the cap": (["sweep", "k_v=1,2", "--cruise", "0.9"], ["--cruise = 0.9", "cap"]),
    "no axis": (["sweep", "lookahead", "k_v=1,2"], ["lookahead", "PARAMETER="]),
    "axis twice": (["sweep", "k_v=1,2", "k_v=1,2"], ["k_v", "twice"]),
    "axis of zero": (["sweep", "k_v=0,1", "lookahead=1,2"], ["k_v", "greater than 0"]),
    "a sweep of unknown guidance": (["sweep", "k_v=1,2", "--guidance", "ilo"], ["guidance", "'ilos'"]),
    "no such knob": (["sweep", "kv=1,2"], ["kv", "'k_v'"]),
    "reversed range": (["sweep", "k_v=3..1:4"], ["k_v", "reversed"]),
    "range without a count": (["sweep", "k_v=1..3"], ["k_v=1..3:COUNT"]),
    "no points": (["sweep", "k_v=1..3", "--design", "lhs", "--points", "0"], ["--points"]),
    "points of a grid": (["sweep", "k_v=1,3", "--points", "5"], ["points", "COUNT"]),
    "unknown design": (["sweep", "k_v=1..3", "--design", "lsh", "--points", "5"], ["design", "'lhs'"]),
    "unknown column": (["sweep", "k_v=1..3", "k_r=1..3", "--sensitivity", "times_s"], ["column", "'time_s'"]),
    "too many seeds": (["sweep", "k_v=1,2", "--seeds", "100000000000"], ["--seeds", "1000000"]),
    "too many values": (["sweep", "k_v=1..2:99999999999"], ["k_v", "10000000"]),
    "too many points": (["sweep", "k_v=1..2", "--design", "lhs", "--points", "99999999999"], ["points", "10000000"]),
    "a design beside indices": (
        ["sweep", "k_v=1..2", "k_r=1..2", "--sensitivity", "time_s", "--design", "lhs"],
        ["--sensitivity", "--design"],
    ),
    "locus of what moves no pole": (
        ["sweep", "scenario.current_x=0,0.01", "--scenario", "pool-static", "--locus", "scenario.current_x"],
        ["locus", "moves no pole"],
    ),
    "locus of one value": (["sweep", "k_v=1", "k_r=1,2", "--locus", "k_v"], ["k_v", "a range"]),
    "cruise above the cap": (["sweep", "scenario.cruise=0.1,5", "--scenario", "pool-static"], ["cruise = 5.0", "cap"]),
    "endless run": (["sweep", "scenario.time_limit=1e300"], ["scenario.time_limit", "1e+06"]),
    "huge seed": (["sweep", "seed=1e19", "--scenario", "pool-static"], ["seed", "whole"]),
    "huge seed of a tuning": (["tune", "--seed", "1000000000000000"], ["--seed", "at most"]),
    "one vehicle twice": (["tune", "--vehicle", "sur400", "--vehicle", "sur400"], ["twice", "sur400"]),
    "workers and a cluster": (["sweep", "k_v=1,2", "--workers", "2", "--dask", "tcp://a:1"], ["--workers", "--dask"]),
    "axis of NaN": (["sweep", "k_v=nan,1", "lookahead=1,2"], ["k_v"]),
    "no C identifier": (["export", "--name", "my pilot"], ["my pilot"]),
    "C keyword": (["export", "--name", "while"], ["while"]),
    "export by ear": (["export", "--sensing", "ear"], ["--sensing", "'ear'"]),
    "a fault that nobody hears": (["export", "--sensing", "truth", "--fault", "stuck:0"], ["--fault", "sonar"]),
    "unknown target": (["export", "--target", "c98"], ["--target", "'c99'"]),
    "unknown precision": (["export", "--real", "float16"], ["--real", "'float64'"]),
    "unknown processor": (["export", "--check", "--targets", "cortex-m5"], ["targets", "'cortex-m7'"]),
    "targets without a check": (["export", "--targets", "gcc-O2"], ["--targets", "add --check"]),
    "steps without a check": (["export", "--steps", "10"], ["--steps", "add --check"]),
    "nothing of that name": (["list", "--show", "sur41"], ["sur400"]),
    "unknown command": (["fly"], ["fly"]),
    "unknown option": (["study", "--fast"], ["--fast"]),
}


@pytest.mark.parametrize("case", WORDS)
def test_bad_words(tmp_path, case):
    words, expected = WORDS[case]
    done = surctl_here(*words, cwd=tmp_path)
    assert done.status == 2, done
    for word in expected:
        assert word in done.complaint
    assert done.out == ""


def test_a_finding_stays_on_one_line_whatever_the_name_of_an_obstacle(tmp_path):
    (tmp_path / "m.toml").write_text(SCENARIO.replace('name = "Obstacle1"', 'name = "a\\nb"'))
    done = surctl_here("lint", "m.toml", "--vehicle", "sur540-flooded", cwd=tmp_path)
    assert done.status == 1 and "error: obstacles.a\\nb: at the start" in done.out
    assert all(line.startswith(("error: ", "warning: ", "info: ")) for line in done.out.splitlines())


@pytest.mark.parametrize(
    "words",
    [
        *("study", "tune", "export", "export --target fmu", "simulate pool-behind --controller c"),
        *("study mine.py:build", "export mine.py:build", "tune mine.py:build"),
    ],
)
def test_without_a_compiler_a_command_that_needs_one_says_so_before_it_begins(tmp_path, monkeypatch, words):
    surctl_here("new", "system", "mine", cwd=tmp_path)
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setitem(sys.modules, "ziglang", None)
    done = surctl_here(*words.split(), cwd=tmp_path)
    assert done.status == 2 and "no C compiler found" in done.complaint and "pip install ziglang" in done.complaint
    assert [path.name for path in tmp_path.iterdir() if path.name != "__pycache__"] == ["mine.py"]


@pytest.mark.filterwarnings("default:no C compiler")
def test_without_a_compiler_many_runs_of_a_system_take_longer_and_say_so(tmp_path, monkeypatch):
    surctl_here("new", "system", "mine", cwd=tmp_path)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv("CC", "no-such-compiler")
    done = surctl_here("study", "mine.py:build", cwd=tmp_path)
    assert done.status == 2 and done.complaint.startswith("surctl: CC = 'no-such-compiler': names no program")
    monkeypatch.delenv("CC")
    monkeypatch.setitem(sys.modules, "ziglang", None)
    done = surctl_here("simulate", "mine.py:build", "--seconds", "0.05", cwd=tmp_path)
    assert done.status == 0 and not done.err  # one run needs none
    done = surctl_here("sweep", "mine.py:build", "k_p=4..20:3", cwd=tmp_path)
    assert done.status == 0 and "no C compiler found" in done.complaint and "until then" in done.complaint


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ('within={"y": (-1.0, 1.0)}', "within.y: is not a state of the system; known: x"),
        ('ranges={"plant.m": (1.0, 2.0)}', "plant.m: no such number of the system"),
    ],
)
def test_a_misspelt_name_in_the_file_of_a_system_names_the_file(tmp_path, line, says):
    (tmp_path / "loop.py").write_text(LOOP.replace("System(plant, law, ", f"System(plant, law, {line}, "))
    done = surctl_here("verify", "loop.py:build", cwd=tmp_path)
    assert done.status == 2 and done.complaint.startswith(f"surctl: loop.py:build: {says}")


@pytest.mark.filterwarnings("default:divide by zero", "default:ranges.k")
def test_a_warning_is_no_error_and_one_of_numpy_has_its_place(tmp_path):
    text = LOOP.replace("def build():", "import numpy\n\ndef build():\n    numpy.float64(1) / 0")
    (tmp_path / "loop.py").write_text(
        text.replace("System(plant, law, ", 'System(plant, law, ranges={"k": (3.0, 4.0)}, ')
    )
    done = surctl_here("lint", "loop.py:build", cwd=tmp_path)
    first, second, *_ = done.err.splitlines()
    assert first == f"surctl: warning: {tmp_path / 'loop.py'}:11: divide by zero encountered in scalar divide"
    assert second.startswith("surctl: warning: ranges.k = (3.0, 4.0): leaves out the nominal value, 2 1/s")


def test_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("in the way")
    for words in (["study"], ["export"], ["simulate", "pool-behind"], ["sweep", "k_v=1,2", "lookahead=1,2"]):
        done = surctl_here(*words, "--out", "file/inside", cwd=tmp_path)
        assert done.status == 2, done
        assert "file/inside" in done.complaint


def test_folder_that_not_even_root_can_write(tmp_path):
    done = surctl_here("study", "--out", "/proc/surctl", cwd=tmp_path)
    assert done.status == 2
    assert "/proc/surctl" in done.complaint

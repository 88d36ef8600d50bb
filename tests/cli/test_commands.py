import json
import math
import re
import tomllib
from pathlib import Path

import pytest

from surctl.certcheck import seal
from surctl.marine.control import LAW_NAMES, load_gains
from surctl.marine.simulation import LIBRARY as SCENARIOS
from surctl.marine.vehicle import LIBRARY as VEHICLES
from tests.cli.process import surctl, surctl_here
from tests.tools import need, need_compiler

RUN_KEYS = {
    "scenario",
    "vehicle",
    "law",
    "sensing",
    "priority_mode",
    "fallback",
    "seed",
    "reached",
    "time_s",
    "min_clearance_m",
    "path_error_m",
    "length_m",
    "stopped_because",
}


def test_help_names_every_command(tmp_path):
    done = surctl_here("--help", cwd=tmp_path)
    assert done.status == 0
    commands = (
        "study",
        "reproduce",
        "simulate",
        "sweep",
        "verify",
        "export",
        "lint",
        "list",
    )
    for command in commands:
        assert command in done.out
        assert surctl_here(command, "--help", cwd=tmp_path).status == 0


def test_list_and_show(tmp_path):
    lines = surctl_here("list", cwd=tmp_path).out.splitlines()
    assert max(map(len, lines)) <= 100 and not any(line.endswith("-") for line in lines)
    names = surctl_here("list", "--json", cwd=tmp_path).json
    assert set(names["vehicles"]) >= {"sur540-flooded", "sur540-light", "sur400", "bluerov2-vonbenzon", "bluerov2-wu"}
    golden = Path(__file__).parents[1] / "golden" / "scenarios.toml"
    assert set(names["scenarios"]) >= set(tomllib.loads(golden.read_text(encoding="utf-8")))
    shown = surctl_here("list", "--show", "sur400", cwd=tmp_path)
    (tmp_path / "mine.toml").write_text(shown.out)
    assert surctl_here("lint", "mine.toml", cwd=tmp_path).status == 0


def test_simulate_prints_the_contract(tmp_path):
    done = surctl("simulate", "pool-behind", "--sensing", "sonar", "--seed", 3, "--runs", 2, "--json", cwd=tmp_path)
    assert done.status == 0
    runs = done.json["runs"]
    assert [run["seed"] for run in runs] == [3, 4]
    for run in runs:
        assert set(run) >= RUN_KEYS
        assert run["reached"]
        assert run["law"] == "guarded"
        assert run["priority_mode"] == "nsb"
        assert math.isfinite(run["path_error_m"])


def test_a_collision_ends_with_status_1(tmp_path):
    done = surctl("simulate", "tank-speed-015", "--law", "paper", "--json", cwd=tmp_path)
    assert done.status == 1
    assert done.json["runs"][0]["stopped_because"] == "collision"


@pytest.mark.parametrize("command", ["simulate", "sweep", "export"])
def test_help_names_every_law(command, tmp_path):
    told = surctl_here(command, "--help", cwd=tmp_path).out
    for law in LAW_NAMES:
        assert re.search(rf"\b{law}\b", told), law


def test_verify_tells_expected_verdicts(tmp_path):
    done = surctl("verify", "v1-printed", "--json", cwd=tmp_path)
    (why,) = done.json["failures"]  # the default gains at a quarter of the yaw inertia
    assert done.status == 1 and "too small: a disk margin of " in why and done.json["claims"][0]["verdict"] == "refuted"
    nominal, worst = (done.json["linear"][k] for k in ("nominal", "worst"))
    for mild, bad in zip(nominal["disk_margins"], worst["disk_margins"], strict=True):
        assert 0 < bad["guaranteed"] < mild["guaranteed"] <= mild["reached"]
    (printed,) = done.json["claims"]
    assert printed["verdict"] == printed["expected"] == "refuted"
    assert printed["counterexample"]["values"]


CLAIM = """
kind = "claim"
name = "sway"
left = "y_e*u*sin(-atan2(y_e, ahead)) + u*y_e^2/sqrt(y_e^2 + ahead^2)"
unit = "m^2/s"
[constants]
ahead = 0.5
[variables]
y_e = { lower = -2, upper = 2, unit = "m" }
u = { lower = 0.05, upper = 0.25, unit = "m/s" }
"""


def test_verify_proves_a_file_and_check_accepts_what_it_writes(tmp_path):
    (tmp_path / "mine.toml").write_text(CLAIM, encoding="utf-8")
    done = surctl("verify", "mine.toml", "--out", "proofs", "--json", cwd=tmp_path)
    assert done.status == 0
    (claim,) = done.json["claims"]
    assert set(done.json) == {"claims", "pictures", "next"}  # nothing about a vehicle
    assert claim["verdict"] == "proved" and claim["remaining"] is None
    assert (claim["certificate"]["kind"], claim["certificate"]["file"]) == ("interval", "proofs/sway.json")
    assert {f"proofs/{p.name}" for p in (tmp_path / "proofs").glob("*.png")} == set(done.json["pictures"])
    checked = surctl("check", "proofs/sway.json", "--json", cwd=tmp_path)
    assert checked.status == 0 and checked.json["accepted"] and checked.json["claim"]["name"] == "sway"
    path = tmp_path / "proofs" / "sway.json"
    path.write_text(path.read_text(encoding="utf-8").replace('"upper":2.0', '"upper":3.0'), encoding="utf-8")
    spoilt = surctl("check", "proofs/sway.json", cwd=tmp_path)
    assert spoilt.status == 1 and spoilt.out.startswith("rejected: the hash")
    assert surctl("check", "mine.toml", cwd=tmp_path).status == 2


def test_check_says_what_slack_means_and_prints_no_control_character(tmp_path):
    claim = {
        "name": "n", "statement": "a\rb\u202e", "unit": "W", "left": "x", "right": "1\n  right: 0", "constraints": [],
        "slack": 1e-9, "variables": [{"name": "x", "unit": "m", "lower": -1.0, "upper": 1.0}],
    }  # fmt: skip
    case = {"choice": "", "numerator": "x - 1", "denominators": [], "multipliers": [], "tree": "n", "points": []}
    path = tmp_path / "c.json"
    path.write_text(json.dumps(seal("interval", claim, {"cases": [case]})), encoding="utf-8")
    assert surctl_here("check", str(path), cwd=tmp_path).out.count("\n") == 1, "what is read is one line"
    claim["right"] = "1\n"
    path.write_text(json.dumps(seal("interval", claim, {"cases": [case]})), encoding="utf-8")
    done = surctl_here("check", str(path), cwd=tmp_path)
    assert done.status == 0 and "proved to within 1e-09 W" in done.out and "  right: 1\\n\n" in done.out
    told = surctl_here("check", str(path), "--json", cwd=tmp_path)
    assert told.json["slack"] == 1e-9 and told.json["proves"] in done.out
    assert told.out.strip().isprintable() and told.json["claim"]["statement"] == "a\rb\u202e"
    slow = surctl_here("check", str(path), "--time-limit", "1e-9", cwd=tmp_path)
    assert slow.status == 1 and slow.out.startswith("rejected: the check takes more than 1e-09 s of processor time")


def test_verify_shows_claims_as_files(tmp_path):
    done = surctl_here("verify", "v2-static", "--show", cwd=tmp_path)
    assert done.status == 0 and done.out.startswith('kind = "claim"\nname = "v2-static"')


def test_verify_tells_what_it_cannot_settle(tmp_path):
    text = CLAIM.replace('left = "', 'left = "0*select(0, 1, 0, 1/y_e^2) + ')
    (tmp_path / "open.toml").write_text(text, encoding="utf-8")
    done = surctl("verify", "open.toml", "--time-limit", 1, cwd=tmp_path)
    assert done.status == 1
    assert "FAIL sway" in done.out and "unknown" in done.out and "division by an interval that contains 0" in done.out


def test_sweep_finishes_and_picks(tmp_path):
    loop = ("--scenario", "pool-behind", "--law", "closed_form", "--json")
    words = ("sweep", "lookahead=0.6..1.2:2", "vehicle.m11=50", *loop)
    first = surctl(*words, "--out", "a", "--workers", 1, cwd=tmp_path)
    assert first.status == 0 and "ETA" in first.err
    assert first.json["axes"] == {"lookahead": [0.6, 1.2], "vehicle.m11": [50.0]}
    rows = first.json["results"]
    assert len(rows) == 2 and first.json["picked"] in rows
    assert first.json["picked"]["score"] == min(row["score"] for row in rows if row["feasible"])
    assert {p.name for p in (tmp_path / "a").iterdir()} == {
        "sweep.nc", "gains.toml", "sweep-lookahead-vehicle.m11-score.png", "sweep-parallel.png",
    }  # fmt: skip
    again = surctl(*words, "--out", "a", cwd=tmp_path)
    assert "has all points" in again.err and again.json == first.json
    none = surctl("sweep", "k_v=0.02", *loop, "--out", "c", cwd=tmp_path)
    assert (none.status, none.json["picked"], none.json["gains"]) == (1, None, None)
    assert not (tmp_path / "c" / "gains.toml").exists()


def test_sweep_tells_what_a_column_depends_on(tmp_path):
    words = ("sweep", "k_v=1..3", "lookahead=0.5..1.5", "--scenario", "pool-behind", "--sensitivity", "disk_margin")
    done = surctl(*words, "--law", "closed_form", "--points", 4, "--workers", 1, "--json", cwd=tmp_path)
    found = done.json["sensitivity"]
    assert found["axes"] == ["k_v", "lookahead"] and len(done.json["results"]) == 16
    assert (tmp_path / "surctl-out" / "sensitivity-disk_margin.png").exists()


def test_export_in_float_is_checked_on_other_builds(tmp_path):
    need("gcc")
    words = ("export", "--law", "closed_form", "--scenario", "pool-behind", "--real", "float32")
    check = ("--check", "--targets", "gcc-O0", "--steps", "50")
    done = surctl(*words, *check, "--out", "c", "--json", cwd=tmp_path)
    assert done.status == 0, done.err
    told = done.json
    assert told["real"] == "float32" and told["sil"]["tau"] == 0.0 and told["check"]["passed"]
    (build,) = told["check"]["builds"]
    assert build["target"] == "gcc-O0" and build["steps"] == told["sil"]["steps"] + 50 and build["differing"] == 0
    assert "float x[" in (tmp_path / "c" / "surctl_closed_form.h").read_text()


def test_export_believes_in_the_sensors_it_is_told_of(tmp_path):
    need_compiler()
    known = (SCENARIOS / "pool-behind.toml").read_text() + "[own_state]\ntruth = true\n"
    (tmp_path / "known.toml").write_text(known)
    words = ("export", "--law", "paper", "--scenario", "known.toml", "--name", "pilot")
    done = surctl(*words, "--fault", "dropout:0:2:3", "--out", "c", "--json", cwd=tmp_path)
    assert done.status == 1 and done.json["run"]["law"] == "paper" and done.json["sil"]["passed"]
    assert done.json["failure"].startswith("pool-behind by sur400: it does not arrive")  # the law of the paper
    sensors = done.json["run"]["sensors"]
    assert sensors["own_state"] == "truth" and [fault["kind"] for fault in sensors["faults"]] == ["dropout"]
    header = (tmp_path / "c" / "pilot.h").read_text()
    assert "double samples[4][5];" in header


def fast_mission(folder):
    """An empty and longer tank at 0.47 m/s, with waves that push it off the path."""
    mission = (SCENARIOS / "tank-speed-015.toml").read_text()
    mission = mission[: mission.index("[[obstacles]]")]
    for old, new in (("= 0.22", "= 0.47"), ("9.5", "14.5"), ("length_m = 10.0", "length_m = 15.0")):
        mission = mission.replace(old, new)
    (folder / "fast.toml").write_text(f"{mission}[disturbance]\nwave_force_n = 0.2\n")


def test_lint_warns_of_a_cap_above_the_bearable_speed(tmp_path):
    fast_mission(tmp_path)
    text = 'kind = "study"\nname = "s"\nvehicle = "bluerov2-wu"\n{}[[runs]]\nscenario = "fast.toml"\n'
    for name, gains in (("named", 'gains = "default"\n'), ("derived", "")):
        (tmp_path / f"{name}.toml").write_text(text.format(gains))
    done = surctl_here("lint", "named.toml", cwd=tmp_path)
    assert "warning: cap_m_per_s: the cap of 0.47 m/s is above the bearable speed of 0.2" in done.out
    for file in ("derived.toml", "pool-behind"):
        assert "bearable" not in surctl_here("lint", file, cwd=tmp_path).out


@pytest.mark.parametrize("kind", ["scenario", "study"])
def test_lint_names_the_command_for_the_gain_margin_that_no_contact_needs(tmp_path, kind):
    mission = (SCENARIOS / "tank-static.toml").read_text().replace('"sur540-flooded"', '"mine.toml"')
    vehicle = (VEHICLES / "bluerov2-heavy.toml").read_text()
    (tmp_path / "mission.toml").write_text(mission)
    (tmp_path / "mine.toml").write_text(vehicle.replace('name = "bluerov2-heavy"', 'name = "mine"'))
    study = 'kind = "study"\nname = "s"\nvehicle = "mine.toml"\n[[runs]]\nscenario = "mission.toml"\n'
    (tmp_path / "study.toml").write_text(study)
    file = "mission.toml" if kind == "scenario" else "study.toml"
    done = surctl_here("lint", file, "--vehicle", "mine.toml", cwd=tmp_path)
    needed = re.search(r"gains.margin: no contact in .* set margin = \"([\d.]+) m\" in", done.out)
    assert needed, done.out
    command = next(line.split() for line in done.out.splitlines() if line.startswith("  surctl gains derive"))
    assert command[command.index("--margin") + 1] == needed[1]
    assert surctl_here(*command[1:], cwd=tmp_path).status == 0
    assert load_gains(str(tmp_path / "gains.toml"))["margin"] == float(needed[1])
    words = ("--vehicle", "mine.toml", "--scenario", "mission.toml", "--gains", "gains.toml")
    verified = surctl_here("verify", "m-norm-corrected", *words, cwd=tmp_path)
    assert f"ok   no contact in tank-static by sonar holds for obstacles at rest: margin {needed[1]} m" in verified.out


def test_gains_follow_from_the_vehicle_where_none_are_named(tmp_path):
    derived = surctl(
        "gains", "derive", "bluerov2-vonbenzon", "--cruise", 0.2, "--out", "g.toml", "--json", cwd=tmp_path
    )
    assert derived.status == 0 and derived.json["reached"] and derived.json["disk_margin"] >= 0.3
    assert load_gains(str(tmp_path / "g.toml")).values == derived.json["gains"]
    again = surctl("gains", "derive", "bluerov2-vonbenzon", "--cruise", 0.2, "--out", "g.toml", cwd=tmp_path)
    assert again.status == 2 and "already exists" in again.complaint
    words = ("simulate", "pool-ahead", "--vehicle", "bluerov2-vonbenzon", "--json")
    alone, named = (surctl(*words, *more, cwd=tmp_path).json["runs"][0] for more in ((), ("--gains", "g.toml")))
    assert alone["derived_gains"]["gains"] == derived.json["gains"] and named["derived_gains"] is None
    assert alone["time_s"] == named["time_s"] and alone["linear"]["disk_margin"] > 0.4
    assert 0 < alone["wasted_share"] < 1 and alone["variation_surge_n_per_s"] > 0


def test_simulate_says_that_the_hull_crabs_in_an_unstable_loop(tmp_path):
    fast_mission(tmp_path)
    words = ("simulate", "fast.toml", "--vehicle", "bluerov2-wu")
    bad = surctl(*words, "--gains", "default", cwd=tmp_path)
    assert re.search(r"reached at .* s, but crabbing \d+ deg", bad.out), bad.out
    assert re.search(r"linear loop at 0\.\d+ m/s is unstable", bad.out)
    good = surctl(*words, cwd=tmp_path)
    assert "gains derived from the vehicle bluerov2-wu at 0.47 m/s" in good.out and "but crabbing" not in good.out
    assert re.search(r"has a disk margin of 0\.\d+ at .* and a delay margin of 0\.\d+ s in sway at", good.out)
    assert "wasted" in good.out


def test_lint_takes_the_name_of_a_vehicle(tmp_path):
    done = surctl("lint", "sur540-flooded", cwd=tmp_path)
    assert done.status == 0 and done.out.startswith("sur540-flooded: nothing found\n")


@pytest.mark.parametrize(("vehicle", "status"), [("sur400", 0), ("sur540-flooded", 1)])
def test_lint_knows_which_hull_fits_the_pool(tmp_path, vehicle, status):
    done = surctl_here("lint", "pool-static", "--vehicle", vehicle, "--json", cwd=tmp_path)
    assert done.status == status
    errors = [f for f in done.json["findings"] if f["level"] == "error"]
    assert bool(errors) == bool(status)
    if errors:
        assert "0.020 m inside a wall at the start" in errors[0]["text"]


def test_a_run_that_starts_inside_a_wall_says_so(tmp_path):
    done = surctl("simulate", "pool-static", "--vehicle", "sur540-flooded", "--json", cwd=tmp_path)
    (warning,) = done.json["runs"][0]["start_warnings"]
    assert "0.020 m inside a wall at the start; this is no collision, because walls stop a run only" in warning
    assert -0.021 < done.json["runs"][0]["min_clearance_m"] <= -0.02


def test_explanations_name_who_gave_up_what_and_a_picture_is_drawn(tmp_path):
    words = ("simulate", "pool-behind", "--priority-mode", "projected", "--explain")
    done = surctl(*words, "--out", "plots", "--json", cwd=tmp_path)
    assert done.status == 0
    assert len(list((tmp_path / "plots").glob("*-projected-*.png"))) == 2
    told = done.json["runs"][0]["explanations"]
    assert told[0] == {"time_s": 0.0, "binding": [], "relaxed": [], "text": told[0]["text"]}
    assert "No limit binds" in told[0]["text"]
    late = told[1]
    assert late["time_s"] > 5.0 and late["binding"]
    assert f"because `{late['binding'][0]}`" in late["text"] and " m/s " in late["text"]

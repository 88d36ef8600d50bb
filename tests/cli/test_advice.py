"""Advice that quotes a key and a value is accepted as it is printed, and ends the finding."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from surctl.assessment import Line, assess
from surctl.marine.assessment import Mission
from surctl.marine.cli.study import changes, tunable
from surctl.marine.control import GAINS, load_gains, write_gains
from surctl.marine.simulation import load_scenario
from surctl.marine.tuning import derived_gains
from surctl.marine.vehicle import load_vehicle, write_vehicle
from tests.cli.process import surctl_here

MISSION = """kind = "scenario"
name = "m"
title = "A pillar beside the path"
provenance = "chosen"
vehicle = "v.toml"
path_m = [[4.0, 15.0], [50.0, 15.0]]
depth_m = -2.0
cruise_m_per_s = {cruise!r}
cap_m_per_s = {cap!r}
arrival_m = 0.02
time_limit_s = 600.0
[site]
length_m = 60.0
width_m = 30.0
depth_m = 6.0
[[obstacles]]
name = "pillar"
shape = "cylinder"
centre_m = [25.0, 20.0]
radius_m = 0.3
"""
STUDY = 'kind = "study"\nname = "s"\nvehicle = "v.toml"\ngains = "g.toml"\n[[runs]]\nscenario = "m.toml"\n'
QUOTED = re.compile(r"\b(?:set|add|with|or) ([A-Za-z_][\w.]*) = (\"[^\"]*\"|'[^']*'|[-+.\de]+)")
LARGEST = re.compile(r"write at most ([\d.e+-]+)")


def advice(finding: dict[str, str]) -> list[tuple[str, str]]:
    """The keys and values that a finding quotes."""
    quoted = [(found[1], found[2]) for found in QUOTED.finditer(finding["text"])]
    return quoted + [(finding["key"], found[1]) for found in LARGEST.finditer(finding["text"])]


def linted(folder: Path) -> list[dict[str, str]]:
    return surctl_here("lint", "s.toml", "--json", cwd=folder).json["findings"]


@pytest.mark.parametrize(
    ("name", "changed", "cruise", "cap", "expected"),
    [
        ("bluerov2-heavy", {"m11": 2.0, "m22": 2.5}, 0.3, 0.4, {"margin"}),
        ("bluerov2-wu", {}, 0.3, 3.0, {"k_psi", "k_r", "cap_m_per_s"}),
        ("lauv", {}, 0.5, 0.6, {"arrival_m"}),
    ],
)
def test_advice_is_accepted_as_it_is_printed(tmp_path, name, changed, cruise, cap, expected) -> None:
    vehicle = load_vehicle(name)
    vehicle = vehicle.with_values({key: vehicle[key] * factor for key, factor in changed.items()})
    gains = load_gains("default") if name == "bluerov2-wu" else derived_gains(vehicle, cruise=cruise)
    texts = {"v": write_vehicle(vehicle), "g": write_gains(gains), "m": MISSION.format(cruise=cruise, cap=cap)}
    for file, text in {**texts, "s": STUDY}.items():
        (tmp_path / f"{file}.toml").write_text(text)
    known, seen = linted(tmp_path), set()
    for finding in known:
        for key, value in advice(finding):
            seen.add(key)
            file = tmp_path / ("g.toml" if key in GAINS else "m.toml")
            text = file.read_text()
            line = f"{key} = {value}"
            changed_text, count = re.subn(rf"(?m)^{re.escape(key)} = .*$", lambda _, line=line: line, text)
            assert count == 1, (key, finding)
            file.write_text(changed_text)
            left = {(one["key"], one["text"][:40]) for one in linted(tmp_path)}
            assert (finding["key"], finding["text"][:40]) not in left, (key, value, finding, left)
            file.write_text(text)
    assert expected <= seen, known


@pytest.mark.parametrize("cruise", ["0.24", "0.4"])  # the second one is faster than any gains bear
def test_the_next_step_after_margins_that_are_too_small_gives_gains_that_have_them(tmp_path, cruise) -> None:
    words = ("verify", "m-norm-corrected", "--vehicle", "bluerov2-wu", "--json")
    failed = surctl_here(*words, "--gains", "default", "--cruise", cruise, cwd=tmp_path)
    first, *_ = failed.json["next"]
    assert failed.status == 1 and first.startswith("surctl gains derive bluerov2-wu --cruise ")
    assert surctl_here(*first.split()[1:], cwd=tmp_path).status == 0
    speed = first.split()[first.split().index("--cruise") + 1]
    passed = surctl_here(*words, "--gains", "gains.toml", "--cruise", speed, cwd=tmp_path)
    assert passed.status == 0 and (speed == cruise) is (cruise == "0.24")


@pytest.mark.parametrize(("vehicle", "cruise"), [("sur540-flooded", "0.15"), ("bluerov2-wu", "0.4")])
def test_the_next_derivation_replaces_the_gains_that_are_too_weak(tmp_path, vehicle: str, cruise: str) -> None:
    """Those of the first vehicle lack margin for no contact, and no gains bear the speed of the second one."""
    words = ("gains", "derive", vehicle, "--cruise", cruise, "--out", "mine.toml", "--json")
    first, *_ = surctl_here(*words, cwd=tmp_path).json["next"]
    again = surctl_here(*first.split()[1:], "--json", cwd=tmp_path)
    assert again.status == 0 and str(again.json["file"]) == "mine.toml", again.complaint
    assert load_gains(str(tmp_path / "mine.toml")).values == again.json["gains"]


def test_a_study_offers_what_changes_its_result() -> None:
    vehicle = load_vehicle("bluerov2-heavy")
    vehicle = vehicle.with_values({name: 2 * vehicle[name] for name in ("m11", "m22")})
    scenario = replace(load_scenario("tank-static"), cruise=0.3, cap=0.4)
    mission = Mission(vehicle, derived_gains(vehicle, cruise=0.3), 0.3, 0.4, scenarios=(scenario,))
    short = assess(mission, parts=["no contact"])
    [command] = changes(short, "v.toml", 0.3)
    margin = float(command.split()[command.split().index("--margin") + 1])
    wide = replace(mission, gains=mission.gains.with_values({"margin": margin}))
    assert short.passed is False and assess(wide, parts=["no contact"]).passed
    assert not tunable(short) and tunable(short.with_lines([Line(False, "margins")]))
    other = assess(replace(mission, law="closed_form"), parts=["no contact"])
    assert other.passed is None and tunable(other)  # the claim is not about this law
    assert changes(short, "v.toml", None) == changes(assess(wide, parts=["no contact"]), "v.toml", 0.3) == []


def test_a_value_that_a_text_quotes_has_its_unit() -> None:
    # a number stands alone only behind a key that ends with its unit
    quoting = re.compile(r"\b(?:set|add|write) (\w[\w.]*) = \{[^ }][^}]*\}")
    for source in Path("surctl").rglob("*.py"):
        for found in quoting.finditer(source.read_text()):
            assert found[1].endswith(("_m", "_s", "_n", "_deg", "kind")), (source, found[0])

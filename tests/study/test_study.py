import hashlib
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray

from surctl.assessment import assess
from surctl.certcheck.bundle import read_bundle
from surctl.errors import InputError
from surctl.marine.assessment import LoopAnalysis, unstable_text
from surctl.marine.cli.claims import library_claims
from surctl.marine.control import build_law, load_gains
from surctl.marine.simulation import LIBRARY as SCENARIOS
from surctl.marine.simulation import simulate
from surctl.marine.study import Study, load_plan
from surctl.marine.study.conduct import _speed_notes, assessed, claims_of, loops_of, notes_of, with_perception
from surctl.marine.vehicle import LIBRARY, load_vehicle
from surctl.marine.verification.linear import slowest_mode
from surctl.marine.verification.speeds import OverSpeeds
from surctl.study import conduct_parts
from tests.cli.process import surctl
from tests.report.data import swept
from tests.tools import need_compiler

OWN_LAW = Path(__file__).parents[2] / "analysis" / "27_own_law"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    need_compiler()
    return tmp_path_factory.mktemp("study")


WIDE = (SCENARIOS / "pool-behind.toml").read_text().replace('"pool-behind"', '"wide"') + "\n[sonar]\nbeam_deg = 25.0\n"

# a small part of the built-in study; `analysis/40_long_checks` conducts a larger one
MAIN = """kind = "study"
name = "main"
vehicle = "sur400"
cruise_m_per_s = [0.05, 0.15]
claims = ["v1-printed", "v1-corrected"]
[[runs]]
scenario = "pool-behind"
[sweep]
seeds = [0]
[[sweep.axes]]
gain = "lookahead"
values = [0.5, 0.8]
[[sweep.axes]]
gain = "k_v"
values = [1.5]
[[sweep.axes]]
gain = "margin"
values = [0.06]
"""


@pytest.fixture(scope="module")
def study(folder):
    """The main job; that a sweep goes on where it was killed is tested with the sweep."""
    (folder / "main.toml").write_text(MAIN)
    return surctl("study", "main.toml", "--json", cwd=folder)


def test_the_main_job_ends_well(study):
    assert study.status == 0
    data = study.json
    assert data["passed"]
    assert set(data) >= {"gains", "margins", "verdicts", "runs", "export", "report"}
    verdicts = [(v["claim"], v["verdict"], v["expected"]) for v in data["verdicts"]]
    assert verdicts == [("v1-printed", "refuted", "refuted"), ("v1-corrected", "proved", "proved")]
    assert {m["name"] for m in data["margins"]} >= {"surge", "sway", "heave", "yaw", "y"}
    assessment = data["assessment"]
    assert assessment["banner"] == "All that is assessed holds."
    figures = {name: figure["value"] for name, figure in assessment["figures"].items()}
    assert figures["disk_margin"] == data["linear"]["worst"]["disk_margin"]
    assert figures["region_m"] > 0 and figures["contact_margin_m"] >= 0


def test_runs_by_sonar_decide_and_those_with_true_positions_are_shown(study):
    runs = {(r["scenario"], r["sensing"]): r for r in study.json["runs"]}
    assert set(runs) == {("pool-behind", how) for how in ("truth", "sonar")}
    for (_, sensing), run in runs.items():
        assert run["decides"] == (sensing == "sonar")
        assert run["vehicle"] == "sur400"
        if run["decides"]:
            assert run["reached"]
            assert run["min_clearance_m"] > 0


def test_the_exported_law_senses_and_c_equals_python_over_every_flight_by_sonar(study, folder):
    data = study.json
    reports = data["export"]["sil"]
    assert data["export"]["sensing"] == "sonar"
    flown = [run for run in data["runs"] if run["sensing"] == "sonar"]
    assert [(r["scenario"], r["vehicle"]) for r in reports] == [(run["scenario"], run["vehicle"]) for run in flown]
    assert len(reports) == 1
    for report, run in zip(reports, flown, strict=True):
        assert report["passed"]
        assert max(report["tau"], report["state"], report["telemetry"]) == 0.0
        assert report["steps"] == pytest.approx(run["time_s"] / 0.05, abs=2)
        assert report["status_mismatches"] == 0
        assert report["fault_cases"] > 3 * 2304
        assert report["fault_failures"] == []
    header = (folder / "surctl-out" / "export" / "surctl_guarded.h").read_text()
    assert "double samples[4][5];" in header and re.search(r"_at_map_cells = \d+", header)
    steps = sum(report["steps"] for report in reports)
    (line,) = [note["text"] for note in data["assessment"]["lines"] if note["text"].startswith("export")]
    assert f"over {steps} steps of 1 run;" in line


def test_files_are_there_and_hash_as_told(study, folder):
    data = study.json
    for name, digest in data["export"]["sha256"].items():
        assert hashlib.sha256((folder / "surctl-out" / "export" / name).read_bytes()).hexdigest() == digest
    gains = load_gains(str(folder / data["gains"]["file"]))
    assert dict(gains.values) == data["gains"]["values"]
    assert "picked by a grid sweep" in gains.provenance


def test_the_bundle_has_the_evidence_of_the_study(study, folder):
    code = folder / "surctl-out" / "export"
    manifest, data = json.loads((code / "manifest.json").read_text()), study.json
    evidence, (report,) = manifest["evidence"], data["export"]["sil"]
    run = evidence["run"]
    assert (run["scenario"], run["vehicle"], run["sensing"], run["failure"]) == ("pool-behind", "sur400", "sonar", None)
    assert evidence["sil"] == {key: report[key] for key in evidence["sil"]} and "further_runs" not in evidence
    assert evidence["assessment"] == data["assessment"]
    assert "pool-behind by sur400, sonar, seed 0: arrived without contact." in (code / "README.md").read_text()
    assert read_bundle(code).wrong == ()


def test_the_report_stands_alone(study, folder):
    page = (folder / study.json["report"]).read_text()
    images = re.findall(r"<img[^>]*>", page)
    assert len(images) > 8
    assert all('src="data:image/' in image and "alt=" in image for image in images)
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page)
    assert "Replayed runs: 1: pool-behind by sur400." in page
    links = re.findall(r'href="#([^"]*)"', "".join(re.findall(r'<ul class="checks">(.*?)</ul>', page, re.DOTALL)))
    assert {"sweep", "margins", "claims", "runs-1", "export"} <= set(links)
    assert all(f'id="{link}"' in page for link in links)
    assert page.count(" data-player>") == 1
    for word in ("v1-printed", "delay margin", "sur400"):
        assert word in page


def test_the_cruise_speeds_of_the_study_are_those_of_its_sweep_its_summary_and_its_json(study, folder):
    data = study.json
    start = "margins at 0.05 and 0.15 m/s, worst corner: least delay"
    (speeds,) = [line for line in data["assessment"]["lines"] if line["text"].startswith(start)]
    told = data["linear"]["speeds"]
    assert speeds["passed"] is True and [row["cruise_m_per_s"] for row in told["at"]] == [0.05, 0.15]
    with xarray.open_dataset(folder / "surctl-out" / "sweep.nc") as table:
        picked = table.sel(
            {axis: data["gains"]["values"][axis] for axis in ("lookahead", "k_v", "margin")}, method="nearest"
        )
        assert float(picked["sensitivity_peak"]) == pytest.approx(told["worst"]["sensitivity_peak"]["value"])
        assert picked["disk_margin_at_m_per_s"].shape == ()


def test_sonars_that_the_law_cannot_hear_are_told_before_the_sweep(tmp_path):
    need_compiler()
    text = MAIN.replace("vehicle", 'law = "paper"\nvehicle')
    (tmp_path / "wide.toml").write_text(WIDE)
    (tmp_path / "s.toml").write_text(text.replace('"pool-behind"', '"wide.toml"'))
    with pytest.raises(InputError, match="four sonars of the paper"):
        conduct_parts(Study(plan=load_plan(str(tmp_path / "s.toml"))), tmp_path / "out")
    assert not (tmp_path / "out" / "sweep.nc").exists()


def test_the_built_in_plan():
    plan = load_plan()
    assert [leg.scenario.name for leg in plan.deciding] == [
        "tank-static-0.1",
        "tank-moving-0.1",
        "pool-ahead-0.15",
        "pool-behind",
    ]
    assert [case.name for case in plan.sweep_cases] == [
        "tank-static-0.1/sur540-flooded/truth",
        "tank-moving-0.1/sur540-flooded/truth",
        "pool-ahead-0.15/sur400/truth",
        "pool-behind/sur400/truth",
    ]


def test_a_study_names_its_guidance_and_all_that_it_flies_and_ships_has_it(tmp_path):
    (tmp_path / "s.toml").write_text('guidance = "alos"\n' + MAIN)
    plan = load_plan(str(tmp_path / "s.toml"))
    assert plan.guidance == "alos" and {case.guidance for case in plan.sweep_cases} == {"alos"}
    shipped = with_perception(plan, plan.deciding[0])
    assert shipped.guidance == "alos" and "drift" in {port.name for port in shipped.state.ports}
    (tmp_path / "s.toml").write_text(MAIN)
    assert load_plan(str(tmp_path / "s.toml")).guidance == "los"


def own_vehicle(tmp_path, source="sur540-light"):
    file = tmp_path / "my.toml"
    file.write_text((LIBRARY / f"{source}.toml").read_text().replace(f'"{source}"', '"my \\"boat\\""'))
    return file


def test_a_vehicle_file_flies_the_built_in_study_with_that_vehicle(tmp_path):
    plan = load_plan(str(own_vehicle(tmp_path)))
    assert {leg.vehicle.name for leg in plan.legs} == {'my "boat"'}
    assert [leg.scenario.name for leg in plan.deciding] == ["tank-static", "tank-moving"]
    misfits = {leg.scenario.name: leg.misfit for leg in plan.legs if leg.misfit}
    assert set(misfits) == {"pool-ahead", "pool-behind"}
    assert "0.020 m inside a wall at the start" in misfits["pool-ahead"]


@pytest.mark.parametrize("name", ["sur540-flooded", "girona500", "otter"])
def test_a_study_decides_the_claims_that_verify_decides(monkeypatch, name):
    monkeypatch.setattr(sys.modules[Study.__module__], "decide", lambda claim: claim)
    plan = load_plan(vehicle=name)
    fastest = plan.deciding[0].scenario
    decided, _ = claims_of(plan, plan.gains, fastest)
    at_hand = {**plan.gains.values, "speed": fastest.cruise, "speed_max": fastest.cap}
    chosen, _ = library_claims([], at_hand, plan.vehicle)
    assert [claim.name for claim in decided] == [claim.name for claim in chosen]
    assert ("braking-retreat" in {c.name for c in decided}) is (name == "sur540-flooded")


def test_a_study_without_a_sweep_has_its_own_gains_as_the_only_point(tmp_path):
    head = 'kind = "study"\nname = "small"\nvehicle = "sur400"\nruns = [{ scenario = "pool-behind" }]\n'
    (tmp_path / "s.toml").write_text(head)
    plan = load_plan(str(tmp_path / "s.toml"))
    assert plan.axes == () and len(plan.deciding) == 1
    [axis] = plan.grid
    assert axis.values == (plan.gains[axis.name],)
    done = surctl("lint", "s.toml", "--json", cwd=tmp_path)
    assert done.json["next"] == ["surctl study s.toml", "surctl tune s.toml"]


def test_other_vehicles_take_every_scenario_of_a_plan_that_they_fit():
    plan = load_plan().by([load_vehicle(name) for name in ("sur400", "sur540-flooded")])
    kept = [(leg.scenario.name, leg.vehicle.name) for leg in plan.deciding]
    assert [v for s, v in kept if s == "pool-ahead-0.15"] == ["sur400"]
    assert ("tank-static-0.1", "sur540-flooded") in kept
    assert all("wall" in (leg.left_out or "") for leg in plan.left_out)


def test_a_vehicle_that_fits_no_built_in_scenario_gets_missions_of_its_size(tmp_path):
    file = own_vehicle(tmp_path)
    file.write_text(file.read_text().replace("value = 0.27", "value = 2.6"))
    plan = load_plan(str(file))
    assert plan.deciding and all(leg.scenario.site[0] > 10 * 2.6 for leg in plan.deciding)


def test_a_study_may_name_a_goals_file(tmp_path):
    text = Path(load_plan().source).read_text()
    goals = """kind = "goals"
name = "mine"
[[goals]]
name = "arrives"
metric = "reached"
at_least = "1"
kind = "hard"
"""
    (tmp_path / "goals.toml").write_text(goals)
    head, mark, rest = text.partition("\n[[runs]]")
    (tmp_path / "s.toml").write_text(head.partition("\n[[goals]]")[0] + '\ngoals = "goals.toml"\n' + mark + rest)
    plan = load_plan(str(tmp_path / "s.toml"))
    assert [(g.name, g.limit, g.unit) for g in plan.goals] == [("arrives", 1.0, "1")]
    for said, problem in (('"absent.toml"', "absent.toml: no such file"), ('"defualt"', "did you mean 'default'")):
        (tmp_path / "t.toml").write_text(head + f"\ngoals = {said}\n" + mark + rest)
        with pytest.raises(InputError, match=problem):
            load_plan(str(tmp_path / "t.toml"))
    (tmp_path / "u.toml").write_text(head + "\ngoals = 3\n" + mark + rest)
    with pytest.raises(InputError, match=r"goals = 3: must be a list; write \[ \.\.\. \] around"):
        load_plan(str(tmp_path / "u.toml"))


@pytest.mark.parametrize(
    ("speeds", "told"),
    [
        ("[]", r"s.toml: cruise_m_per_s = \[\]: names no speed"),
        ("[0.1, -0.1]", "s.toml: cruise_m_per_s = -0.1: must be finite and greater than 0"),
        ("[0.1, 0.9]", "s.toml: cruise_m_per_s = 0.9: is above the cap, 0.22 m/s"),
    ],
)
def test_cruise_speeds_of_a_study_are_checked_when_it_is_read(tmp_path, speeds, told):
    text = MAIN.replace("[0.05, 0.15]", speeds)
    (tmp_path / "s.toml").write_text(text)
    with pytest.raises(InputError, match=told):
        load_plan(str(tmp_path / "s.toml"))
    (tmp_path / "s.toml").write_text(text.replace(speeds, "[0.15, 0.1]"))
    assert load_plan(str(tmp_path / "s.toml")).cruise == (0.1, 0.15)
    assert load_plan(str(tmp_path / "s.toml")).at_speeds([0.2, 0.05], key="--cruise").cruise == (0.05, 0.2)
    with pytest.raises(InputError, match=r"--cruise = 0\.9: is above the cap"):
        load_plan(str(tmp_path / "s.toml")).at_speeds([0.9], key="--cruise")
    with pytest.raises(InputError, match="--cruise: does not apply to law steered"):
        load_plan(vehicle="remus100").at_speeds([0.4], key="--cruise")


@pytest.mark.parametrize("speed", ["0.9", "0.0", "nan", "inf"])
def test_a_run_has_a_cruise_speed_of_its_own(tmp_path, speed):
    text = 'kind = "study"\nname = "s"\nvehicle = "sur400"\n[[runs]]\nscenario = "pool-behind"\ncruise_m_per_s = '
    (tmp_path / "s.toml").write_text(f"{text}{speed}\n")
    with pytest.raises(InputError, match=r"s.toml: runs.*cruise_m_per_s = "):
        load_plan(str(tmp_path / "s.toml"))
    (tmp_path / "s.toml").write_text(f"{text}0.1\n")
    mission = load_plan(str(tmp_path / "s.toml")).legs[0].scenario
    assert (mission.name, mission.cruise, mission.source, mission.paper.result) == ("pool-behind-0.1", 0.1, "", "")
    (tmp_path / "s.toml").write_text(f"{text}0.15\n")
    assert load_plan(str(tmp_path / "s.toml")).legs[0].scenario.name == "pool-behind"


def test_names_in_a_study_file_may_lie_beside_it(tmp_path):
    own_vehicle(tmp_path, "sur400")
    (tmp_path / "s.toml").write_text(MAIN.replace("sur400", "my.toml"))
    plan = load_plan(str(tmp_path / "s.toml"))
    assert plan.vehicle.name == 'my "boat"'


def test_an_unstable_loop_is_named_with_its_remedy():
    mode = slowest_mode(load_vehicle("bluerov2-wu"), load_gains("default").values, cruise=0.25, dt=0.05)
    text = unstable_text(mode)
    assert mode.loop == "yaw" and "dominant states psi" in text and "0.202 m/s or less" in text


@pytest.mark.parametrize(("delay", "disk", "short"), [(0.25, 0.4, ""), (0.19, 0.4, "0.2 s"), (0.25, 0.29, "0.3")])
def test_each_speed_of_a_study_needs_the_margins_that_the_largest_needs(delay, disk, short):
    figures = {"delay_margin_s": [0.3, delay], "disk_margin": [disk, 0.5], "slowest_pole_per_s": [-0.1, -0.2]}
    over = OverSpeeds((0.05, 0.1), {name: np.array(values) for name, values in figures.items()})
    [line] = _speed_notes(LoopAnalysis(0.1), over)
    assert line.passed is not bool(short) and line.text.endswith(f"(at least {short})") is bool(short)


def test_a_study_of_an_own_law_judges_nothing_of_another() -> None:
    need_compiler()
    plan = load_plan(str(OWN_LAW / "wall_study.toml"), trust=True)
    assessment = assess(assessed(plan, plan.gains), parts=["loop"])
    one = assessment.sources["loop"]
    assert one.mode is None and one.nominal.place.startswith("the steady motion at")
    over, loops = loops_of(plan, plan.gains, one)
    assert list(loops) == [one.nominal.place]
    run = simulate(plan.legs[0].scenario, plan.vehicle, gains=plan.gains, law=build_law(plan.law))
    table = swept({"k_wall": (0.2, 0.4)}, {"score": np.array([1.0, 2.0]), "feasible": np.ones(2)})
    notes = {note.about: note for note in [*assessment.lines, *notes_of(plan, table, one, over, (), [run])]}
    assert "disk margin 0.27" in notes["margins"].text and notes["margins"].passed is False  # at a corner
    assert notes["margins"].text.startswith("margins about the steady motion at ")
    assert "claims" not in notes


def test_a_study_that_names_no_gains_starts_from_those_of_its_vehicle() -> None:
    stated = load_gains("default").with_values({"margin": 0.065, "k_psi": 0.3})  # axes with a single value
    assert load_plan().gains == stated and load_plan().derivation is None
    plan = load_plan(str(LIBRARY / "bluerov2-vonbenzon.toml"))
    assert plan.gains.provenance.startswith("derived from the vehicle bluerov2-vonbenzon at 0.2 m/s")
    assert plan.derivation is not None and plan.derivation.reached
    scale = {name: plan.gains[name] / load_gains("default")[name] for name in ("lookahead", "k_v")}
    axes = {axis.name: axis.values for axis in plan.axes}
    assert axes["lookahead"] == pytest.approx([scale["lookahead"] * v for v in (0.5, 0.8, 1.2)], rel=0.01)
    assert axes["k_v"] == pytest.approx([scale["k_v"] * v for v in (1.0, 1.5, 2.0)], rel=0.01)
    assert load_plan().by([plan.vehicle]).gains == plan.gains, "surctl tune --vehicle starts there too"
    back = plan.by([load_vehicle("sur540-flooded")])
    assert back.gains == stated and back.axes == load_plan().axes

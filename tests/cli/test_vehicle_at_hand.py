"""Verdicts, remedies and next commands are about the vehicle, speed and scenario that were named."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from surctl.assessment import assess
from surctl.errors import InputError
from surctl.marine.assessment import Mission
from surctl.marine.cli.linear_part import linear_part as linear_side_of
from surctl.marine.cli.robot_options import DEFAULT_VEHICLE, at_hand, choose_vehicle, export_command
from surctl.marine.cli.runs import RunOutput, loop_lines_of_run
from surctl.marine.cli.verify import _speeds
from surctl.marine.control import build_law, load_gains
from surctl.marine.simulation import LIBRARY as SCENARIOS
from surctl.marine.simulation import load_scenario, simulate
from surctl.marine.simulation.explanation import failure
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification.speeds import check_held
from tests.cli.process import surctl
from tests.tools import need_compiler

GAINS = load_gains("default")
WU = load_vehicle("bluerov2-wu")


def test_a_claim_that_does_not_apply_has_its_own_word_and_costs_no_other_result(tmp_path: Path) -> None:
    words = ("verify", "braking-rule-ranges", "region-cruise-20", "braking-mass", "m-norm-corrected")
    done = surctl(*words, "--vehicle", "bluerov2-wu", "--gains", "default", "--cruise", "0.47", "--json", cwd=tmp_path)
    told = {c["claim"]: c for c in done.json["claims"]}
    assert done.status == 1 and told["m-norm-corrected"]["verdict"] == "proved"
    for name in words[1:4]:
        assert told[name]["verdict"] == "not applicable" and told[name]["certificate"] is None
        assert "m11 = 17 kg and m22 = 24.2 kg differ" in told[name]["because"]
    linear = done.json["linear"]
    assert (done.json["cruise_m_per_s"], linear["mode"]["stable"]) == (0.47, False)
    assert linear["mode"]["cause"].startswith("Munk") and 0.19 < linear["mode"]["bearable_m_per_s"] < 0.21
    assert not any("export" in command for command in done.json["next"])


def test_a_missing_vehicle_is_named_with_the_scenario_that_names_it() -> None:
    with pytest.raises(InputError, match=r"vehicle of scenario bay = 'skif\.toml': no such file; .*--vehicle"):
        choose_vehicle(None, ("bay", "skif.toml"))
    assert choose_vehicle("otter", ("bay", "skif.toml")).word == "otter"


def test_speeds_are_those_given_else_the_scenario_s() -> None:
    assert _speeds(None, None, None) == (0.15, 0.22)
    assert _speeds(None, None, "tank-speed-020") == (0.22, 0.22)  # a cap that leaves no claim about catching up
    cruise, cap = _speeds(1.0, None, None)
    assert cruise == 1.0 and cap == pytest.approx(0.22 / 0.15)
    assert _speeds(0.3, 0.5, "tank-static") == (0.3, 0.5)
    with pytest.raises(InputError, match=r"--cap = 0\.2: must not be below the cruise speed, 0\.3 m/s"):
        _speeds(0.3, 0.2, None)


def test_a_cruise_beyond_the_thrust_is_refused_if_asked_for_and_else_not_applicable() -> None:
    mission = Mission(WU, GAINS, cruise=3.0, cap=5.0)
    found = linear_side_of(assess(mission, parts=["loop"]), mission)
    assert found.stable is None and "not applicable to this vehicle, because a cruise at 3 m/s" in found.lines[0]
    with pytest.raises(InputError, match=r"--cruise = 3\.0: .*thrust"):
        check_held((3.0,), WU, cap=5.0, key="--cruise")


def test_the_proposed_export_names_everything_and_a_scenario_that_fits_the_hull(tmp_path: Path) -> None:
    options = "--gains default --law guarded --sensing sonar"
    assert export_command(None, "sur400", "default") == [
        f"surctl export --scenario pool-static --vehicle sur400 {options}"
    ]
    fitting = [f"surctl export --scenario tank-static --vehicle bluerov2-wu {options}"]
    assert export_command(None, "bluerov2-wu", "default") == fitting, "the hull touches a wall of the pool"
    assert export_command("tank-static", "bluerov2-wu", "default") == fitting
    assert export_command("pool-static", "bluerov2-wu", "default") == []
    form = Mission(WU, GAINS, cruise=0.1, cap=0.2, barrier="inertia", movers="barrier", guidance="ilos")
    [command] = export_command("tank-static", "bluerov2-wu", "default", form=form)
    assert command.endswith("--law guarded --guidance ilos --barrier inertia --movers barrier --sensing sonar")
    wide = tmp_path / "wide.toml"
    text = Path(WU.source).read_text()
    wide.write_text(text.replace(f"radius = {{ value = {WU['radius']:g}", "radius = { value = 3.2"))
    assert tomllib.loads(wide.read_text())["hull"]["radius"]["value"] == 3.2
    assert export_command(None, str(wide), "default") == []


@pytest.mark.parametrize(("typed", "word", "origin"), [("mine", "mine", "--vehicle"), (None, "sur400", "scenario s")])
def test_the_vehicle_typed_wins_over_the_scenario_s(typed: str | None, word: str, origin: str) -> None:
    assert choose_vehicle(typed, ("s", "sur400")) == (word, origin)
    assert choose_vehicle(typed) == ((word, origin) if typed else (DEFAULT_VEHICLE, "default"))


@pytest.mark.parametrize("words", [("verify", "m-norm-corrected", "--scenario"), ("simulate", "--law", "closed_form")])
def test_every_command_takes_the_vehicle_of_its_scenario_and_says_so(tmp_path: Path, words: tuple[str, ...]) -> None:
    done = surctl(*words, "pool-behind", cwd=tmp_path)
    assert "vehicle sur400 (from scenario pool-behind)" in done.out and "sur540-flooded" not in done.out
    if words[0] == "verify":
        return  # the vehicle typed wins in the same way
    done = surctl(*words, "pool-behind", "--vehicle", "bluerov2-vonbenzon", cwd=tmp_path)
    assert "vehicle bluerov2-vonbenzon (from --vehicle)" in done.out and "sur400" not in done.out


def test_a_replayed_run_that_collides_fails_in_one_line() -> None:
    mission = replace(load_scenario("pool-static"), time_limit=0.1)
    run = simulate(mission, load_vehicle("sur400"), gains=GAINS, law=build_law())
    assert failure(run) == "pool-static by sur400: it does not arrive (time limit at 0.05 s)"
    touching = replace(run, metrics=replace(run.metrics, reached=True, min_clearance_m=0.0))
    assert "the hull touches an obstacle or wall (clearance 0.000 m)" in (failure(touching) or "")
    assert failure(replace(run, metrics=replace(run.metrics, reached=True))) is None


def test_an_export_whose_replayed_run_fails_warns_and_exits_with_1(tmp_path: Path) -> None:
    need_compiler()
    text = (SCENARIOS / "pool-static.toml").read_text(encoding="utf-8")
    (tmp_path / "short.toml").write_text(re.sub(r"(?m)^time_limit_s = .*$", "time_limit_s = 1.0", text))
    words = ("export", "--scenario", "short.toml", "--law", "closed_form", "--sensing", "truth", "--out", "code")
    done = surctl(*words, cwd=tmp_path)
    [failed] = [line for line in done.out.splitlines() if "pool-static by sur400: it does not arrive" in line]
    assert done.status == 1 and "it does not arrive (time limit at " in failed
    assert "NOT accepted: Fails: pool-static by sur400, truth: time limit at " in done.out
    assert failed.endswith("see: surctl simulate short.toml --law closed_form") and "passed over" in done.out


def test_next_commands_carry_scenario_vehicle_and_gains() -> None:
    told = at_hand(load_scenario("tank-static"), WU, "g.toml")
    assert told == ["--scenario", "tank-static", "--vehicle", "bluerov2-wu", "--gains", "g.toml"]


def test_a_run_that_arrives_on_an_unstable_loop_says_so() -> None:
    mission = load_scenario("tank-static")
    fast = replace(mission, cruise=0.47, cap=0.6, time_limit=1.0)
    near, slow = (replace(mission, cruise=u, time_limit=0.5) for u in (0.2, 0.1))
    for scenario, stable, told in (
        (fast, False, "unstable"),
        (near, True, "unstable at mass +5%, drag"),
        (slow, True, ""),
    ):
        run = simulate(scenario, WU, gains=GAINS, law=build_law())
        result = run.to_dict()
        lines = loop_lines_of_run(run, result)
        assert result["linear"]["stable"] is stable and bool(lines) is bool(told) and told in "".join(lines)
    run = simulate(fast, WU, gains=GAINS, law=build_law())
    assert "the linear loop at 0.47 m/s is unstable" in loop_lines_of_run(run, {})[0]
    held = replace(run, law=build_law("calm"))
    result = {}
    assert loop_lines_of_run(held, result) == [] and result["linear"] is None  # calm has no linear loop


def test_a_run_says_which_echoes_hide_the_obstacles() -> None:
    mission = replace(load_scenario("tank-static"), time_limit=0.2)
    equipment = mission.sensors.equipment
    level = replace(mission.sensors, equipment=replace(equipment, array=replace(equipment.array, pitch=0.0)))
    diffuse = replace(mission, sensors=level.hearing("diffuse"))
    for scenario, sensing, hidden in ((diffuse, "sonar", 1), (diffuse, "truth", 0), (mission, "sonar", 0)):
        run = simulate(scenario, WU, gains=GAINS, law=build_law(sonar=sensing == "sonar"), sensing=sensing)
        ran = RunOutput().ran(run, run.to_dict())
        assert (
            sum("echoes of the water surface hide obstacles; sonar.pitch_deg" in line for line in ran.brief) == hidden
        )
        assert len(ran.data["echo_warnings"]) == hidden


def test_lint_tells_a_name_that_is_no_file_s_and_a_region_whose_cruise_is_its_cap(tmp_path: Path) -> None:
    text = Path(WU.source).read_text().replace('name = "bluerov2-wu"', 'name = "my/robot"')
    (tmp_path / "v.toml").write_text(text)
    (tmp_path / "r.toml").write_text('kind = "region"\nname = "mine"\ncruise_m_per_s = 0.3\n')
    done = surctl("lint", "v.toml", cwd=tmp_path)
    assert done.status == 2
    assert "v.toml: name = 'my/robot': cannot be part of a file name; remove / and \\" in done.complaint
    done = surctl("lint", "r.toml", "--json", cwd=tmp_path)
    [finding] = done.json["findings"]
    assert done.status == 1 and finding["key"] == "cruise_m_per_s" and "not below the cap of 0.22" in finding["text"]

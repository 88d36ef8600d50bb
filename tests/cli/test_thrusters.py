"""`surctl vehicle thrusters`, and failures of thrusters as options."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from surctl.errors import InputError
from surctl.marine.cli.sensor_options import parse_thruster_fault, split_faults
from surctl.marine.simulation import ThrusterFault
from surctl.marine.simulation.fit import held_share, thruster_findings
from surctl.marine.vehicle import load_vehicle
from tests.cli.process import surctl, surctl_here


def test_the_thrusters_and_an_allocation_are_printed(tmp_path):
    words = ("vehicle", "thrusters", "bluerov2-heavy", "--failed", "T2", "--force", "40", "40", "0", "5", "--json")
    found = surctl(*words, "--out", "pictures", cwd=tmp_path, drawn=True).json
    assert found["failed"] == ["T2"] and found["order"] == ["yaw", "force", "effort"]
    assert found["intervals"]["heave"] == pytest.approx([-138.0, 177.2])
    assert found["box_share"] == pytest.approx(0.61, abs=0.001)
    assert found["allocation"]["forces"]["T2"] == 0.0
    assert found["allocation"]["binding"] == {"force": ["T1", "T2"]}
    assert (tmp_path / found["file"]).stat().st_size > 10_000


def test_the_summary_has_the_values_of_each_axis_and_lint_the_limits_to_set(tmp_path):
    short = " ".join(surctl_here("vehicle", "thrusters", "bluerov2-heavy", cwd=tmp_path, SURCTL_VERBOSE="").out.split())
    assert re.search(r"on each axis, with 0 on the others: surge -[\d.]+ to [\d.]+ N, sway .* N, yaw .* N m", short)
    text = (Path(load_vehicle("bluerov2-thrusters").source)).read_text()
    (tmp_path / "mine.toml").write_text(text)
    vehicle = load_vehicle(str(tmp_path / "mine.toml"))
    for finding in thruster_findings(vehicle.with_values({"Fw_max": 1.2 * vehicle["Fw_max"]})):
        if finding.key == "thrust":
            limits = dict(re.findall(r'(F\w_max) = "([\d.]+) N', finding.text))
            assert set(limits) == {"Fu_max", "Fv_max", "Fw_max", "Fr_max"}
            assert held_share(vehicle.with_values({name: float(value) for name, value in limits.items()})) >= 1


def test_mistakes_are_one_line(tmp_path):
    assert "describes no thrusters" in surctl("vehicle", "thrusters", "sur400", cwd=tmp_path).complaint
    for option, more in (("--speed", ["1e300"]), ("--force", ["1e300", "0", "0", "0"])):
        assert f"{option} = " in surctl("vehicle", "thrusters", "remus100", option, *more, cwd=tmp_path).complaint
    words = ("simulate", "pool-behind", "--vehicle", "bluerov2-heavy", "--fault", "thruster:T9")
    assert "did you mean" in surctl(*words, cwd=tmp_path).complaint


def test_thruster_faults_are_read_beside_sensor_faults():
    texts, faults = split_faults(["dead:1", "thruster:T2:3:1.5", "thruster:T1"])
    assert texts == ("dead:1",)
    assert faults == [ThrusterFault("T2", 3.0, 1.5), ThrusterFault("T1")]
    assert [fault.to_dict()["duration_s"] for fault in faults] == [1.5, None]
    for wrong in ("thruster:", "thruster:T1:x", "thruster:T1:-1", "thruster:T1:1:0", "thruster:T1:1:2:3"):
        with pytest.raises(InputError, match=r"write thruster:NAME"):
            parse_thruster_fault(wrong)
    with pytest.raises(InputError, match="use surctl simulate"):
        split_faults(["thruster:T1"], refused="use surctl simulate")


def test_limits_beyond_the_attainable_set_are_found():
    heavy = load_vehicle("bluerov2-heavy")
    assert thruster_findings(heavy) == thruster_findings(load_vehicle("sur400")) == []
    alone, together = thruster_findings(heavy.with_values({"Fw_max": 150.0}))
    assert alone.key == "thrust.Fw_max" and "at most 138 N in heave" in alone.text
    assert together.key == "thrust" and "only 92% of" in together.text
    assert heavy.actuators is not None
    ahead = [
        one if abs(one.direction[2]) > 0.5 else replace(one, direction=(1.0, 0.0, 0.0))
        for one in heavy.actuators.thrusters
    ]
    (none,) = thruster_findings(replace(heavy, actuators=replace(heavy.actuators, thrusters=tuple(ahead))))
    assert none.key == "thrust.Fv_max" and none.text.startswith(
        "the thrusters give no force in sway without other forces"
    )
    assert none.text.endswith('but Fv_max is 40 N: set it to "0 N", or add or turn a thruster to give it')

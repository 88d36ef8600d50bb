"""`surctl verify --cruise` with several speeds."""

from surctl.assessment import assess
from surctl.marine.assessment import Mission
from surctl.marine.cli.linear_part import linear_part, over_speeds
from surctl.marine.control import load_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import cruise_loop
from surctl.verification.sampled_margins import SampledLoop
from tests.cli.process import surctl

GAINS = load_gains("default").values


def parts(vehicle, *speeds):
    missions = [Mission(load_vehicle(vehicle), load_gains("default"), u, max(speeds)) for u in speeds]
    return [linear_part(assess(mission, parts=["loop"]), mission) for mission in missions]


def test_every_speed_is_judged_and_the_worst_named():
    found = parts("sur400", 0.05, 0.22)
    over = over_speeds(found)
    assert over.stable and set(over.data["worst_cruise_m_per_s"].values()) == {0.05}
    assert [one["cruise_m_per_s"] for one in over.data["speeds"]] == [0.05, 0.22]
    for one in over.data["speeds"]:
        margins = SampledLoop(cruise_loop(load_vehicle("sur400"), GAINS, cruise=one["cruise_m_per_s"], dt=0.05)).margins
        assert one["margins"] == [m.to_dict() for m in margins]
    assert over.data["margins"] == found[-1].data["margins"] and over.lines[-len(found[-1].lines) :] == found[-1].lines
    assert [line.split(":")[0].strip() for line in over.lines[1:4]] == [
        "0.05 m/s",
        "0.22 m/s",
        "worst speed",
    ]
    # heave decides, which has nothing to do with the speed; what is off by rounding has no worst speed
    assert over.lines[3] == "  worst speed: delay margin at every speed, disk margin at every speed, S at every speed"
    assert over_speeds(found[:1]) is found[0], "one speed is what it was"


def test_a_loop_that_is_unstable_at_one_speed_fails_the_command(tmp_path):
    done = surctl(
        "verify",
        "m-norm-printed",
        "--vehicle",
        "bluerov2-wu",
        "--gains",
        "default",
        "--cruise",
        "0.1,0.47",
        "--json",
        cwd=tmp_path,
    )
    assert done.status == 1
    told = {one["cruise_m_per_s"]: one["stable"] for one in done.json["speeds"]}
    assert told == {0.1: True, 0.47: False} and done.json["cruise_m_per_s"] == 0.47
    assert done.json["worst_cruise_m_per_s"]["disk_margin"] == 0.47

"""Thrusters in vehicle files: reading, curves, the attainable set, and the mistakes that a file can hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog

from surctl.errors import InputError
from surctl.marine.allocation import allocate
from surctl.marine.simulation.fit import held_share, thruster_findings
from surctl.marine.vehicle import (
    LIBRARY,
    Actuators,
    MotionLog,
    Vehicle,
    attainable,
    identify,
    load_vehicle,
    write_vehicle,
)

NAMES = sorted(path.stem for path in LIBRARY.glob("*.toml") if "[[thruster]]" in path.read_text(encoding="utf-8"))


def _actuators(name: str) -> Actuators:
    actuators = load_vehicle(name).actuators
    assert actuators is not None
    return actuators


@pytest.mark.parametrize("name", NAMES)
def test_a_written_vehicle_has_the_same_thrusters(name: str, tmp_path: Path) -> None:
    vehicle = load_vehicle(name)
    path = tmp_path / "same.toml"
    path.write_text(write_vehicle(vehicle), encoding="utf-8")
    again = load_vehicle(str(path))
    assert again.actuators == vehicle.actuators
    assert again.digest() == vehicle.digest()


@pytest.mark.parametrize("name", NAMES)
def test_the_command_inverts_the_curve(name: str) -> None:
    for thruster in _actuators(name).thrusters:
        forces = np.linspace(-thruster.reverse, thruster.forward, 41)
        commands = [thruster.command(float(force)) for force in forces]
        assert [thruster.force(c) for c in commands] == pytest.approx(forces.tolist(), abs=1e-9)
        assert all(-1 <= command <= 1 for command in commands)
        assert thruster.command(0.0) == 0.0
        assert thruster.command(1e9) == 1.0


@pytest.mark.parametrize("name", NAMES)
def test_the_attainable_set_reaches_as_far_as_a_linear_programme(name: str) -> None:
    actuators, rng = _actuators(name), np.random.default_rng(0)
    forces = attainable(actuators)
    count = len(actuators.thrusters)
    for failed in ((), (0,), (count - 1,), (0, 1)):
        working = np.ones(count)
        working[list(failed)] = 0.0
        for direction in rng.normal(size=(4, 4)):
            reached = forces.extent(direction, working=working)
            assert reached == pytest.approx(_largest(actuators, direction, working), rel=1e-7, abs=1e-7)


def _largest(actuators: Actuators, direction: np.ndarray, working: np.ndarray) -> float:
    # largest s with B f = s direction within all limits
    B = actuators.matrix
    sides, bounds = [], []
    for thruster, where, on in zip(actuators.thrusters, actuators.slices, working, strict=True):
        normals, most = thruster.sides
        wide = np.zeros((len(normals), B.shape[1] + 1))
        wide[:, where] = normals
        sides.append(wide)
        bounds.append(on * most)
    found = linprog(
        np.append(np.zeros(B.shape[1]), -1.0),
        A_ub=np.vstack(sides),
        b_ub=np.concatenate(bounds),
        A_eq=np.column_stack([B, -direction]),
        b_eq=np.zeros(4),
        bounds=[(None, None)] * B.shape[1] + [(0, None)],
    )
    return float(-found.fun)


def test_the_inscribed_box_has_all_its_corners_in_the_set() -> None:
    for name in NAMES:
        vehicle = load_vehicle(name)
        if _actuators(name).fins:  # a rudder cannot turn the craft without pushing it aside
            continue
        forces = attainable(_actuators(name))
        share = forces.box_share(vehicle.thrust_limit)
        corners = np.array(np.meshgrid(*[[-1, 1]] * 4)).reshape(4, -1).T * vehicle.thrust_limit
        assert all(forces.contains(share * corner) for corner in corners), name
        assert not all(forces.contains(1.001 * share * corner) for corner in corners), name
        if vehicle["Fv_max"] == 0:  # surge and yaw share the propellers, and the allocation keeps yaw
            continue
        assert share >= 1.0, f"{name}: the limits of [thrust] exceed what the thrusters can do at once"


def test_a_vehicle_fitted_to_a_log_keeps_its_thrusters() -> None:
    vehicle, t = load_vehicle("bluerov2-heavy"), 0.1 * np.arange(60)
    motion = np.full((60, 8), np.nan)
    motion[:, 4] = 0.2 * (1 - np.cos(t))
    log = MotionLog(t, motion, np.column_stack([20 * np.sin(t), np.zeros((60, 3))]), "log.csv")
    assert identify(log, vehicle, name="fitted").vehicle.actuators == vehicle.actuators


def test_a_swivel_pushes_within_its_limit() -> None:
    for thruster in _actuators("sur540-jets").thrusters:
        assert np.linalg.norm(thruster.corners, axis=1) == pytest.approx(thruster.forward)
        normals, bounds = thruster.sides
        assert len(normals) == 8
        assert bounds == pytest.approx(thruster.forward * np.cos(np.pi / 8))


# ---------------------------------------------------------------- files

BASE = write_vehicle(replace(load_vehicle("bluerov2-vonbenzon"), actuators=None))
TABLE = {
    "name": '"T1"',
    "at_m": "[0.1, 0.2, 0.0]",
    "push": "[1.0, 0.0, 0.0]",
    "forward": '"40 N"',
    "reverse": '"30 N"',
    "provenance": '"a test"',
}


def _read(tmp_path: Path, *tables: dict[str, str], base: str = BASE, more: str = "") -> Vehicle:
    parts = ["\n".join(["[[thruster]]", *(f"{key} = {value}" for key, value in table.items())]) for table in tables]
    path = tmp_path / "robot.toml"
    path.write_text("\n\n".join([base, *parts, more]), encoding="utf-8")
    return load_vehicle(str(path))


@pytest.mark.parametrize(
    ("changes", "key", "says"),
    [
        ({"push": "[0.0, 0.0, 0.0]"}, "thruster.0.push", "has no direction"),
        ({"push": "[1.0, 1.0, 0.0]"}, "thruster.0.push", "has length 1.414"),
        ({"forward": '"0 N"'}, "thruster.0.forward", "gives no thrust"),
        ({"forward": "44.3"}, "thruster.0.forward", "must be a value with its unit"),
        ({"forward": '"4 m"'}, "thruster.0.forward", "N"),
        ({"reverse": '"-3 N"'}, "thruster.0.reverse", "must be at least 0"),
        ({"curve": "[[-1, -30], [0, 0], [0.5, 45], [1, 40]]"}, "thruster.0.curve", "is not monotone"),
        ({"curve": "[[-1, -30], [0, 0], [0.5, 40], [1, 40]]"}, "thruster.0.curve", "is flat at 40 N"),
        ({"curve": "[[-1, -30], [1, 40]]"}, "thruster.0.curve", "give 0 N at command 0"),
        ({"curve": "[[-1, -30], [0, 0], [1, 41]]"}, "thruster.0.forward", "the curve ends at 41 N"),
        ({"curve": "[[-1, -30], [0, 0], [1, 40]]", "dead_band": "0.1"}, "thruster.0.dead_band", "is 0 N up to"),
        ({"dead_band": "1.5"}, "thruster.0.dead_band", "less than 1"),
        ({"swivel": "{ axis = [0, 0, 1], range_deg = [-90, 90] }"}, "thruster.0.reverse", "must be 0 N with a swivel"),
        (
            {"swivel": "{ axis = [1, 0, 0], range_deg = [-90, 90] }", "reverse": '"0 N"'},
            "thruster.0.swivel.axis",
            "is not at right angles",
        ),
        (
            {"swivel": "{ axis = [0, 0, 1], range_deg = [-120, 120] }", "reverse": '"0 N"'},
            "thruster.0.swivel.range_deg",
            "up to 180 deg wide",
        ),
        ({"lag": '"0.1 s"'}, "thruster.0.lag", "differs from the lag"),
        ({"force": '"1 N"'}, "thruster.0.force", "unknown key"),
        ({"pusch": "[1.0, 0.0, 0.0]"}, "thruster.0.pusch", "did you mean 'push'"),
        ({"provenance": '""'}, "thruster.0.provenance", ""),
    ],
)
def test_a_mistake_is_one_line_with_its_place(changes: dict[str, str], key: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as raised:
        _read(tmp_path, TABLE | changes)
    line = str(raised.value)
    assert key in line and says in line and "robot.toml" in line and "\n" not in line


@pytest.mark.parametrize(
    ("order", "says"),
    [
        ('["yaw", "force"]', "must end with effort"),
        ('["yaw", "sway", "effort"]', "names surge in no level"),
        ('["yaw", "force", "surge", "effort"]', "names surge twice"),
        ('["turn", "force", "effort"]', "is not a level"),
    ],
)
def test_an_impossible_order_is_refused(order: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=says) as raised:
        _read(tmp_path, TABLE, more=f"[allocation]\norder = {order}\n")
    assert raised.value.key == "allocation.order"


def test_equal_names_and_an_allocation_without_thrusters_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="names two thrusters"):
        _read(tmp_path, TABLE, TABLE)
    with pytest.raises(InputError, match="needs thrusters"):
        _read(tmp_path, more='[allocation]\norder = ["yaw", "force", "effort"]\n')


def test_limits_and_lag_follow_from_the_thrusters(tmp_path: Path) -> None:
    base = BASE[: BASE.index("[thrust]")]
    c = np.sqrt(0.5)
    tables = [
        TABLE | {"name": f'"T{k}"', "at_m": f"[{x}, {y}, 0.0]", "push": f"[{p}, {q}, 0.0]", "lag": '"0.2 s"'}
        for k, (x, y, p, q) in enumerate([(1, 1, c, -c), (1, -1, c, c), (-1, 1, c, c), (-1, -1, c, -c)])
    ]
    tables.append(TABLE | {"name": '"V"', "at_m": "[0.0, 0.0, 0.0]", "push": "[0.0, 0.0, 1.0]", "lag": '"0.2 s"'})
    vehicle = _read(tmp_path, *tables, base=base)
    # 30 N each: the weaker direction in surge and heave; in sway and yaw, 40 N forward would leave a surge force
    assert vehicle["Fu_max"] == pytest.approx(4 * 30 * c)
    assert vehicle["Fv_max"] == pytest.approx(4 * 30 * c)
    assert vehicle["Fw_max"] == pytest.approx(30)
    assert vehicle["Fr_max"] == pytest.approx(4 * 30 * 2 * c)
    assert vehicle["thrust_lag"] == 0.2
    assert _read(tmp_path, *tables[:-1], base=base)["Fw_max"] == 0


SCREW = TABLE | {"name": '"screw"', "at_m": "[-1.0, 0.0, 0.0]"}
RUDDER = {
    "name": '"rudder"',
    "at_m": "[-1.05, 0.0, 0.0]",
    "push": "[0.0, 1.0, 0.0]",
    "fin": '{ lift = "75 N s^2/m^2", limit_deg = 30 }',
    "provenance": '"a test"',
}
LEFT, RIGHT = (
    TABLE | {"name": f'"{name}"', "at_m": f"[-0.6, {y}, 0.0]"} for name, y in (("left", 0.3), ("right", -0.3))
)
BARE = BASE[: BASE.index("[thrust]")]


def test_a_boat_has_the_limits_ahead_and_astern_of_its_propellers(tmp_path: Path) -> None:
    cat = _read(tmp_path, LEFT, RIGHT, base=BARE)
    assert (cat["Fu_max"], cat["Fu_reverse"]) == pytest.approx((80.0, 60.0))
    assert cat["Fr_max"] == pytest.approx(2 * 30 * 0.3)
    assert cat.actuators is not None and held_share(cat, ["left"]) == 0.0
    lost = allocate(cat.actuators, [50.0, 0.0, 0.0, 0.0], failed=["left"])
    assert lost.explain() == "`force` gave up 50 N because `left` failed."
    ahead_alone = cat.with_values({"Fu_max": 80.0})
    kept = {name: known for name, known in ahead_alone.parameters.items() if name != "Fu_reverse"}
    first = thruster_findings(replace(ahead_alone, parameters=kept))[0]
    assert first.key == "thrust.Fu_max" and first.text.endswith('but Fu_max is 80 N: add Fu_reverse = "60 N"')
    greedy = replace(ahead_alone, parameters=kept).with_values({"Fu_max": 500.0})
    remedy = 'but Fu_max is 500 N: lower it to 80 N, and add Fu_reverse = "60 N"'
    assert thruster_findings(greedy)[0].text.endswith(remedy)


@pytest.mark.parametrize(
    ("tables", "key", "says"),
    [
        (
            (SCREW | {"reverse": '"0 N"'}, RUDDER),
            "thruster.0.reverse",
            "screw leaves the craft no force astern.*give screw",
        ),
        ((LEFT | {"reverse": '"0 N"'}, RIGHT | {"reverse": '"0 N"'}), "thruster.0.reverse", "left .*give left a force"),
        (
            (SCREW, RUDDER | {"fin": '{ lift = "1e300 N s^2/m^2", limit_deg = 30 }'}),
            "thruster.1.fin.lift",
            "at most 1e",
        ),
        ((SCREW | {"forward": '"1e308 N"'}, RUDDER), "thruster.0.forward", "at most 1e"),
        ((SCREW | {"at_m": "[1e300, 0.0, 0.0]"}, RUDDER), "thruster.0.at_m", "within 1e"),
        ((SCREW,), "thruster.0.at_m", "screw gives no yaw moment; .*rudder at x != 0"),
        ((RUDDER,), "thruster", "no thruster pushes ahead; add a"),
        (
            (SCREW, RUDDER | {"at_m": "[0.0, 0.0, 0.0]"}),
            "thruster.1.at_m",
            "rudder gives no yaw moment; place rudder at x",
        ),
    ],
)
def test_thrusters_without_surge_or_yaw_are_named(
    tables: tuple[dict[str, str], ...], key: str, says: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=says) as raised:
        _read(tmp_path, *tables, base=BARE)
    assert raised.value.key == key


def test_numbers_in_another_unit_are_found(tmp_path: Path) -> None:
    blade = {"fin": '{ lift = "75 N s^2/m^2", limit_deg = 0.5236 }', "at_m": "[-1050.0, 0.0, 0.0]"}
    far, radians, *_ = thruster_findings(
        _read(tmp_path, SCREW | {"at_m": "[-0.7, 0.0, 0.0]"}, RUDDER | blade, base=BARE)
    )
    assert far.level == "warning" and far.key == "thruster.rudder.at_m" and "beyond 3 hull radii" in far.text
    assert radians.key == "thruster.rudder.fin.limit_deg" and "looks like radians: 30°?" in radians.text
    cat = _read(tmp_path, LEFT, RIGHT, base=BARE)
    light, *_ = thruster_findings(cat.with_values({"m44": 1e-4 * cat["m44"]}))  # kg cm^2
    assert light.key == "inertia.m44" and light.text.endswith("times m11 radius^2: check the units of these three")


def test_what_the_plant_leaves_out_is_said() -> None:
    jets, heavy = load_vehicle("sur540-jets"), load_vehicle("bluerov2-heavy")
    assert jets.actuators is not None
    for rate, count in ((1.0, 4), (6.0, 0)):  # a quarter turn in 1.6 s and in 0.26 s, and a lag of 0.3 s
        slowed = tuple(
            replace(one, swivel=replace(one.swivel, rate=rate)) for one in jets.actuators.thrusters if one.swivel
        )
        slow = thruster_findings(replace(jets, actuators=replace(jets.actuators, thrusters=slowed)))
        assert len(slow) == count
    tilting = load_vehicle("sur540-tilting")
    added = {name: value for name, value in tilting.parameters.items() if name not in heavy.parameters}
    (moment,) = thruster_findings(replace(heavy, parameters={**heavy.parameters, **added}))
    assert moment.level == "warning" and "roll and pitch moment of T" in moment.text
    assert thruster_findings(heavy) == []


@pytest.mark.parametrize("name", [r"two\nlines", r"a\tb"])
def test_a_vehicle_s_name_has_no_control_characters(name: str, tmp_path: Path) -> None:
    old = f'name = "{load_vehicle("bluerov2-vonbenzon").name}"'
    assert old in BASE
    with pytest.raises(InputError, match="is not a name") as raised:
        _read(tmp_path, base=BASE.replace(old, f'name = "{name}"'))
    assert raised.value.key == "name"

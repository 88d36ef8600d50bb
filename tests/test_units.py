from fractions import Fraction
from math import pi
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.files import Quantity, read_toml
from surctl.marine.control import load_gains
from surctl.marine.simulation import LIBRARY, load_scenario
from surctl.marine.vehicle import load_vehicle
from surctl.marine.vehicle.parameters import LIBRARY as VEHICLES
from surctl.units import converted_by_suffix, in_unit, number_and_unit


@pytest.mark.parametrize(
    ("text", "unit", "si"),
    [
        ("54 cm", "m", 0.54),
        ("15cm", "m", 0.15),
        ("12 kgf", "N", 117.6798),
        ("20 deg/s", "rad/s", 0.3490658503988659),
        ("2 min", "s", 120.0),
        ("-1.5e-1 m", "m", -0.15),
        ("1 knot", "m/s", 0.514444444444444444),
        ("60 N*s**2/m**2", "N s^2/m^2", 60.0),
        ("2000 g", "kg", 2.0),
    ],
)
def test_text_in_another_unit(text: str, unit: str, si: float) -> None:
    assert in_unit(*number_and_unit(text), unit) == pytest.approx(si, rel=1e-15)


@given(st.integers(-(10**6), 10**6))
def test_centimetres_are_the_nearest_number_of_metres(count: int) -> None:
    assert in_unit(float(count), "cm", "m") == float(Fraction(count, 100))


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_the_same_unit_changes_no_bit(value: float) -> None:
    assert in_unit(value, "N s^2/m^2", "N s^2/m^2") == value


def test_a_number_without_dimension_needs_no_unit() -> None:
    assert in_unit(1.0, "", "1") == 1.0 and in_unit(0.5, "1", "1") == 0.5
    with pytest.raises(InputError, match=r'give it in N m, for instance "0\.6 N m"'):
        in_unit(0.6, "Nm", "N m")
    with pytest.raises(InputError, match="is not a finite number; give a number in m"):
        in_unit(float("nan"), "", "m")
    with pytest.raises(InputError, match=r"has no unit; give it in m"):
        in_unit(1.0, "", "m")


@pytest.mark.parametrize("unit", ["rad", "deg", "mrad"])
def test_an_angle_is_no_share(unit: str) -> None:
    with pytest.raises(InputError, match="is an angle, not a share"):
        in_unit(0.05, unit, "1")
    assert in_unit(5.0, "%", "1") == 0.05 and in_unit(2.0, "1/s", "rad/s") == 2.0


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("0.54", "has no unit"),
        ("0.54 s", "wrong unit"),
        ("0.54 furlings", "is not a unit"),
        ("half a metre", "is not a number"),
        ("nan m", "is not a number"),
        ("inf m", "is not a number"),
        ("1 __import__('os')", "is not a unit"),
        ("1 m" + "*m" * 40, "is not a unit"),
        ("1 9**9**9**9 m", "is not a unit"),
        ("", "is not a number"),
    ],
)
def test_what_is_no_length_is_named(text: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem) as told:
        converted_by_suffix({"site": {"depth_m": text}})
    assert told.value.key == "site.depth_m"
    assert told.value.remedy


@pytest.mark.parametrize(
    ("key", "text", "value"),
    [
        *(("speed_m_per_s", "36 km/h", 10.0), ("rate_rad_per_s", "180 deg/s", pi), ("rise_n_per_s", "2 kN/s", 2e3)),
        *(("cone_deg", "0.5 turn", 180.0), ("yaw_rad", "90 deg", pi / 2), ("depth_m", "2 km", 2e3)),
        *(("limit_s", "3 ms", 3e-3), ("push_n", "5 mN", 5e-3)),
    ],
)
def test_the_ending_of_a_key_is_its_unit(key: str, text: str, value: float) -> None:
    assert converted_by_suffix({key: text})[key] == pytest.approx(value, rel=1e-15)


def test_only_keys_with_a_unit_are_read_so() -> None:
    table = {"name": "5 m", "path_m": [["1 m", 200.0], ["30 cm", "1e3 mm"]], "speeds": ["1 m"], "depth_m": -1}
    read = {"name": "5 m", "path_m": [[1.0, 200.0], [0.3, 1.0]], "speeds": ["1 m"], "depth_m": -1}
    assert converted_by_suffix(table) == read


def test_a_vehicle_in_the_units_of_its_data_sheets(tmp_path: Path) -> None:
    text = (VEHICLES / "sur540-flooded.toml").read_text()
    text = text.replace('radius = { value = 0.27, unit = "m" }', 'radius = "27 cm"')
    text = text.replace(
        'Fu_max = { value = 5.0, unit = "N", range = [4.25, 5.75] }',
        'Fu_max = { value = 500.0, unit = "gf", range = [425, 575] }',
    )
    file = tmp_path / "mine.toml"
    file.write_text(text)
    vehicle = load_vehicle(str(file))
    assert vehicle["radius"] == 0.27
    thrust = vehicle.parameters["Fu_max"]
    assert (thrust.value, thrust.unit) == (pytest.approx(4.903325), "N")
    assert thrust.range == pytest.approx((4.16782625, 5.63882375))


def test_gains_and_scenarios_too(tmp_path: Path) -> None:
    source = Path(load_gains("default").source).read_text()
    file = tmp_path / "gains.toml"
    file.write_text(source.replace('lookahead = { value = 0.8, unit = "m" }', 'lookahead = "80 cm"'))
    assert load_gains(str(file)).values == load_gains("default").values
    text = (LIBRARY / "tank-moving.toml").read_text()
    file = tmp_path / "tank.toml"
    file.write_text(text.replace("depth_m = -0.15", 'depth_m = "-15 cm"').replace("150.0", '"2.5 min"'))
    assert load_scenario(str(file)).depth == load_scenario("tank-moving").depth
    assert load_scenario(str(file)).time_limit == 150.0
    assert read_toml(file)["time_limit_s"] == 150.0


def test_a_quantity_keeps_what_is_known_of_it() -> None:
    long = Quantity(value=50.0, unit="cm", range=(40.0, 60.0), provenance="tape")
    assert long.within("m") == Quantity(value=0.5, unit="m", range=(0.4, 0.6), provenance="tape")
    assert long.within("cm") is long

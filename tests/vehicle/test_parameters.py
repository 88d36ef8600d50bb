"""Vehicle files: the five sets of equation (3), and every mistake a file can hold."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import load_gains, write_gains
from surctl.marine.vehicle import LIBRARY, PARAMETERS, SPECS, Vehicle, load_vehicle, write_vehicle
from surctl.marine.vehicle.parameters import vehicle_from_table

COLUMNS = (
    *("radius", "m11", "m22", "m33", "m44", "Xu", "Yv", "Zw", "Nr", "Xuu", "Yvv", "Zww", "Nrr"),
    *("Fu_max", "Fr_max", "thrust_lag"),
)
# one row a vehicle, in the order of COLUMNS; F_v and F_w have F_u's limit
GOLDEN = {
    "sur540-flooded": (0.27, 95, 95, 95, 1.5, 2, 2, 0, 0.3, 60, 60, 90, 1.0, 5, 0.5, 0.3),
    "sur540-light": (0.27, 49.05, 49.05, 49.05, 0.8, 2, 2, 0, 0.3, 60, 60, 90, 1.0, 5, 0.5, 0.3),
    "sur400": (0.20, 50, 50, 50, 0.6, 2, 2, 0, 0.2, 29.5, 29.5, 45, 0.6, 5, 0.5, 0.3),
    "bluerov2-vonbenzon": (
        *(None, 19.8567, 20.6206, 32.1863, 0.5915, 13.7, 0, 33, 0, 141, 217, 190, 1.5),
        *(40, 10, 0.3),
    ),
    "bluerov2-wu": (
        *(None, 17.0, 24.2, 26.07, 0.28, 4.03, 6.22, 5.18, 0.07, 18.18, 21.66, 36.99, 1.55),
        *(40, 10, 0.3),
    ),
}
RANGES = {
    "m11": (50, 125),
    "m22": (50, 125),
    "Xuu": (45, 115),
    "Yvv": (45, 115),
    "Nr": (0.05, 1),
    "Nrr": (0.2, 3),
    "m44": (0.4, 2.6),
}


@pytest.mark.parametrize("name", GOLDEN)
def test_built_in_numbers(name: str) -> None:
    vehicle = load_vehicle(name)
    assert vehicle.name == name
    for key, value in zip(COLUMNS, GOLDEN[name], strict=True):
        if value is not None:  # the source names no hull radius for the BlueROV2
            assert vehicle[key] == value, key
    assert vehicle["Fv_max"] == vehicle["Fw_max"] == vehicle["Fu_max"]


@pytest.mark.parametrize("name", sorted(path.stem for path in LIBRARY.glob("*.toml")))
def test_every_parameter_has_its_unit_and_a_provenance(name: str) -> None:
    vehicle = load_vehicle(name)
    assert vehicle.name == name
    assert list(vehicle.parameters) == [*PARAMETERS, *vehicle.form.terms]
    for key, parameter in vehicle.parameters.items():
        assert parameter.unit == SPECS[key].unit
        assert parameter.provenance.strip()


def test_uncertainty_of_the_default_vehicle() -> None:
    vehicle = load_vehicle("sur540-flooded")
    for key, expected in RANGES.items():
        assert vehicle.parameters[key].range == expected, key
    for key in ("Fu_max", "Fv_max", "Fw_max", "Fr_max"):
        nominal = vehicle[key]
        assert vehicle.parameters[key].range == pytest.approx((0.85 * nominal, 1.15 * nominal))


def test_vectors_are_in_the_order_u_v_w_r() -> None:
    vehicle = load_vehicle("bluerov2-wu")
    np.testing.assert_array_equal(vehicle.mass, [17.0, 24.2, 26.07, 0.28])
    np.testing.assert_array_equal(vehicle.linear_drag, [4.03, 6.22, 5.18, 0.07])
    np.testing.assert_array_equal(vehicle.quadratic_drag, [18.18, 21.66, 36.99, 1.55])
    np.testing.assert_array_equal(vehicle.thrust_limit, [40, 40, 40, 10])


def test_with_values_leaves_the_original_and_checks_the_new_numbers() -> None:
    vehicle = load_vehicle("sur540-flooded")
    heavy = vehicle.with_values({"m11": 120})
    assert (heavy["m11"], vehicle["m11"]) == (120, 95)
    with pytest.raises(InputError, match=r"inertia\.m11 = 200\.0: lies outside its own range"):
        vehicle.with_values({"m11": 200})
    with pytest.raises(InputError, match="no such vehicle parameter; did you mean 'm11'"):
        vehicle.with_values({"m1l": 80})
    for bad in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match=r"hull\.radius"):
            vehicle.with_values({"radius": bad})


def test_unknown_parameter_names_the_nearest() -> None:
    with pytest.raises(InputError, match="'Xuu'"):
        load_vehicle("sur400")["Xuuu"]


# --- mistakes in a file -------------------------------------------------------------------------------------------

TEXT = (LIBRARY / "sur540-flooded.toml").read_text(encoding="utf-8")
RADIUS = 'radius = { value = 0.27, unit = "m" }'
M11 = 'm11 = { value = 95.0, unit = "kg", range = [50, 125] }'


def _load(tmp_path: Path, text: str) -> Vehicle:
    path = tmp_path / "own.toml"
    path.write_text(text, encoding="utf-8")
    return load_vehicle(str(path))


def _edited(old: str, new: str) -> str:
    assert TEXT.count(old) == 1
    return TEXT.replace(old, new)


MISTAKES = {
    "missing key": (_edited(RADIUS, ""), "hull.radius", "is missing"),
    "wrong unit": (_edited(RADIUS, 'radius = { value = 27.0, unit = "s" }'), "hull.radius", "give it in m"),
    "no unit": (_edited(RADIUS, "radius = { value = 0.27 }"), "hull.radius", "unit"),
    "not a number": (_edited(RADIUS, "radius = nan"), "hull.radius", "is not a finite number"),
    "text for a number": (_edited(RADIUS, 'radius = "a foot"'), "hull.radius", "must be a value with its unit"),
    "bare number": (_edited(RADIUS, "radius = 0.27"), "hull.radius", "0.27"),
    "true for a number": (_edited(RADIUS, 'radius = { value = true, unit = "m" }'), "hull.radius", "True"),
    "negative mass": (_edited(M11, 'm11 = { value = -95.0, unit = "kg" }'), "inertia.m11", "greater than 0"),
    "no mass": (_edited(M11, 'm11 = { value = 0.0, unit = "kg" }'), "inertia.m11", "greater than 0"),
    "nan": (_edited(M11, 'm11 = { value = nan, unit = "kg" }'), "inertia.m11", "nan"),
    "inf": (_edited(M11, 'm11 = { value = inf, unit = "kg" }'), "inertia.m11", "inf"),
    "outside its range": (
        _edited(M11, 'm11 = { value = 95.0, unit = "kg", range = [96, 125] }'),
        "inertia.m11",
        "outside its own range [96, 125]",
    ),
    "range reversed": (
        _edited(M11, 'm11 = { value = 95.0, unit = "kg", range = [125, 50] }'),
        "inertia.m11.range",
        "is not a range",
    ),
    "range of inertia": (
        _edited(M11, f'{M11}\nm12 = {{ value = 0.0, unit = "kg", range = [-60, 40] }}'),
        "inertia.m12.range = -60.0",
        "below sqrt(m11 m22)",
    ),
    "range without end": (_edited(M11, 'm11 = { value = 95.0, unit = "kg", range = [50, inf] }'), "inertia.m11", "inf"),
    "unknown key": (_edited("m44 =", "m45 ="), "inertia.m45", "did you mean 'm44'?"),
    "number for a table": ("hull = 3\n" + re.sub(r"\[hull\](.|\n)*?\[", "[", TEXT, count=1), "hull", "must be a table"),
    "unknown table": (_edited("[hull]", "[hul]"), "hul", "did you mean 'hull'?"),
    "no provenance": (re.sub(r"provenance = .*\nm11", "m11", TEXT), "inertia.m11", "has no provenance"),
    "empty provenance": (
        _edited('provenance = "paper: diameter 540 mm"', 'provenance = " "'),
        "hull.provenance",
        "text",
    ),
    "negative drag": (_edited("Zw = { value = 0.0", "Zw = { value = -1.0"), "drag.Zw", "at least 0"),
    "negative lag": (_edited("thrust_lag = { value = 0.3", "thrust_lag = { value = -0.3"), "thrust.thrust_lag", "0"),
    "another kind": (_edited('kind = "vehicle"', 'kind = "gains"'), "kind", "is not a vehicle file"),
    "no name": (_edited('name = "sur540-flooded"', ""), "name", "is missing"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_in_a_file_is_one_line_with_file_key_and_remedy(tmp_path: Path, mistake: str) -> None:
    text, key, fragment = MISTAKES[mistake]
    with pytest.raises(InputError) as caught:
        _load(tmp_path, text)
    error, shown = caught.value, str(caught.value)
    assert shown.startswith(f"{tmp_path / 'own.toml'}: {key}")
    assert fragment in shown
    assert error.remedy
    assert "\n" not in shown


def test_one_message_names_all_wrong_entries_of_a_file(tmp_path: Path) -> None:
    wrong = write_vehicle(load_vehicle("sur400"))
    for key in ("m11", "Xu", "Fu_max"):
        wrong = re.sub(rf"(?m)^{key} = {{ value = ", f"{key} = {{ value = -", wrong)
    with pytest.raises(InputError, match=r"inertia\.m11 = -.* \(also wrong: drag\.Xu, thrust\.Fu_max\)"):
        _load(tmp_path, wrong)
    gains = write_gains(load_gains("default"))
    (tmp_path / "g.toml").write_text(re.sub(r"(?m)^(k1|k_v) = .*", r'\1 = "-1 1/s"', gains))
    with pytest.raises(InputError, match=r"gains\.k1 = -1\.0: .* \(also wrong: gains\.k_v\)"):
        load_gains(str(tmp_path / "g.toml"))


@pytest.mark.parametrize("name", PARAMETERS)
def test_both_ends_of_a_range_are_values_that_the_parameter_may_have(name: str) -> None:
    spec, base = PARAMETERS[name], load_vehicle("sur540-flooded")
    for low in (-1.0, 0.0):
        table = tomllib.loads(write_vehicle(base))
        table[spec.table][name] |= {"value": 1.0, "range": [low, 2.0]}
        if low == 0 and spec.zero_allowed:
            assert vehicle_from_table(table, source="v.toml").parameters[name].range == (low, 2.0)
            continue
        with pytest.raises(InputError, match=rf"v.toml: {spec.table}\.{name}\.range = {low}: must be {spec.bound}"):
            vehicle_from_table(table, source="v.toml")


@pytest.mark.parametrize("content", [b"", b"\x7fELF\x00\xff"], ids=["empty", "binary"])
def test_a_file_that_is_no_vehicle(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "own.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=re.escape(str(path))):
        load_vehicle(str(path))


def test_a_directory_and_an_unknown_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        load_vehicle(str(tmp_path))
    with pytest.raises(InputError, match="did you mean 'sur540-flooded'"):
        load_vehicle("sur540-floded")


def test_a_name_with_quotes_and_a_line_break_stays_one_line_in_messages(tmp_path: Path) -> None:
    vehicle = _load(tmp_path, _edited('name = "sur540-flooded"', r'name = "a\"b" # c'))
    assert vehicle.name == 'a"b'
    odd = _edited(RADIUS, r'radius = "a\"b\nc"')
    with pytest.raises(InputError) as caught:
        _load(tmp_path, odd)
    assert "\n" not in str(caught.value)


def test_zero_drag_lag_and_heave_may_be_left_out_or_zero(tmp_path: Path) -> None:
    text = re.sub(r"(Zw|thrust_lag) = .*\n?", "", TEXT)
    vehicle = _load(tmp_path, text)
    assert (vehicle["Zw"], vehicle["thrust_lag"]) == (0.0, 0.3)
    assert vehicle.parameters["Zw"].provenance == "default of this toolkit"
    still = _edited('thrust_lag = { value = 0.3, unit = "s" }', 'thrust_lag = { value = 0.0, unit = "s" }')
    assert _load(tmp_path, still)["thrust_lag"] == 0.0


def test_a_provenance_on_one_line_overrides_that_of_the_table(tmp_path: Path) -> None:
    own = 'radius = { value = 0.27, unit = "m", provenance = "measured" }'
    vehicle = _load(tmp_path, _edited(RADIUS, own))
    assert vehicle.parameters["radius"].provenance == "measured"
    assert vehicle.parameters["m11"].provenance.startswith("derived")

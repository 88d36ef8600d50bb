"""Vehicles from Gazebo models: the numbers of the file in surctl's signs."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from surctl.cli.app import app
from surctl.errors import InputError
from surctl.marine.vehicle import load_vehicle, write_vehicle
from surctl.marine.vehicle.gazebo import gazebo_vehicle
from surctl.marine.vehicle.parameters import LIBRARY
from surctl.marine.vehicle.specs import undamped

GIVEN = {"radius": 0.25, "thrust": 40.0, "yaw_thrust": 5.0}
SDF = """<?xml version="1.0"?>
<sdf version="1.9"><model name="auv"><link name="base">
<inertial><mass>10.5</mass><inertia><ixx>0.1</ixx><izz>0.3</izz></inertia>
<fluid_added_mass><xx>5</xx><yy>7</yy><zz>8</zz><rr>0.2</rr><yr>0.4</yr></fluid_added_mass></inertial></link>
<plugin filename="gz-sim-hydrodynamics-system" name="gz::sim::systems::Hydrodynamics"><link_name>base</link_name>
<xU>-4</xU><xUabsU>-20</xUabsU><yV>-5</yV><yVV>-30</yVV><zW>0</zW><zWabsW>-40</zWabsW><nR>-0.1</nR><nRabsR>-1</nRabsR>
<yR>-0.5</yR><kP>-3</kP></plugin></model></sdf>"""
UUV = """<?xml version="1.0"?>
<robot name="rexrov">
<link name="r/base_link"><inertial><mass value="1862.87"/>
<inertia ixx="525" ixy="0" ixz="0" iyy="794" iyz="0" izz="691.23"/></inertial></link>
<gazebo><plugin name="uuv" filename="libuuv_underwater_object_ros_plugin.so"><fluid_density>1028.0</fluid_density>
<link name="r/base_link"><neutrally_buoyant>0</neutrally_buoyant><volume>1.86287</volume>
<hydrodynamic_model><type>fossen</type><added_mass>
779.79 -6.8773 -103.32 8.5426 -165.54 -7.8033
-6.8773 1222 51.29 409.44 -5.8488 62.726
-103.32 51.29 3659.9 6.1112 -386.42 10.774
8.5426 409.44 6.1112 534.9 -10.027 21.019
-165.54 -5.8488 -386.42 -10.027 842.69 -1.1162
-7.8033 62.726 10.775 21.019 -1.1162 224.32</added_mass>
<linear_damping>-74.82 -69.48 -728.4 -268.8 -309.77 -105</linear_damping>
<quadratic_damping>-748.22 -992.53 -1821.01 -672 -774.44 -523.27</quadratic_damping>
</hydrodynamic_model></link></plugin></gazebo>
</robot>"""


def test_hydrodynamics_of_gz_sim(tmp_path: Path) -> None:
    (tmp_path / "model.sdf").write_text(SDF)
    auv = gazebo_vehicle(tmp_path / "model.sdf", "auv", sway_thrust=30.0, **GIVEN)
    assert auv.mass.tolist() == [15.5, 17.5, 18.5, 0.5]
    assert auv.linear_drag.tolist() == [4.0, 5.0, 0.0, 0.1] and auv.quadratic_drag.tolist() == [20.0, 30.0, 40.0, 1.0]
    assert auv.form.terms == ("m24", "Yr") and (auv["m24"], auv["Yr"]) == (0.4, 0.5)
    assert auv.thrust_limit.tolist() == [40.0, 30.0, 40.0, 5.0]
    (tmp_path / "auv.toml").write_text(write_vehicle(auv))
    assert load_vehicle(str(tmp_path / "auv.toml")).digest() == auv.digest()


def test_an_axis_with_thrust_and_no_drag_is_said(tmp_path: Path) -> None:
    (tmp_path / "model.sdf").write_text(re.sub(r"<[xn]U?R?(abs)?[UR]+>-\d+(\.\d)?</[^>]*>", "", SDF))
    auv = gazebo_vehicle(tmp_path / "model.sdf", "auv", **GIVEN)
    assert auv.note.endswith("omitted; no drag found in surge, yaw")
    (tmp_path / "auv.toml").write_text(write_vehicle(auv))
    result = CliRunner().invoke(app, ["lint", str(tmp_path / "auv.toml")])
    assert [line.partition(": no drag")[0] for line in result.output.splitlines()[:2]] == [
        "warning: drag (surge)",
        "warning: drag (yaw)",
    ]
    library = [load_vehicle(file.stem) for file in LIBRARY.glob("*.toml") if "thrusters" not in file.stem]
    assert not any(undamped({k: p.value for k, p in craft.parameters.items()}) for craft in library)


def test_hydrodynamics_of_uuv_simulator(tmp_path: Path) -> None:
    (tmp_path / "rexrov.urdf").write_text(UUV)
    rov = gazebo_vehicle(tmp_path / "rexrov.urdf", "rexrov", **GIVEN)
    assert rov.mass == pytest.approx([1862.87 + 779.79, 1862.87 + 1222, 1862.87 + 3659.9, 691.23 + 224.32])
    assert rov["m24"] == pytest.approx(62.726) and rov["Zw"] == 728.4 and rov["Nrr"] == 523.27
    assert rov["Z0"] == pytest.approx(9.81 * (1028 * 1.86287 - 1862.87))
    (tmp_path / "neutral.urdf").write_text(UUV.replace("<neutrally_buoyant>0", "<neutrally_buoyant>1"))
    assert "Z0" not in gazebo_vehicle(tmp_path / "neutral.urdf", "rexrov", **GIVEN).parameters


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        (
            ("<xU>-4", "<xU>4"),
            r"Xu = -4.0: must be at least 0; linear drag in surge, in N s/m; a hydrodynamic derivative",
        ),
        (("<xx>5", "<xx>-5"), "axis u = -5.0: would be an added mass below 0"),
        (("<mass>10.5</mass>", ""), "base.mass: is missing"),
        (("<mass>10.5</mass>", "<mass>-2</mass>"), "base.mass = -2.0: is not positive"),
        (("<xU>-4", "<xU>${drag}"), "xU = '\\$\\{drag\\}': is not a number"),
        (("</sdf>", ""), "is not XML"),
        (("<sdf", "<!DOCTYPE sdf><sdf"), "declares a document type"),
    ],
)
def test_models_that_cannot_be_used(change: tuple[str, str], fragment: str, tmp_path: Path) -> None:
    (tmp_path / "model.sdf").write_text(SDF.replace(*change))
    with pytest.raises(InputError, match=fragment) as caught:
        gazebo_vehicle(tmp_path / "model.sdf", "auv", **GIVEN)
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="no such file"):
        gazebo_vehicle(tmp_path / "gone.sdf", "auv", **GIVEN)
    with pytest.raises(InputError, match="is not a file"):  # a device may never end
        gazebo_vehicle(Path("/dev/null"), "auv", **GIVEN)


def test_the_link_is_chosen(tmp_path: Path) -> None:
    two = SDF.replace("</model>", SDF[SDF.index("<link") : SDF.index("</model>")].replace("base", "arm") + "</model>")
    (tmp_path / "model.sdf").write_text(two)
    with pytest.raises(InputError, match="choose --link: arm, base"):
        gazebo_vehicle(tmp_path / "model.sdf", "auv", **GIVEN)
    with pytest.raises(InputError, match=r"--link = 'bas'.*did you mean 'base'"):
        gazebo_vehicle(tmp_path / "model.sdf", "auv", link="bas", **GIVEN)
    assert gazebo_vehicle(tmp_path / "model.sdf", "auv", link="arm", **GIVEN)["m11"] == 15.5


@pytest.mark.parametrize("seed", range(6))
def test_every_coupling_of_a_model_is_taken_or_named(seed: int, tmp_path: Path) -> None:
    """Drawn coefficients: the drag of the vehicle at drawn velocities is that of the model's own sum."""
    rng = np.random.default_rng(seed)
    axes, forces = "UVWR", "xyzn"
    linear = {(i, j): -rng.uniform(0.1, 9) for i in range(4) for j in range(4) if i == j or rng.random() < 0.3}
    quadratic = {
        (i, j, k): -rng.uniform(0.1, 9)
        for i in range(4) for j in range(4) for k in range(4)
        if i == j == k or rng.random() < 0.2
    }  # fmt: skip
    entries = "".join(f"<{forces[i]}{axes[j]}>{v!r}</{forces[i]}{axes[j]}>" for (i, j), v in linear.items())
    for (i, j, k), v in quadratic.items():
        name = f"{forces[i]}{axes[j]}abs{axes[k]}"
        entries += f"<{name}>{v!r}</{name}>"
    plugin = SDF[SDF.index("<xU>") : SDF.index("</plugin>")]
    (tmp_path / "model.sdf").write_text(SDF.replace(plugin, entries + "<xUV>-2</xUV><yWU>0</yWU>"))
    auv = gazebo_vehicle(tmp_path / "model.sdf", "auv", **GIVEN)
    assert auv.note.endswith("; not used: xUV = -2")
    letters, signs = "uvwr", "XYZN"
    for nu in rng.normal(size=(5, 4)):
        force = np.zeros(4)
        for (i, j), v in linear.items():
            force[i] += v * nu[j]
        for (i, j, k), v in quadratic.items():
            force[i] += v * abs(nu[k]) * nu[j]
        own = np.zeros(4)
        for name, parameter in auv.parameters.items():
            if name[0] in signs and set(name[1:]) <= set(letters):
                factor = np.prod([nu[letters.index(c)] if n == len(name) - 2 else abs(nu[letters.index(c)])
                                  for n, c in enumerate(name[1:])])  # fmt: skip
                own[signs.index(name[0])] -= parameter.value * factor
        np.testing.assert_allclose(own, force, rtol=1e-12)


@pytest.mark.parametrize("encoding", ["iso-8859-1", "utf-16"])
def test_a_model_of_another_encoding_is_read(encoding: str, tmp_path: Path) -> None:
    text = SDF.replace('"1.0"?>', f'"1.0" encoding="{encoding}"?><!-- Bøye -->', 1)
    (tmp_path / "model.sdf").write_bytes(text.encode(encoding))
    assert gazebo_vehicle(tmp_path / "model.sdf", "auv", **GIVEN)["m11"] == 15.5


def test_what_uuv_simulator_adds_is_named(tmp_path: Path) -> None:
    more = "<linear_damping_forward_speed>-8 0 0 0 0 0</linear_damping_forward_speed><offset>0.0</offset>"
    (tmp_path / "robot.urdf").write_text(UUV.replace("</hydrodynamic_model>", more + "</hydrodynamic_model>"))
    note = gazebo_vehicle(tmp_path / "robot.urdf", "auv", **GIVEN).note
    assert note.endswith("not used: linear_damping_forward_speed = -8 0 0 0 0 0")


def test_the_mass_of_other_links_is_named_as_not_used(tmp_path: Path) -> None:
    """A simulator adds the masses of the links of the thrusters; without them, net buoyancy is too large."""
    links = "".join(f'<link name="t{k}"><inertial><mass value="1.5"/></inertial></link>' for k in range(8))
    (tmp_path / "model.urdf").write_text(UUV.replace("<gazebo>", f"{links}<gazebo>"))
    note = gazebo_vehicle(tmp_path / "model.urdf", "rov", **GIVEN).note
    assert note.endswith("; not used: the mass of the other links, 12 kg")
    (tmp_path / "model.urdf").write_text(UUV)
    assert "not used" not in gazebo_vehicle(tmp_path / "model.urdf", "rov", **GIVEN).note

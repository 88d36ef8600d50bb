"""The ROS 2 package, built by CMake and run against stand-ins for rclcpp, ament and the messages."""

from __future__ import annotations

import json
import re
import runpy
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pytest

from surctl.export import Bundle, write_bundle
from surctl.export.guard_text import example_values
from surctl.ir import Layout, Port
from surctl.marine.export import build_bundle
from tests.export.clocks import clocks
from tests.export.standin import StandIn, Vector
from tests.export.test_gains_in_c import guarded
from tests.tools import need, need_compiler

STUB = Path(__file__).parent / "stubs/ros2"
HEADERS = {
    "rclcpp": ["rclcpp"],
    "diagnostic_msgs": ["diagnostic_array"],
    "geometry_msgs": ["point_stamped", "wrench_stamped"],
    "nav_msgs": ["odometry"],
    "rcl_interfaces": ["floating_point_range", "parameter_descriptor", "set_parameters_result"],
    "sensor_msgs": ["imu", "range"],
    "std_msgs": ["bool", "float64_multi_array", "int32"],
}
"""The headers that the packages of ROS 2 have."""


def packages(folder: Path) -> Path:
    """Packages that CMake finds, each with its headers and targets; ament installs nothing."""
    for package, headers in HEADERS.items():
        place = folder / "include" / package / ("" if package == "rclcpp" else "msg")
        place.mkdir(parents=True)
        for header in headers:
            stub = "rclcpp" if package == "rclcpp" else "messages"
            (place / f"{header}.hpp").write_text(f'#pragma once\n#include "{STUB}/{stub}.hpp"\n')
        where = folder / "cmake"
        where.mkdir(exist_ok=True)
        text = f"add_library({package}::all INTERFACE IMPORTED)\n"
        text += f'target_include_directories({package}::all INTERFACE "{folder}/include")\n'
        text += "add_library(rclcpp::rclcpp ALIAS rclcpp::all)\n" if package == "rclcpp" else ""
        (where / f"{package}-config.cmake").write_text(text + f"set({package}_TARGETS {package}::all)\n")
    (folder / "cmake/ament_cmake-config.cmake").write_text("function(ament_package)\nendfunction()\n")
    return folder / "cmake"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bundle, with its node built in `build`; without a warning."""
    need_compiler()
    at = tmp_path_factory.mktemp("ros2")
    write_bundle(guarded()[1], at / "b")
    found = packages(at / "stubs")
    configure = [need("cmake"), "-S", str(at / "b/ros2"), "-B", str(at / "build"), "-DCMAKE_BUILD_TYPE=None"]
    configure += [f"-DCMAKE_PREFIX_PATH={found}", *(f"-D{name}_DIR={found}" for name in (*HEADERS, "ament_cmake"))]
    configure += ["-DCMAKE_CXX_FLAGS=-Werror", "-DCMAKE_CXX_COMPILER_WORKS=1", "-DCMAKE_C_COMPILER_WORKS=1"]
    for command in (configure, ["cmake", "--build", str(at / "build"), "--parallel", "2"]):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    return at


def run(folder: Path, script: list[str], *, before: tuple[str, ...] = ("armed 0", "time 0.05")) -> list[str]:
    """Run the node; `before` is one period in which the operator's side says that it is disarmed."""
    done = subprocess.run(
        [folder / "build/controller_node"],
        input="\n".join([*before, *script]),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def of(lines: list[str], topic: str) -> list[list[float]]:
    rows = [line.split() for line in lines if line.startswith(f"{topic} ")]
    return [[float(word) for word in row[2 if topic == "wrench" else 1 :]] for row in rows]


def odometry(u: Vector, *, at: float = 0.0) -> str:
    *before, rate = u.tolist()[:8]
    return f"odometry {at} {' '.join(map(repr, before))} 0 0 {rate!r}"


def period(u: Vector) -> list[str]:
    contacts = " ".join(map(repr, u[8:].tolist()))
    return ["armed 1", odometry(u), f"contacts {contacts}", "time 0.05"]


def ahead(k: int) -> Vector:
    return guarded()[0].inputs.pack(
        {
            "eta": [1.0 + 0.005 * k, 0.8, -0.15, 0.0],
            "nu": [0.05, 0.01, -0.02, 0.1],
            "contacts": [[2.0, 0.9, 0.1, 0, 0, 1]],
        }
    )


def test_the_node_commands_as_python_to_the_last_bit_in_the_frames_of_rep_103(folder: Path) -> None:
    law, _, p = guarded()
    lines = run(folder, [line for k in range(40) for line in period(ahead(k))])
    x, expected = law.initial_state(), []
    for k in range(40):
        step = law.step(x, ahead(k), p)
        x = step.x_next
        tau = step.tau if k >= 19 else np.zeros(4)
        expected.append([*tau[:3], 0.0, 0.0, tau[3]])
    assert of(lines, "wrench") == [[0.0] * 6, [0.0] * 6, *expected]  # zero before the first period, and disarmed
    assert of(lines, "status")[1] == [law.step(law.initial_state(), ahead(0), p).status]
    assert [line.split()[1] for line in lines if line.startswith("wrench ")] == ["base_link"] * 42
    told = [line for line in lines if line.startswith("/diagnostics ")]
    assert len(told) == 2 and "/controller: surctl_closed_form|RUNNING, " in told[1] and guarded()[1].id in told[1]


def test_headings_are_counter_clockwise_from_the_x_axis(folder: Path) -> None:
    law, _, p = guarded()
    for yaw in (0.3, -2.9):
        u = ahead(0)
        u[3] = yaw
        lines = run(folder, [line for _ in range(20) for line in period(u)])
        x = law.initial_state()
        for _ in range(20):
            step = law.step(x, u, p)
            x = step.x_next
        found = np.array(of(lines, "wrench")[-1])[[0, 1, 2, 5]]
        assert np.abs(found - step.tau).max() < 1e-9 and np.abs(step.tau).max() > 0.01


def test_armed_messages_from_before_the_start_arm_nothing(folder: Path) -> None:
    script = [line for k in range(30) for line in period(ahead(k))]
    assert not np.any(of(run(folder, script, before=()), "wrench"))
    assert np.any(of(run(folder, [*script[:16], "armed 0", "time 0.05", *script]), "wrench"))


def test_old_missing_and_wrong_messages_make_no_sample(folder: Path) -> None:
    running = [line for k in range(25) for line in period(ahead(k))]
    good = odometry(ahead(25))
    for extra, expected in (
        ([], 0),
        (["time 0.05"], -4),  # no odometry
        ([good.replace("odometry 0.0", "odometry 99.0"), "time 0.05"], -4),  # stamped long ago
        ([good, "time 0.05"], 0),
        ([good, "late 0.15"], 0),
        ([good.replace("odometry 0.0 1.125", "odometry 0.0 1e9"), "time 0.05"], -3),
        ([odometry(np.array([*ahead(25)[:3], 9999.0, *ahead(25)[4:]])), "time 0.05"], -2),  # a quaternion of zeros
        (["late 0.6", good, "time 0.05"], -4),  # the obstacles are older than input_timeout
        (["contacts 1 2 3", good, "time 0.05"], 0),  # not a row of six: ignored, the last ones stay
    ):
        lines = run(folder, [*running, *extra])
        (status,) = of(lines, "status")[-1]
        assert status == expected if expected else status >= 0, extra
        assert any(of(lines, "wrench")[-1]) == (status >= 0), extra
    late = run(folder, [*running, good, "late 1.2"])
    assert not any(of(late, "wrench")[-1])  # `armed` was not repeated
    jumped = run(folder, [*running, "armed 1", good, "late 1.0", *period(ahead(26)) * 20])
    assert "sample=59|" in next(line for line in reversed(jumped) if line.startswith("/diagnostics "))


def test_gains_are_parameters_with_ranges_and_change_whole_or_not_at_all(folder: Path) -> None:
    law, bundle, p = guarded()
    lines = run(folder, ["set k_v 2.0", "set k_v -1.5", "set mass 1 2 3", "set input_timeout 0", "set frame_id 0"])
    declared = {line.split()[1]: line for line in lines if line.startswith("declared ")}
    assert set(declared) == {"frame_id", "input_timeout", *(port.name for port in law.gains)}
    within = bundle.envelope
    assert within is not None
    low, high = within.gains[law.gains.slice("k_v").start]
    assert [float(word) for word in declared["k_v"].split(" | ")[0].split()[3:]] == [low, high]
    assert declared["k_v"].endswith(re.search(r"\| `k_v` .*\| (.*) \|", bundle.files["README.md"]).group(1))  # type: ignore[union-attr]
    assert [line for line in lines if line.startswith("set ")] == [
        "set k_v 1 ",
        "set k_v 0 k_v: out of its range",
        "set mass 0 mass: expected 4 numbers",
        "set input_timeout 0 input_timeout: not a positive time",
        "set frame_id 1 ",
    ]
    script = [line for k in range(20) for line in period(ahead(k))]
    changed = p.copy()
    changed[law.gains.slice("k_v")] = 2.0
    x = law.initial_state()
    for k in range(20):
        step = law.step(x, ahead(k), changed if k == 19 else p)
        x = step.x_next
    found = of(run(folder, [*script[:-4], "set k_v 2", "set k_r -1", *script[-4:]]), "wrench")[-1]
    assert found == [*step.tau[:3], 0.0, 0.0, step.tau[3]]
    lines = re.findall(r"^    (\w+): (.*?) #", (folder / "b/ros2/config/params.yaml").read_text(), flags=re.MULTILINE)
    config = {name: value if name == "frame_id" else json.loads(value) for name, value in lines}
    numbers = np.concatenate([np.ravel(config[port.name]) for port in law.gains])
    assert numbers.tobytes() == p.tobytes() and all(
        isinstance(v, float) for v in np.ravel(config["waypoints"]).tolist()
    )


def test_package_and_launch_file_name_what_the_code_uses(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ros2 = folder / "b/ros2"
    package = ElementTree.parse(ros2 / "package.xml").getroot()
    depends = {item.text for item in package.findall("depend")}
    used = re.findall(r'#include "(\w+)/', (ros2 / "src/controller_node.cpp").read_text())
    found = re.findall(r"find_package\((\w+)", (ros2 / "CMakeLists.txt").read_text())
    assert depends == set(used) == set(found) - {"ament_cmake"} and package.findtext("name") == "surctl_closed_form"
    started: list[dict[str, object]] = []
    modules: dict[str, dict[str, object]] = {
        "ament_index_python.packages": {"get_package_share_directory": lambda name: f"/share/{name}"},
        "launch": {"LaunchDescription": list},
        "launch.actions": {"DeclareLaunchArgument": lambda name, **rest: (name, rest["default_value"])},
        "launch.substitutions": {"LaunchConfiguration": str},
        "launch_ros.actions": {"Node": lambda **rest: started.append(rest)},
    }
    for name, members in modules.items():
        for module in (name, name.split(".")[0]):
            monkeypatch.setitem(sys.modules, module, sys.modules.get(module) or ModuleType(module))
        vars(sys.modules[name]).update(members)
    described = runpy.run_path(str(ros2 / "launch/controller.launch.py"))["generate_launch_description"]()
    assert ("params_file", "/share/surctl_closed_form/config/params.yaml") in described
    assert started[0]["package"] == "surctl_closed_form" and started[0]["executable"] == "controller_node"


@cache
def sensing() -> Bundle:
    """A law with the inputs of the law with sonars, which computes nothing."""
    inputs = (
        *(Port("fix", (3,), "m", "position"), Port("fix_fresh", (1,), "1", "1 if it has arrived")),
        *(Port("yaw", (1,), "rad", "heading"), Port("yaw_rate", (1,), "rad/s", "yaw rate")),
        *(Port("contacts", (8, 6), "m", "obstacles"), Port("contacts_fresh", (1,), "1", "1 if they have arrived")),
        *(Port("samples", (4, 5), "m", "ranges", default=4.5), Port("fresh", (4,), "1", "1 if a firing has arrived")),
        Port("working", (8,), "1", "1 for each thruster that works", default=1.0),
    )
    layouts = (
        Layout((Port("memory", (1,), "1", "nothing"),)),
        Layout(inputs),
        Layout((Port("gain", (1,), "1", "none"),)),
    )
    x, u, p = (ca.SX.sym(letter, layout.size) for letter, layout in zip("xup", layouts, strict=True))
    function = ca.Function("law", [x, u, p], [u[:4], x, ca.SX(0), ca.SX(0, 1)])
    outputs = Layout((Port("tau", (4,), "N, N, N, N m", "thrust"),))
    return build_bundle(StandIn("sensing", 0.05, *layouts, outputs, function), {})


def test_a_node_of_a_law_with_sonars_fills_in_what_no_message_says() -> None:
    """That such nodes compile, study 40 checks."""
    sensor_law = sensing()
    node, loop = (sensor_law.files[file] for file in ("ros2/src/controller_node.cpp", "loop.c"))
    assert '"range_" + std::to_string(k)' in node and "if (range > message.max_range) {range = 4.5;}" in node
    assert "working_at_" not in node and "contacts_fresh = 1.0" in node and "loop_.input.fresh[k] = 1.0" in node
    assert "loop->input.samples[k0][k1] = 4.5;" in loop and "loop->input.working[k] = 1.0;" in loop
    assert "`working` (in) | std_msgs/Float64MultiArray" in sensor_law.files["ros2/README.md"]


@pytest.mark.parametrize("build", [sensing, lambda: clocks()[1]], ids=["robot", "other"])
def test_a_readme_claims_nothing_that_the_bundle_has_not(build: Callable[[], Bundle]) -> None:
    bundle = build()
    texts = {file: text for file, text in bundle.files.items() if file.endswith((".md", ".yaml"))}
    gains = f"{bundle.name}_gains_begin" in bundle.files[f"{bundle.name}.h"] or f"{bundle.name}_gains.h" in bundle.files
    whole = "\n".join(texts.values())
    for claim in ("gains as parameters", "_gains_begin", "the tuned values.", "gains are tunable", "gains_check"):
        assert gains or claim not in whole, claim
    wrench = "WrenchStamped" in bundle.files["ros2/src/controller_node.cpp"]
    assert ("frame_id" in whole) == wrench and ("--target fmu3" in whole) == wrench


def test_a_package_has_a_name_of_ros() -> None:
    law, bundle, _ = guarded()
    assert bundle.envelope is not None
    values = example_values(law, bundle.envelope, name="my__law_", arrays=0)
    assert values["package"] == "my_law" and values["stack_bytes"] % 1024 == 0

"""A controller of any plant as C: its commands keep their names, and nothing in the text is about the robot."""

import json
from pathlib import Path

import pytest

from surctl.errors import InputError
from surctl.export import software_in_the_loop
from surctl.ir import Layout, Port
from surctl.marine.export import build_bundle
from surctl.system import Controller, run_system
from tests.system.examples import level
from tests.tools import need_compiler

SPEED = Port("speed", (1,), "m/s", "of the cart")


def two_commands(measured: Port = SPEED) -> Controller:
    commands = Layout((Port("left", (1,), "N", "wheel"), Port("right", (2,), "N m", "wheels")))
    return Controller(
        "wheels", 0.1, Layout((measured,)), commands,
        lambda x, u, p: {"left": -u[measured.name], "right": [u[measured.name], 2 * u[measured.name]]},
    )  # fmt: skip


def test_the_commands_keep_their_names() -> None:
    files = build_bundle(two_commands(), {}).files
    assert "double left; /* [N] wheel */" in files["wheels.h"] and "double right[2]; /* [N m]" in files["wheels.h"]
    assert json.loads(files["manifest.json"])["commands"] == {"left": "N", "right": "N m"}
    assert "output.left, output.right are zero" in files["README.md"]
    for name in ("wheels.h", "README.md", "link.h"):
        assert not any(word in files[name] for word in ("thrust", "ENU", "TRAPPED", "output.tau")), name


def test_the_c_code_gives_the_numbers_of_the_run(tmp_path: Path) -> None:
    need_compiler()
    system = level()
    report = software_in_the_loop(system.controller, run_system(system, 5.0), workdir=tmp_path)
    assert report.conclusive and report.tau.absolute == report.state.absolute == 0.0
    assert "command 0.0e+00" in report.summary()


def test_an_input_with_the_name_of_the_sample_number_is_refused() -> None:
    with pytest.raises(InputError, match=r"inputs.sample: is the name of the sample number"):
        build_bundle(two_commands(Port("sample", (1,), "m", "measured")), {})

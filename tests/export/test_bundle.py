from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from surctl.certcheck.bundle import manifest_seal
from surctl.errors import InputError
from surctl.export import Bundle, write_bundle
from surctl.export.guard_text import EXAMPLES
from surctl.export.process import compile_controller
from surctl.export.rendering import comment
from surctl.ir import Layout, Port
from surctl.ir.cache import compile_program, find_compiler
from surctl.marine.control import build_law
from surctl.marine.export import build_bundle
from surctl.marine.simulation import load_scenario
from tests.export.standin import GAINS, StandIn, stand_in
from tests.processes import run_python
from tests.tools import need_compiler, need_make

TUNED = {"k_p": np.array([1.0, 2.0, 0.1, 0.7])}


def bundle_of(law: StandIn) -> Bundle:
    return build_bundle(law, TUNED)


def test_two_builds_give_the_same_bytes() -> None:
    assert dict(bundle_of(stand_in()).files) == dict(bundle_of(stand_in()).files)


def test_another_process_gives_the_same_bytes(tmp_path: Path) -> None:
    """Strings have other hashes there."""
    here = bundle_of(stand_in())
    script = tmp_path / "script.py"
    script.write_text(
        "from tests.export.test_bundle import bundle_of, stand_in\nb = bundle_of(stand_in())\n"
        "import hashlib\nprint(b.id, hashlib.sha256(''.join(b.files.values()).encode()).hexdigest())\n"
        "print(hash('standin'))\n"
    )
    want = f"{here.id} {hashlib.sha256(''.join(here.files.values()).encode()).hexdigest()}\n"
    done = run_python([str(script)])
    assert done.stdout.startswith(want), done.stderr
    assert done.stdout != f"{want}{hash('standin')}\n" or "PYTHONHASHSEED" in os.environ


def test_the_id_follows_what_is_computed_and_not_the_name() -> None:
    base = bundle_of(stand_in())
    assert build_bundle(stand_in(), TUNED, name="other").id == base.id
    assert bundle_of(stand_in(gain=float(np.nextafter(0.1, 1)))).id != base.id
    assert build_bundle(stand_in(), {"k_p": np.array([1.0, 2.0, 0.1, 0.8])}).id != base.id
    assert bundle_of(replace(stand_in(), dt=0.1)).id != base.id


def test_files_and_manifest() -> None:
    bundle = bundle_of(stand_in())
    code = ["standin.h", "standin_internal.h", "standin.c", "standin_law.c", "standin_selftest.c"]
    link, emulated = ["link.h", "link.c", "controller.c"], ["target_start.c", "target_link.c", "target.ld"]
    around = ["sil_main.c", "Makefile", *link, *emulated, "README.md", "manifest.json"]
    gains = ["standin_gains.h", "standin_gains.c"]
    around += ["main_example.c", "board.h", "board_example.c", "CMakeLists.txt", "pyproject.toml", "setup.py"]
    around += ["loop.h", "loop.c", *EXAMPLES, "standin.py", "library.properties", "arduino_example.ino", "LICENSE"]
    around += ["law.txt"]
    assert set(bundle.files) == {*code, *gains, *around} and list(bundle.files)[-1] == "manifest.json"
    assert {*bundle.headers, *bundle.sources, bundle.selftest} == {*code, *gains}
    assert all(f"`{file}`" in bundle.files["README.md"] for file in (*code, *gains))
    manifest = json.loads(bundle.files["manifest.json"])
    assert manifest["id"] == bundle.id and manifest["dt_s"] == 0.05
    assert manifest["operations_at_most"] == stand_in().block.operations > 50
    for name, digest in manifest["sha256"].items():
        assert hashlib.sha256(bundle.files[name].encode()).hexdigest() == digest
    assert set(manifest["sha256"]) == set(bundle.files) - {"manifest.json"}
    assert bundle.files["law.txt"] == stand_in().block.text() and manifest["seal"] == manifest_seal(manifest)


def test_header_and_readme_say_unit_and_meaning() -> None:
    files = bundle_of(stand_in()).files
    assert "    standin_at_memory = 5 /* memory[2][3] [m] last ranges, newest row first */" in files["standin.h"]
    assert "double fresh; /* [1] 1 when the ranges are new */" in files["standin.h"]
    assert "| `k_p[4]` | 1.0, 2.0, 0.1, 0.7 | 1/s | proportional gain |" in files["README.md"]
    assert "ranges by sensor */ ??/ \\| η |" in files["README.md"]


def test_text_cannot_leave_its_comment() -> None:
    text = comment("a */ b /* c ??/ d **// \n e \u202e f")
    assert not any(bad in text for bad in ("*/", "/*", "??", "\n", "\u202e"))


def test_it_compiles_strictly_and_tests_itself(tmp_path: Path) -> None:
    need_compiler()
    folder = tmp_path / "bundle"
    bundle = bundle_of(stand_in())
    write_bundle(bundle, folder)
    program = compile_program([folder / "sil_main.c", *compile_controller(bundle, folder)], folder / "sil")
    done = subprocess.run([str(program), "--selftest"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, f"{bundle.id} ok\n")


def test_the_self_test_notices_a_changed_gain(tmp_path: Path) -> None:
    need_compiler()
    bundle, folder = bundle_of(stand_in()), tmp_path / "bundle"
    write_bundle(bundle, folder)
    source = folder / "standin.c"
    text = source.read_text()
    assert text.count("{ 1.0, 2.0, ") == 1
    source.write_text(text.replace("{ 1.0, 2.0, ", "{ 1.0, 2.0001, "))
    program = compile_program([folder / "sil_main.c", *compile_controller(bundle, folder)], folder / "sil")
    assert subprocess.run([str(program), "--selftest"], capture_output=True, check=False).returncode > 0


def test_null_pointers_give_null_and_zero_thrust(tmp_path: Path) -> None:
    need_compiler()
    bundle, folder = bundle_of(stand_in()), tmp_path / "bundle"
    write_bundle(bundle, folder)
    main = tmp_path / "main.c"
    main.write_text(
        """#include "standin.h"
#include <stddef.h>
int main(void)
{
    standin_state_t s; standin_gains_t g; standin_input_t u = {{0.0}, {{0.0}}, 0.0, 1U}; standin_output_t y;
    int i;
    if (standin_initialize(NULL, &g) != -1 || standin_initialize(&s, NULL) != -1) { return 1; }
    if (standin_initialize(&s, &g) != STANDIN_STATUS_OK) { return 2; }
    if (s.x[standin_at_memory + 5] != 1.5 || g.k_p[3] != 0.7) { return 2; }
    for (i = 0; i < 4; ++i) { y.tau[i] = 9.0; }
    if (standin_step(&s, &g, NULL, &y) != STANDIN_STATUS_NULL) { return 3; }
    for (i = 0; i < 4; ++i) { if (y.tau[i] != 0.0) { return 4; } }
    if (standin_step(NULL, &g, &u, &y) != -1 || standin_step(&s, NULL, &u, &y) != -1) { return 5; }
    if (standin_step(&s, &g, &u, NULL) != -1) { return 6; }
    standin_terminate(&s);
    standin_terminate(NULL);
    return (s.x[standin_at_memory + 5] == 0.0 && standin_selftest(NULL) > 0) ? 0 : 7;
}
"""
    )
    include = ["-I", str(folder)]
    program = compile_program([main, *compile_controller(bundle, folder)], tmp_path / "m", flags=include)
    assert subprocess.run([str(program)], check=False).returncode == 0


def test_fast_math_is_refused_by_the_source_itself(tmp_path: Path) -> None:
    compiler = need_compiler()
    write_bundle(bundle_of(stand_in()), tmp_path / "bundle")
    for file in ("standin.c", "standin_law.c", "standin_selftest.c"):
        command = [*compiler.split(), "-ffast-math", "-c", "-o", "x.o", file]
        done = subprocess.run(command, cwd=tmp_path / "bundle", capture_output=True, text=True, check=False)
        assert done.returncode != 0 and "without -ffast-math" in done.stderr


def test_two_controllers_go_into_one_program(tmp_path: Path) -> None:
    need_compiler()
    code: list[Path] = []
    for name in ("near", "far"):
        bundle = build_bundle(stand_in(), TUNED, name=name)
        write_bundle(bundle, tmp_path / name)
        code += compile_controller(bundle, tmp_path / name)
    main = tmp_path / "main.c"
    main.write_text(
        """#include "near.h"
#include "far.h"
int main(void)
{
    static near_state_t one;
    static far_state_t other;
    return near_selftest(&one) + far_selftest(&other);
}
"""
    )
    include = ("-I", str(tmp_path / "near"), "-I", str(tmp_path / "far"))
    program = compile_program([main, *code], tmp_path / "both", flags=include)
    assert subprocess.run([program], check=False).returncode == 0


def test_make_check(tmp_path: Path) -> None:
    need_compiler()
    make = need_make()
    write_bundle(bundle_of(stand_in()), tmp_path / "bundle")
    command = [make, "-s", "check", f"CC={find_compiler()}"]
    done = subprocess.run(command, cwd=tmp_path / "bundle", capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_writing_over_an_older_bundle_leaves_other_files_alone(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "bundle"
    write_bundle(build_bundle(stand_in(), {}), folder)
    (folder / "mine.txt").write_text("keep")
    written = write_bundle(bundle_of(stand_in()), folder)
    for file in written:
        assert hashlib.sha256(file.path.read_bytes()).hexdigest() == file.sha256
    assert (folder / "mine.txt").read_text() == "keep"
    other = build_bundle(stand_in(), TUNED, name="other")
    (folder / "standin.h").write_text("mine now")
    write_bundle(other, folder)  # files of the older bundle are removed, except those that the user has altered
    left = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert left == {*other.files, "mine.txt", "standin.h"}
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["bundle"]


def test_folders_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for target in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/nowhere/bundle")):
        with pytest.raises(InputError, match=r"cannot be written.*choose a folder") as caught:
            write_bundle(bundle_of(stand_in()), target)
        assert "\n" not in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_mistakes_are_named() -> None:
    law = stand_in()
    with pytest.raises(InputError, match=r"k_q.*did you mean 'k_p'"):
        build_bundle(law, {"k_q": np.zeros(4)})
    with pytest.raises(InputError, match=r"limit.*not finite"):
        build_bundle(law, {"limit": np.array([np.nan])})
    with pytest.raises(InputError, match=r"'a-b'.*not a C identifier"):
        build_bundle(law, {}, name="a-b")
    with pytest.raises(InputError, match=r"sil_main.*already the name of a file"):
        build_bundle(law, {}, name="sil_main")
    with pytest.raises(InputError, match=r"dt = 0.0.*positive"):
        build_bundle(replace(law, dt=0.0), {})
    bad_port = Layout((*law.gains.ports[:1], Port("limit;", (1,), "N", "x")))
    with pytest.raises(InputError, match=r"'limit;'.*not a C identifier"):
        build_bundle(replace(law, gains=bad_port), {})
    with pytest.raises(InputError, match="commands nothing; begin with the commands"):
        build_bundle(replace(law, outputs=Layout(law.outputs.ports[::-1])), {})
    with pytest.raises(InputError, match="but its layouts have"):
        build_bundle(replace(law, gains=Layout(GAINS[:1])), {})


@pytest.mark.parametrize(
    ("name", "why"),
    [
        *(
            (name, "already the name of a file of the bundle")
            for name in ("fmu", "link", "controller", "target_start", "proof", "FMU")
        ),
        *((name, "system header") for name in ("math", "stdint", "stdio", "string", "unistd", "netdb", "Math")),
        *((name, "Python module") for name in ("numpy", "ctypes")),
        ("nav_link", "include guard of another bundle's link.h"),
        ("nav_loop", "include guard of another bundle's loop.h"),
        ("Nav", "has capital letters.*write nav"),
        ("NAV", "has capital letters.*write nav"),
    ],
)
def test_a_name_that_meets_another_file_is_refused(name: str, why: str) -> None:
    with pytest.raises(InputError, match=why):
        build_bundle(stand_in(), TUNED, name=name)


def test_state_that_only_passes_through_compiles(tmp_path: Path) -> None:
    need_compiler()
    law = stand_in(telemetry=False)
    x, u, p = (ca.SX.sym(*at) for at in (("x", law.state.size), ("u", law.inputs.size), ("p", law.gains.size)))
    function = ca.Function("law", [x, u, p], [u[:4], x, ca.SX(0), ca.SX(0, 1)])
    folder = tmp_path / "bundle"
    bundle = build_bundle(replace(law, function=function), {})
    write_bundle(bundle, folder)
    program = compile_program([folder / "sil_main.c", *compile_controller(bundle, folder)], folder / "sil")
    assert subprocess.run([program, "--selftest"], check=False).returncode == 0


def test_refused_operations_reach_the_user() -> None:
    law = stand_in()
    x, u, p = law.function.sx_in()
    tau, x_next, status, telemetry = law.function(x, u, p)
    worse = ca.Function("law", [x, u, p], [ca.erf(tau), x_next, status, telemetry])
    with pytest.raises(InputError, match="operation 'erf'"):
        build_bundle(replace(law, function=worse), {})


def test_the_law_that_senses_is_readable_and_small() -> None:
    scenario = load_scenario("pool-behind")
    law = build_law(sonar=True, equipment=scenario.sensors.on(0.2))
    bundle = build_bundle(law, {})
    files, header = bundle.files, bundle.files["surctl_guarded.h"]
    assert re.search(r"    surctl_guarded_at_map_cells = \d+, /\* map_cells\[2304\] \[1\] 1 marked", header)
    assert header.count(f"[{law.state.size}];") == 2
    assert len(header.splitlines()) < 240
    read = sum(len(text.encode()) for name, text in files.items() if name != "law.txt")  # the list is data
    assert read < 426_000  # with wiring, examples and wrapper
    assert bundle.sources == tuple(f"surctl_guarded{part}.c" for part in ("", "_gains", "_law", "_sensing", "_map"))
    code = [files[file] for file in (*bundle.sources, bundle.selftest)]
    assert max(map(len, code)) < 93_000 and sum(map(len, code)) <= 235_000
    assert len(files[bundle.selftest]) < 16_000  # no vector of it is a whole state
    seen = set(re.findall(r"^(?!(?:APART )?static )(?:\w+ )+\*?(\w+)\([^;]*?\n\{", "\n".join(code), flags=re.MULTILINE))
    assert {name for name in seen if not name.startswith("surctl_guarded_")} == set() and len(seen) >= 8
    fields = {
        "fix[3]": "[m] position x, y, z in {E} that the base station measured 0.1 s before it arrives",
        "fix_fresh": "[1] 1 if a fix has arrived since the last step, else 0",
        "yaw": "[rad] heading psi of {B} in {E}, counter-clockwise",
        "yaw_rate": "[rad/s] yaw rate r in {B}",
        "contacts[8][6]": "[m, m/s, 1] moving obstacles in {E} that the base station measured 0.1 s before",
        "contacts_fresh": "[1] 1 if a message with contacts has arrived since the last step, else 0",
        "samples[4][5]": "[m] raw ranges of each sonar's last firing, one sonar per row; axes at 0, 90, 180, -90 deg",
        "fresh[4]": "[1] 1 if a firing of the sonar has arrived since the last step, else 0",
    }
    struct = header[header.index("/* inputs of each step */") : header.index("} surctl_guarded_input_t;")]
    assert struct.count("double ") == len(fields)
    for field, meaning in fields.items():
        assert f"    double {field}; /* {meaning}" in struct
        unit, text = meaning[1:].split("] ", 1)
        assert f"| input | `{field}` | {unit} | {text}" in files["README.md"]
    assert all(f"| `{port.name}" in files["README.md"] for port in law.gains)

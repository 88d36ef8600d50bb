import json
from pathlib import Path
from typing import Any

import pytest

from tests.processes import run_python
from tests.tools import need, need_compiler

ROOT = Path(__file__).parents[1]
PARTS = "tests.notebook_parts"  # what every notebook loads
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.py"))

PRINTED = {
    "00_from_system_to_code": (
        "after 2 s: 0.0003 rad",
        "phase margin 51°, delay margin 124 ms",
        "proved; the checker accepts it: True",
        "SIL balance: passed over 200 steps",
        "states: x, y, z, psi, u, v, w, r, Fu, Fv, Fw, Fr",
        "pool-behind: reached after",
    ),
    "01_plants_and_vehicles": (
        "10° of rudder turn the ship by 38° in a minute",
        "steady speed at full thrust: 1.36 m/s",
        "my-bluerov2 0.852 1/s, sur540-flooded -0.021 1/s",
        "surge mass 95.0 kg; from 0.2 m/s it stops after 0.30 m",
    ),
    "02_priorities": (
        "lexicographic: [-0.16  -0.028  0.3  ] rad/s. Task `tip` gave up 0.2 m/s because `wall` binds; task `straight`",
        "tip at the end [m]: [2.1 1.5]",
        "NSB differs from strict priority at `look`",
        "nsb: v is the null-space-based law. This mode ignores limits",
        "projected: Task `go` gave up 0.35 m/s because `wall` binds.",
    ),
    "03_stability_claims": (
        "drag-8: proved, checker: left <= right",
        "drag-9: refuted at",
        "van-der-pol: proved, accepted: True",
        "v1-printed: refuted",
        "v1-corrected: proved, accepted: True",
    ),
    "04_sweep_and_tune": (
        "400 runs: the cart is within 2 cm after 2.7 to",
        "unmet: ()",
        "unmet: quick",
        "robust  hard: default 0.79, fast 1.31",
    ),
    "05_export": (
        "SIL hold_speed: passed over 200 steps",
        "gcc-O3: 0 differing steps",
        "reached after 410 steps on the processor",
        "0 of them differ from Python",
    ),
    "06_your_own_law": (
        "wall_follower: own gains k_wall, stand_off",
        "reached after 19.1 s",
        "heading gave up at most 0.36 rad/s because of velocity.u, velocity.r",
        "stable: True, least disk margin 0.76 (yaw)",
        "closed_form: 4 levels, stable: True",
    ),
}


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with every notebook as .ipynb, the first twice: `marimo export ipynb`, in one process."""
    folder = tmp_path_factory.mktemp("exported")
    words = map(str, (ROOT / "tests" / "notebook_export.py", folder, *NOTEBOOKS, NOTEBOOKS[0]))
    done = run_python(list(words), cwd=folder, loaded=PARTS)
    assert done.returncode == 0, done.stderr
    return folder


def cells(text: str) -> list[tuple[str, str]]:
    found: list[dict[str, Any]] = json.loads(text)["cells"]
    return [(cell["cell_type"], "".join(cell["source"])) for cell in found]


def test_every_notebook_is_expected() -> None:
    assert [notebook.stem for notebook in NOTEBOOKS] == list(PRINTED)


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs_as_a_script_without_a_warning(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_compiler()
    if notebook.stem == "05_export":
        for tool in ("gcc", "qemu-system-arm", "arm-none-eabi-gcc"):
            need(tool)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    done = run_python([str(notebook)], cwd=tmp_path, loaded=PARTS)
    assert done.returncode == 0, done.stderr
    assert [line for line in PRINTED[notebook.stem] if line not in done.stdout] == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_its_ipynb_is_in_step(notebook: Path, exported: Path) -> None:
    committed = notebook.with_suffix(".ipynb").read_text(encoding="utf-8")
    assert cells(committed) == cells((exported / f"{notebook.stem}.ipynb").read_text(encoding="utf-8"))


def test_exported_again_it_has_the_same_bytes(exported: Path) -> None:
    once, twice = (exported / f"{NOTEBOOKS[0].stem}{end}.ipynb" for end in ("", "-twice"))
    assert once.read_bytes() == twice.read_bytes()


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_its_ipynb_holds_no_output_and_no_path_of_a_machine(notebook: Path) -> None:
    text = notebook.with_suffix(".ipynb").read_text(encoding="utf-8")
    assert not any(cell.get("outputs") for cell in json.loads(text)["cells"])
    assert [place for place in (str(ROOT), str(Path.home()), "/tmp/", "/home/") if place in text] == []

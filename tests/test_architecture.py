"""The house itself: one direction of imports, lint, types, and what no file may hold."""

from __future__ import annotations

import ast
import importlib
import pkgutil
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

import pytest

import surctl
from tests.tools import PATIENCE

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "surctl"
LONGEST = 600
# put together here, so that this file does not hold them itself
NOWHERE = ["../" + "shared", "/wo" + "rk/", "TO" + "DO", "FIX" + "ME"]
_IMPORT = re.compile(r"^[ \t]*(from [\w.]+ import (?:\([^)]*\)|[^(\n]*)|import [^\n]*)", re.MULTILINE)


def _run(*command: str) -> str:
    """Output of a tool that must end with status 0."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=PATIENCE)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def _script(name: str) -> str:
    """A console script of this very environment."""
    beside = Path(sysconfig.get_path("scripts")) / name
    found = str(beside) if beside.exists() else shutil.which(name)
    assert found, f"{name} is not installed: pip install -e .[dev]"
    return found


def _modules() -> list[str]:
    walked = pkgutil.walk_packages([str(PACKAGE)], prefix="surctl.")
    return ["surctl", *(m.name for m in walked if not m.name.endswith("__main__"))]


def _tracked() -> list[Path]:
    """Files of the repository; of the whole tree where there is no git."""
    try:
        listed = _run("git", "-c", "safe.directory=*", "ls-files", "-z").split("\0")
    except (AssertionError, FileNotFoundError):
        skip = {".git", "build", "dist", "__pycache__"}
        return [p for p in ROOT.rglob("*") if p.is_file() and not skip & set(p.relative_to(ROOT).parts)]
    return [ROOT / name for name in listed if name and (ROOT / name).is_file()]


def test_imports_go_one_way() -> None:
    contracts = _contracts()
    assert f"{len(contracts)} kept, 0 broken" in _run(_script("lint-imports"), "--no-cache")


def _contracts() -> list[dict[str, Any]]:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    contracts: list[dict[str, Any]] = tomllib.loads(text)["tool"]["importlinter"]["contracts"]
    return contracts


def test_every_room_is_of_the_core_or_above_it() -> None:
    [border] = [c for c in _contracts() if c["name"].startswith("the core knows no vehicle")]
    rooms = {".".join(name.split(".")[:2]) for name in _modules()} - {"surctl"}
    assert rooms - set(border["source_modules"]) == {"surctl.marine"}


def _imports(name: str, package: bool, text: str, modules: set[str]) -> set[str]:
    """Those of the modules that a module imports anywhere: inside functions and for type checking alone as well."""
    found = set()
    for node in ast.parse("\n".join(_IMPORT.findall(text))).body:  # parsing all of the text takes twenty times as long
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = name.split(".")[: len(name.split(".")) + package - node.level] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            inside = {alias.name: f"{base}.{alias.name}" for alias in node.names}
            found |= {inside[item] if inside[item] in modules else base for item in inside}
    return found & modules - {name}


def _circle(texts: dict[str, str]) -> list[str]:
    """Modules each of which imports the next, and the last the first; empty if none do. A package ends with a dot."""
    modules = {name.rstrip(".") for name in texts}
    graph = {
        name.rstrip("."): _imports(name.rstrip("."), name.endswith("."), text, modules) for name, text in texts.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(reversed(error.args[1]))[1:]  # it tells who is imported before who imports
    return []


def test_no_modules_import_each_other_in_a_circle() -> None:
    texts = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        name = ".".join(parts[:-1]) + "." if parts[-1] == "__init__" else ".".join(parts)
        texts[name] = path.read_text(encoding="utf-8")
    assert len(texts) > 50
    assert _circle(texts) == []


@pytest.mark.parametrize(
    "back",
    [
        "import r.a",
        "from r.a import f",
        "from r import a",
        "from . import a",
        "from .a import f",
        "def g():\n    from r.a import f",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from r.a import f",
        "from r import f",
    ],
)
def test_a_circle_is_found_wherever_the_import_stands(back: str) -> None:
    package = {"r.": "from r.a import f", "r.a": "from r.b import g", "r.b": back}
    assert set(_circle(package)) - {"r"} == {"r.a", "r.b"}
    assert _circle({**package, "r.b": "import ast\nfrom r.c import g", "r.c": ""}) == []
    assert set(_circle({"r.": "", "r.s.": "from ..b import g", "r.b": "from r.s import f"})) == {"r.s", "r.b"}


def test_ruff() -> None:
    _run(sys.executable, "-m", "ruff", "check", ".")
    _run(sys.executable, "-m", "ruff", "format", "--check", ".")


def test_mypy() -> None:
    """Its search for reference cycles takes a third of the time, and mypy turns it on again: it stays off."""
    without = "import gc; gc.disable(); gc.enable = gc.disable; from mypy import __main__; __main__.console_entry()"
    assert "Success" in _run(sys.executable, "-c", without)


def test_every_public_name_exists() -> None:
    """In one test: nearly eight hundred would take a second of collecting in every process."""
    missing, twice = [], []
    for name in _modules():
        module = importlib.import_module(name)
        public = getattr(module, "__all__", [])
        twice += [name] * (len(set(public)) < len(public))
        missing += [f"{name}.{item}" for item in public if not hasattr(module, item)]
    assert missing == [] and twice == []


# names with two meanings in rooms that are not yet cleared; a name leaves this list when one of the two is renamed
TWICE = {
    "Controller", "Decision", "Mode", "Moment", "Plant", "Reply", "build_bundle",
    "called", "checked_name", "corners", "corrected", "joined",
    "linearise", "minimise", "number", "quadratic", "replay", "search", "stepper", "to_casadi",
}  # fmt: skip
UNCLEARED = (
    "certcheck", "cli", "priority", "tuning", "marine.cli", "marine.sensing", "marine.simulation", "marine.study",
    "marine.tuning", "marine.verification.braking", "marine.verification.region",
)  # fmt: skip


def test_no_two_public_classes_or_functions_have_one_name() -> None:
    """Where a name is defined twice, a reader who knows one meaning misreads the other."""
    places: dict[str, set[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        module = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        if path.name == "__init__.py" or module.startswith(tuple(f"{room}." for room in UNCLEARED)):
            continue
        body = ast.parse(path.read_text(encoding="utf-8")).body
        listed = (
            node.value for node in body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
        )
        public = next((ast.literal_eval(value) for value in listed), None)
        for node in body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef) and (
                node.name in public if public is not None else not node.name.startswith("_")
            ):
                places.setdefault(node.name, set()).add(module)
    assert len(places) > 500
    assert {name for name, modules in places.items() if len(modules) > 1} == TWICE


def test_a_lazy_package_loads_at_first_use_and_no_module_hides_a_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "idle").mkdir()
    load = (
        "from typing import TYPE_CHECKING\n\nfrom surctl.lazy import load_at_first_use\n\nif TYPE_CHECKING:\n"
        "    from idle.broken import (\n        lost,\n    )\n    from idle.go import go\n\n"
        "load_at_first_use(__name__)\n"
    )
    (tmp_path / "idle" / "__init__.py").write_text(load)
    (tmp_path / "idle" / "go.py").write_text("def go():\n    return 1\n")
    (tmp_path / "idle" / "broken.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    package = importlib.import_module("idle")
    assert {"go", "lost"} <= set(dir(package))
    assert importlib.import_module("idle.go").go is package.go
    with pytest.raises(ZeroDivisionError):
        _ = package.lost
    with pytest.raises(AttributeError, match="module 'idle' has no attribute 'gone'"):
        _ = package.gone


def test_input_is_checked_before_heavy_libraries_are_loaded() -> None:
    heavy = ("control", "distributed", "matplotlib", "osqp", "qpsolvers", "scipy", "xarray")
    code = f"""
import sys, surctl.cli, surctl.tuning, surctl.verification
from surctl.marine import control, simulation, study, tuning, verification
for package in (control, simulation, study, tuning, verification, surctl.tuning, surctl.verification):
    [getattr(package, name) for name in package.__all__]
print([m for m in {heavy} if m in sys.modules])
"""
    assert _run(sys.executable, "-c", code).split("\n")[0] == "[]"


def test_no_file_is_too_long() -> None:
    files = sorted(PACKAGE.rglob("*.py"))
    assert len(files) > 50
    lengths = {str(p.relative_to(ROOT)): len(p.read_text(encoding="utf-8").splitlines()) for p in files}
    assert {name: n for name, n in lengths.items() if n > LONGEST} == {}


def test_no_file_holds_leftovers_or_paths_of_a_machine() -> None:
    found = []
    for path in _tracked():
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue  # a picture
        found += [f"{path.relative_to(ROOT)}: {word}" for word in NOWHERE if word in text]
    assert found == []


def test_no_law_holds_a_number_that_depends_on_the_processor() -> None:
    """NumPy's sin, cos, exp, … take other routines where the processor has AVX-512; those of `math` do not."""
    functions = r"a?sinh?|a?cosh?|a?tanh?|arc\w+|exp(2|m1)?|log(2|10|1p)?|power|hypot|cbrt"
    call = re.compile(rf"^(?!\s*>>>).*\bnp\.({functions})\(", re.MULTILINE)
    rooms = ("marine/control", "marine/guidance", "tasks")
    laws = [path for room in rooms for path in (PACKAGE / room).rglob("*.py")]
    laws += [PACKAGE / "marine/sensing/localisation/own_state.py", PACKAGE / "marine/vehicle/thrusters.py"]
    assert len(laws) > 30
    assert [(path.name, found.group()) for path in laws for found in call.finditer(path.read_text())] == []


def test_the_package_says_that_it_is_typed() -> None:
    assert (PACKAGE / "py.typed").exists()
    assert Path(surctl.__file__).parent == PACKAGE, "the tests run against another copy of surctl"

"""The reference of the Python packages, from the docstrings of what each package exports."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from page import Page, table

__all__ = ["PACKAGES", "pages"]

FOLDER = "reference/python"
ROOT = Path(__file__).parents[2]
PACKAGES = {
    "tasks": "Command",
    "priority": "Command",
    "robot": "Command",
    "system": "Simulate",
    "tuning": "Tune",
    "verification": "Prove",
    "assessment": "Prove",
    "lyapunov": "Prove",
    "sos": "Prove",
    "certcheck": "Prove",
    "export": "Export",
    "ir": "Export",
    "report": "Report",
    "testing": "Check your own code",
    "marine.vehicle": "Describe a vehicle",
    "marine.world": "Describe a vehicle",
    "marine.sensing": "Sense",
    "marine.guidance": "Command a vehicle",
    "marine.allocation": "Command a vehicle",
    "marine.control": "Command a vehicle",
    "marine.simulation": "Simulate a mission",
    "marine.engine": "Simulate a mission",
    "marine.tuning": "Tune a mission",
    "marine.verification": "Prove a mission",
    "marine.assessment": "Prove a mission",
    "marine.export": "Export a law",
    "marine.bridge": "Export a law",
    "marine.report": "Report a mission",
    "marine.study": "Report a mission",
    "marine.reproduction": "Report a mission",
    "marine.testing": "Check your own law",
}
"""Packages with a page each, first the core and then the application, and what they are for."""


def exported(package: str) -> tuple[str, list[str]]:
    """Return the first line of a package's docstring and the names that it exports, without importing it."""
    place = ROOT.joinpath("surctl", *package.split("."))
    file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
    tree = ast.parse(file.read_text(encoding="utf-8"))
    names: list[str] = []
    for node in tree.body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            names = [str(name) for name in ast.literal_eval(node.value)]
    return (ast.get_docstring(tree) or "").split("\n\n")[0], names


def pages(*, quick: bool) -> list[Page]:
    """Return a page for each package, after a page with all of them; `quick` lists the names without docstrings."""
    made: list[Page] = []
    rows: list[tuple[str, ...]] = []
    for package, purpose in PACKAGES.items():
        said, names = exported(package)
        rows.append((purpose, f"[`surctl.{package}`]({package}.md)", said))
        body = said + "\n\n" + ", ".join(f"`{name}`" for name in names) if quick else directives(package, names)
        made.append(Page(f"{FOLDER}/{package}.md", f"surctl.{package}", f"# surctl.{package}\n\n{body}\n"))
    text = _HEAD + table(("to", "package", "contents"), rows)
    return [Page(f"{FOLDER}/index.md", "Python", text, index=True), *made]


_HEAD = """# Python

Each function states shapes, units, errors and source, and has an example; the tests run every example. Numbers in
parentheses such as (13) are [equations of the paper](../equations.md). Inside the code all numbers are in SI units and
radians, with ENU axes for the world and FLU axes for the body.

"""


def directives(package: str, names: list[str]) -> str:
    """Return what mkdocstrings replaces by the docstrings of the names that a package exports.

    A module hides a function of its own name, so such a function has a directive with the path of its definition.
    """
    functions = [name for name in names if not re.fullmatch(r"[A-Z0-9_]+", name)]
    hidden = {name: path for name in functions if (path := _hidden(package, name))}
    members = "\n".join(f"        - {name}" for name in functions if name not in hidden)
    constants = [name for name in names if name not in functions]
    said = "Constants: " + ", ".join(f"`{name}`" for name in constants) + ".\n\n" if constants else ""
    single = "".join(f"\n::: {path}\n    options:\n      show_root_heading: true\n" for path in hidden.values())
    return f"{said}::: surctl.{package}\n    options:\n      members:\n{members}\n{single}"


def _hidden(package: str, name: str) -> str:
    # path of the definition if a module of the package has the name, otherwise empty
    place = ROOT.joinpath("surctl", *package.split("."))
    if not ((place / f"{name}.py").exists() or (place / name).is_dir()):
        return ""
    tree = ast.parse((place / "__init__.py").read_text(encoding="utf-8"))
    sources = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom))
    return next(f"{node.module}.{name}" for node in sources if name in {alias.name for alias in node.names})

"""The gallery: one-file examples with what they print and draw."""

from __future__ import annotations

import ast
import contextlib
import hashlib
import io
import os
import runpy
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from page import Page

__all__ = ["EXAMPLES", "Shown", "pages", "run_example"]

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "notebooks" / "gallery"

EXAMPLES = {
    "pendulum_lqr": "pendulum on a cart, LQR and margins",
    "crane": "overhead crane, region of the sampled loop with its force limit",
    "camera_cart": "cart, sampled sensors, noise and dropouts",
    "reactor": "stirred tank reactor, region about an unstable operating point",
    "quadrotor_altitude": "quadrotor, tuning",
    "van_der_pol": "textbook dynamics, certificate",
    "barrier_double_integrator": "cart, safety filter",
    "state_feedback": "ship, python-control",
    "cybership2": "model ship, positioning and C",
    "bluerov2_attitude": "ROV in six degrees of freedom, task priorities",
    "otter_survey": "catamaran, survey",
    "rudder_mission": "torpedo with rudder, mission",
    "wall_following": "underwater robot, own law",
    "own_goals": "underwater robot, goals",
    "panda_reach": "arm, self-collision",
    "two_arms": "two arms, relative target",
    "bluerov2_arm": "ROV with arm, thrust limits",
    "humanoid_reach": "humanoid, balance",
}
"""The examples in the order of the gallery, plants of any kind before vehicles and robots, with what each is about."""


@dataclass(frozen=True)
class Shown:
    """What an example printed, and its picture (PNG); None if it was not run."""

    printed: str
    picture: bytes


@contextlib.contextmanager
def _inside(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def run_example(name: str) -> Shown:
    """Run an example in an empty folder, in this process."""
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    mpl.use("agg")
    plt.close("all")  # an example that plots without a figure of its own would go on with that of the one before
    printed = io.StringIO()
    with tempfile.TemporaryDirectory() as folder, _inside(Path(folder)), contextlib.redirect_stdout(printed):
        runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")
        picture = Path(f"{name}.png").read_bytes()
    return Shown(printed.getvalue(), picture)


def _cached(name: str) -> Shown:
    """Run an example, or return what it showed when it and surctl were last the same."""
    package = ROOT / "surctl"
    sources = [FOLDER / f"{name}.py", *sorted(package.rglob("*.py")), *sorted(package.rglob("*.toml"))]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:20]
    store = ROOT / "build" / "gallery" / f"{name}-{digest}"
    if not store.with_suffix(".png").exists():
        shown = run_example(name)
        store.parent.mkdir(parents=True, exist_ok=True)
        store.with_suffix(".txt").write_text(shown.printed, encoding="utf-8")
        store.with_suffix(".png").write_bytes(shown.picture)
    return Shown(store.with_suffix(".txt").read_text(encoding="utf-8"), store.with_suffix(".png").read_bytes())


def pages(*, run: bool) -> tuple[list[Page], dict[str, bytes]]:
    """Return a page for each example after a page with all of them, and the pictures by name.

    Without `run`, the pages show only the programs.
    """
    made: list[Page] = []
    cards: list[str] = []
    pictures: dict[str, bytes] = {}
    for name, about in EXAMPLES.items():
        source = (FOLDER / f"{name}.py").read_text(encoding="utf-8")
        said = ast.get_docstring(ast.parse(source)) or name
        title, _, text = said.partition("\n\n")
        program = source.split('"""', 2)[2].strip()
        shown = _cached(name) if run else None
        parts = [f"# {title}", text, f"`python notebooks/gallery/{name}.py` prints:"]
        picture = ""
        if shown is not None:
            pictures[f"gallery/{name}.png"] = shown.picture
            parts += [f"```console\n{shown.printed.rstrip()}\n```", f"![{title}]({name}.png)"]
            picture = f'<img class="plot" src="{name}.png" alt="" loading="lazy">'
        parts += ["## Program", f"```python\n{program}\n```"]
        made.append(Page(f"gallery/{name}.md", title.partition(":")[0], "\n\n".join(parts) + "\n"))
        cards.append(f'<a href="{name}.html">{picture}<strong>{title}</strong>{about}</a>')
    text = _HEAD + '<div class="cards">\n' + "\n".join(cards) + "\n</div>\n"
    return [Page("gallery/index.md", "Gallery", text, index=True), *made], pictures


_HEAD = """# Gallery

Each example is one file of `notebooks/gallery/` without further modules. It prints a few lines and draws one picture.
The build of this site runs the examples, so output and pictures are those of this version.

"""

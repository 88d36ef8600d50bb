"""The notebooks as pages: text and code, as stored in the .ipynb files beside them."""

from __future__ import annotations

import json
from pathlib import Path

from page import Page

__all__ = ["notebook_pages"]

FOLDER = "tutorials/notebooks"


def notebook_pages(folder: Path) -> list[Page]:
    """Return a page for each notebook, after a page with all of them."""
    made = [_page(path) for path in sorted(folder.glob("[0-9]*.ipynb"))]
    links = [f"- [{page.title}]({Path(page.uri).name}): `notebooks/{Path(page.uri).stem}`" for page in made]
    rows = "\n".join(links)
    return [Page(f"{FOLDER}/index.md", "Notebooks", _HEAD + rows + "\n", index=True), *made]


_HEAD = """# Notebooks

Each notebook is a marimo file: `pip install "surctl[notebooks]"`, then `marimo edit
notebooks/00_from_system_to_code.py`. It is also stored as `.ipynb`. These pages show text and code; run a notebook to
see results, pictures and sliders. The tests run all of them.

"""


def _page(path: Path) -> Page:
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    blocks: list[str] = []
    for cell in cells:
        text = "".join(cell["source"]).strip()
        if not text or text == "import marimo as mo":
            continue
        blocks.append(text if cell["cell_type"] == "markdown" else f"````python\n{text}\n````")
    title = next(line[2:] for block in blocks for line in block.splitlines() if line.startswith("# "))
    return Page(f"{FOLDER}/{path.stem}.md", title, "\n\n".join(blocks) + "\n", path)

"""`marimo export ipynb` of several notebooks in one process: a folder, the notebooks; a second time as NAME-twice."""

import sys
from pathlib import Path

from marimo._cli.cli import main

folder, *notebooks = map(Path, sys.argv[1:])
for notebook in notebooks:
    target = folder / notebook.with_suffix(".ipynb").name
    target = target.with_stem(f"{target.stem}-twice") if target.exists() else target
    main(["export", "ipynb", str(notebook), "-o", str(target), "--sort", "top-down"], standalone_mode=False)

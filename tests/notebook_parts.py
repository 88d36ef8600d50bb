"""What every notebook loads and looks up when it begins; `tests.processes` loads it once for all of them."""

import inspect

import marimo

inspect.stack()  # finds the file of every module, as `marimo.App` does
marimo.md("")

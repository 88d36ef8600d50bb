"""Study 40: do the checks hold that take too long for the suite?

    python analysis/40_long_checks/run.py                   # all of them
    python analysis/40_long_checks/run.py --quick           # only imports them and counts them
    python analysis/40_long_checks/run.py simulation -x     # one file; pytest's options follow

Prints pytest's output and then a Markdown table. The exit status is 0 if every check passes, 1 if one fails, and 2 for
a bad option or a file that does not exist.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from xml.etree import ElementTree

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]


def printed(results: Path) -> str:
    """Return a Markdown table of the results, a row for each file: passed, failed, skipped and wall-clock time."""
    sums: dict[str, list[float]] = defaultdict(lambda: [0, 0, 0, 0.0])
    for case in ElementTree.parse(results).iter("testcase"):
        row = sums[case.attrib["classname"].rpartition(".")[2]]
        kinds = {child.tag for child in case}
        row[1 if kinds & {"failure", "error"} else 2 if "skipped" in kinds else 0] += 1
        row[3] += float(case.attrib["time"])
    head = "| file | passed | failed | skipped | time [s] |\n|---|---|---|---|---|"
    rows = [f"| `{name}` | {a:.0f} | {b:.0f} | {c:.0f} | {t:.0f} |" for name, (a, b, c, t) in sorted(sums.items())]
    return "\n".join([head, *rows])


def main() -> int:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", nargs="?", help="part of the name of a file: simulation for test_simulation.py")
    parser.add_argument("--quick", action="store_true", help="import the checks and count them, without running any")
    options, others = parser.parse_known_args()
    files = sorted(HERE.glob(f"test_{options.name or '*'}.py"))
    if not files:
        names = ", ".join(sorted(path.stem.removeprefix("test_") for path in HERE.glob("test_*.py")))
        parser.error(f"there is no file test_{options.name}.py here: name one of {names}")
    with tempfile.TemporaryDirectory(prefix="surctl-long-") as folder:
        results = Path(folder) / "results.xml"
        mode = ["--collect-only", "-n0"] if options.quick else [f"--junitxml={results}"]
        words = ["-m", "pytest", "-q", *mode, *others, *map(str, files)]
        done = subprocess.run([sys.executable, *words], cwd=ROOT, check=False)
        if results.is_file():
            print(printed(results))
    return min(done.returncode, 2)


if __name__ == "__main__":
    sys.exit(main())

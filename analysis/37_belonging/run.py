"""Study 37: does a certificate belong to a controller only if it is about this controller?

    python analysis/37_belonging/run.py [--quick] [--changes N] [--seed N] [--write]

Prints Markdown. The exit status is 0 if every certificate belongs to its bundle, and none does after a change of
meaning; 1 otherwise.
"""

from __future__ import annotations

import argparse
import random
import shutil
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from changes import changed
from pairs import Pair, own_systems, pairs, robots

from surctl.certcheck import check_document
from surctl.certcheck.belonging import compare
from surctl.certcheck.bundle import read_bundle
from surctl.errors import InputError
from surctl.export import write_bundle


def answer(certificate: Mapping[str, Any], folder: Path) -> str:
    """Return what `surctl check --bundle` answers: a refused bundle, a mismatch, what is not bound, or `belongs`."""
    try:
        found = compare(certificate, read_bundle(folder))
    except InputError:
        return "refused"
    if found.belongs:
        return "belongs" if check_document(certificate, time_limit=20).accepted else "rejected"
    return "differs" if found.differs else "not bound"


def main() -> int:
    """Run the study; see the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="four pairs and 40 changes")
    parser.add_argument("--changes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", action="store_true", help="write the table to results.md")
    options = parser.parse_args()
    found = [*islice(robots(), 12, 15), *islice(own_systems(), 2, 3)] if options.quick else list(pairs())
    lines, failed = examine(found, 40 if options.quick else options.changes, options.seed)
    print("\n".join(lines))
    if options.write:
        Path(__file__).with_name("results.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return int(failed)


def examine(found: list[Pair], count: int, seed: int) -> tuple[list[str], bool]:
    """Return the lines of the report, and whether an answer is wrong."""
    draw, answers, wrong, times = random.Random(seed), defaultdict[str, Counter[str]](Counter), [], []
    with tempfile.TemporaryDirectory() as scratch:
        for number, pair in enumerate(found):
            write_bundle(pair.bundle, Path(scratch, str(number)))
            began = time.perf_counter()
            if answer(pair.certificate, Path(scratch, str(number))) != "belongs":
                wrong.append(f"{pair.name}: unchanged, does not belong")
            times.append(time.perf_counter() - began)
        for number in range(count):
            pair = found[number % len(found)]
            change = changed(pair, draw)
            folder = Path(scratch, f"changed-{number}", "bundle")
            folder.parent.mkdir()
            write_bundle(pair.bundle, folder)
            change.apply(folder)
            said = answer(change.certificate, folder)
            answers[change.kind][said] += 1
            shutil.rmtree(folder.parent)
            if number % 50 == 49:
                print(f"{number + 1} of {count} changes, {len(wrong)} wrong", file=sys.stderr, flush=True)
            if said == "belongs":
                wrong.append(f"{pair.name}: {change.kind}: {change.what}")
                print(wrong[-1], file=sys.stderr, flush=True)
    words = ("differs", "not bound", "rejected", "refused", "belongs")
    lines = ["| change | number | " + " | ".join(words) + " |", "|---|---|" + "---|" * len(words)]
    for kind, row in sorted(answers.items()):
        lines.append(f"| {kind} | {row.total()} | " + " | ".join(str(row[word]) for word in words) + " |")
    lines += ["", f"{len(found)} pairs unchanged, {count} changes, {len(wrong)} wrong answers; "
              f"check and comparison of a pair: {max(times):.2f} s at most"]  # fmt: skip
    return [*lines, *(f"- {text}" for text in wrong)], bool(wrong)


if __name__ == "__main__":
    sys.exit(main())

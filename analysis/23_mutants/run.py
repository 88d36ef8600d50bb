"""Study 23: do the tests detect wrong code? Each mutant has one error; the tests for this code must fail.

    python analysis/23_mutants/run.py            # all of them; what is known already is not run again
    python analysis/23_mutants/run.py --quick    # one of them, anew
    python analysis/23_mutants/run.py --only ID  # one, or several times for several

Prints Markdown; --write writes the README from it. Status 0 when every mutant is caught, 1 when one survives, 2 for a
bad option, an `old` text that is not in its file exactly once, or tests that fail without any mutant.
"""

from __future__ import annotations

import argparse
import compileall
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from queue import SimpleQueue

from surctl.errors import InputError
from surctl.files import Strict, load_model

ROOT = Path(__file__).resolve().parents[2]
CONFIG = Path(__file__).with_name("mutants.toml")
COPIED = ("surctl", "tests", "pyproject.toml")
KNOWN = Path("surctl-out") / "mutants.jsonl"
OWN_CACHE = "surctl/ir/"  # wrong code that these files compile must not be cached for the other tests


class Mutant(Strict):
    """A mutant: one error in one file.

    Attributes:
        id: name of the mutant.
        room: the part of the code to which it belongs.
        file: the file that contains the error.
        changes: description of the error.
        old: text that is in the file exactly once.
        new: its replacement.
        tests: files or node ids, at least one of which must fail.
        quick: whether `--quick` tries it.
    """

    id: str
    room: str
    file: str
    changes: str
    old: str
    new: str
    tests: tuple[str, ...]
    quick: bool = False

    def source(self) -> str:
        """Return the text of the file with the mutant; ValueError if `old` does not occur exactly once."""
        path = ROOT / self.file
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        if (count := text.count(self.old)) != 1 or self.old == self.new:
            raise ValueError(f"{self.id}: its old text is {count} times in {self.file}, must be there once, and change")
        return text.replace(self.old, self.new)

    def digest(self) -> str:
        """Return the digest of the mutated source and of the tests."""
        files = sorted({test.partition("::")[0] for test in self.tests})
        parts = [self.file, self.source(), *self.tests, *((ROOT / f).read_text(encoding="utf-8") for f in files)]
        return sha256("\0".join(parts).encode()).hexdigest()


class Config(Strict):
    """What mutants.toml holds.

    Attributes:
        patience: [s] after which the tests of a mutant are stopped; it then counts as a survivor.
        mutant: all of them.
    """

    patience: float
    mutant: tuple[Mutant, ...]


@dataclass(frozen=True)
class Result:
    """The result of a mutant.

    Attributes:
        id, digest: of the mutant.
        status: of pytest; None where it took too long.
        failed: the first test that failed.
        seconds: of processor time.
    """

    id: str
    digest: str
    status: int | None
    failed: str
    seconds: float

    @property
    def caught(self) -> bool:
        """Return whether tests failed; an error of pytest itself does not count."""
        return self.status == 1


@contextmanager
def copy() -> Iterator[Path]:
    """A folder with the package and its tests, and with their bytecode, which holds for a source of one time and size.

    A mutant has another time (`placed`), so that bytecode never hides it.
    """
    with tempfile.TemporaryDirectory(prefix="surctl-mutants-") as name:
        folder = Path(name)
        for what in COPIED:
            if (ROOT / what).is_dir():
                shutil.copytree(ROOT / what, folder / what)  # keeps the times
            else:
                shutil.copy(ROOT / what, folder / what)
        compileall.compile_dir(folder / "surctl", quiet=2)
        yield folder


@contextmanager
def placed(mutant: Mutant, folder: Path) -> Iterator[None]:
    """The mutant in a copy; afterwards the file is as before, and so is its time."""
    place = folder / mutant.file
    whole, before = place.read_bytes(), place.stat()
    place.write_text(mutant.source(), encoding="utf-8")
    os.utime(place, (before.st_atime, before.st_mtime + 3600))
    try:
        yield
    finally:
        place.write_bytes(whole)
        os.utime(place, ns=(before.st_atime_ns, before.st_mtime_ns))


def tested(folder: Path, tests: Sequence[str], patience: float, cache: Path) -> tuple[int | None, str, float]:
    """Return the status of pytest or None, its output, and the processor time [s]."""
    words = [sys.executable, "-m", "pytest", "-x", "-q", "-rfE", "-p", "no:cacheprovider", "-p", "no:xdist"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    environment |= {
        "PYTHONPATH": str(folder),
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONHASHSEED": "0",
        "SURCTL_CACHE": str(cache),
        "OPENBLAS_NUM_THREADS": "1",
    }
    environment.pop("PYTHONPYCACHEPREFIX", None)
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(
            [*words, "-o", "addopts=", *tests],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=said,
            start_new_session=True,
        )
        end, late = time.monotonic() + patience, False
        while True:
            done, how, used = os.wait4(process.pid, os.WNOHANG)
            if done:
                break
            if not late and time.monotonic() > end:
                late = True
                os.killpg(process.pid, signal.SIGKILL)
            time.sleep(0.02)
        process.returncode = os.waitstatus_to_exitcode(how)
        said.seek(0)
        text = said.read().decode("utf-8", "replace")
    return None if late else process.returncode, text, used.ru_utime + used.ru_stime


def first_failure(text: str) -> str:
    """Return the name of the first failed test, without its parameters."""
    lines = [line for line in text.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return lines[0].split(" ", 1)[1].partition(" - ")[0].partition("[")[0] if lines else ""


def tried(mutant: Mutant, digest: str, folder: Path, patience: float) -> Result:
    """Apply a mutant to a copy, run its tests, and undo it."""
    with ExitStack() as stack:
        stack.enter_context(placed(mutant, folder))
        cache = folder / "cache"
        if mutant.file.startswith(OWN_CACHE):
            cache = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=folder)))
        status, text, seconds = tested(folder, mutant.tests, patience, cache)
    return Result(mutant.id, digest, status, first_failure(text), round(seconds, 1))


def sound(mutants: Sequence[Mutant], folder: Path, patience: float) -> tuple[str, float]:
    """Return the failures of the mutants' tests on unchanged code (empty if they pass), and the processor time [s]."""
    tests = sorted({test for mutant in mutants for test in mutant.tests})
    status, text, seconds = tested(folder, tests, patience * len(tests), folder / "cache")
    return "" if status == 0 else text[-3000:] or f"status {status}", seconds


def known(file: Path | None) -> dict[str, Result]:
    """Return results of earlier runs by digest; incomplete lines are ignored."""
    if file is None or not file.is_file():
        return {}
    found = {}
    for line in file.read_text(encoding="utf-8").splitlines():
        try:
            result = Result(**json.loads(line))
        except (ValueError, TypeError):
            continue
        found[result.digest] = result
    return found


def run(
    mutants: Sequence[Mutant], patience: float, *, workers: int, out: Path | None, say: Callable[[str], object]
) -> list[Result]:
    """Return the results of the mutants in order; RuntimeError if tests fail without a mutant."""
    results, digests = known(out), [mutant.digest() for mutant in mutants]
    waiting = [(m, digest) for m, digest in zip(mutants, digests, strict=True) if digest not in results]
    if not waiting:
        return [results[digest] for digest in digests]
    with ExitStack() as stack:
        folders: SimpleQueue[Path] = SimpleQueue()
        first = stack.enter_context(copy())
        failure, seconds = sound([mutant for mutant, _ in waiting], first, patience)
        if failure:
            raise RuntimeError(f"the tests fail without a mutant:\n{failure}")
        say(f"without a mutant: passed, {seconds:.1f} s")
        for folder in [first, *(stack.enter_context(copy()) for _ in range(min(workers, len(waiting)) - 1))]:
            folders.put(folder)

        def one(asked: tuple[Mutant, str]) -> Result:
            folder = folders.get()
            try:
                return tried(*asked, folder, patience)
            finally:
                folders.put(folder)

        with ThreadPoolExecutor(workers) as pool:
            for result in pool.map(one, waiting):
                results[result.digest] = result
                say(f"{result.id}: {'caught' if result.caught else 'survived'}, {result.seconds:.1f} s")
                if out is not None:
                    out.parent.mkdir(parents=True, exist_ok=True)
                    with out.open("a", encoding="utf-8") as file:
                        print(json.dumps(asdict(result)), file=file)
    return [results[digest] for digest in digests]


def told(mutants: Sequence[Mutant], results: Sequence[Result]) -> str:
    """The tables."""
    rooms: dict[str, list[bool]] = {}
    rows = []
    for mutant, result in zip(mutants, results, strict=True):
        rooms.setdefault(mutant.room, []).append(result.caught)
        ended = "took too long" if result.status is None else f"pytest ended with {result.status}"
        noticed = f"`{result.failed.removeprefix('tests/')}`" if result.caught else f"**survives**: {ended}"
        place = mutant.file.removeprefix("surctl/")
        rows.append(f"| `{mutant.id}` | {place} | {mutant.changes} | {noticed.replace('|', '∣')} |")
    caught, seconds = sum(r.caught for r in results), sum(r.seconds for r in results)
    lines = [f"{caught} of {len(results)} mutants are caught, in {seconds:.0f} s of processor time.", ""]
    lines += ["| part | mutants | caught |", "|---|---|---|"]
    lines += [f"| {room} | {len(which)} | {sum(which)} |" for room, which in rooms.items()]
    lines += ["", "| mutant | file | what is wrong | noticed first by |", "|---|---|---|---|", *rows]
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one of the mutants, anew")
    parser.add_argument("--only", action="append", metavar="ID", help="this mutant, anew; several times for several")
    parser.add_argument("--workers", type=int, default=1, help="copies that are tested at once")
    parser.add_argument("--out", type=Path, metavar="FILE", help=f"of results as they come; {KNOWN} if all run")
    parser.add_argument("--write", action="store_true", help="write README.md beside this file")
    given = parser.parse_args(words)
    try:
        config = load_model(CONFIG, Config)
        mutants = [m for m in config.mutant if (not given.quick or m.quick) and (not given.only or m.id in given.only)]
        if unknown := set(given.only or ()) - {m.id for m in mutants}:
            parser.error(f"--only: {', '.join(sorted(unknown))}: not among the mutants")
        if given.workers < 1:
            parser.error(f"--workers: {given.workers}: at least 1")
        if given.write and len(mutants) < len(config.mutant):
            parser.error("--write: is of all mutants; drop --quick and --only")
        out = given.out or (None if given.quick or given.only else KNOWN)
        results = run(
            mutants, config.patience, workers=given.workers, out=out, say=lambda line: print(line, file=sys.stderr)
        )
    except (InputError, ValueError, RuntimeError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    text = told(mutants, results)
    print(text)
    if given.write:
        folder = Path(__file__).parent
        about = folder.joinpath("about.md").read_text(encoding="utf-8")
        folder.joinpath("README.md").write_text(f"{about}\n{text}\n", encoding="utf-8")
    return 0 if all(result.caught for result in results) else 1


if __name__ == "__main__":
    sys.exit(main())

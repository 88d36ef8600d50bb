"""Study 38: do the tests detect a wrong checker? A mutant of every line of `certcheck` that decides or rounds.

    python analysis/38_checker_mutants/run.py                  # all mutants; known results are not computed again
    python analysis/38_checker_mutants/run.py --module region  # those of a module
    python analysis/38_checker_mutants/run.py --quick          # those of a small module, with its own tests, anew

Prints Markdown; --write writes the README from it. Status 0 if every mutant is caught, 1 if one survives, 2 for a bad
option or tests that fail without a mutant.
"""

from __future__ import annotations

import argparse
import gc
import importlib
import json
import os
import resource
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from itertools import groupby, pairwise
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import pytest
from _pytest.runner import runtestprotocol

sys.path.insert(0, str(Path(__file__).parent))
from operators import Change, changes

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "surctl" / "certcheck"
TESTS = Path("tests") / "certcheck"
QUICK = "definite"
CAUGHT = Path("surctl-out") / "checker-mutants.json"  # by mutant: a digest and the test that caught it
CALLS = Path("surctl-out") / "checker-calls.json"  # by digest of a file of tests: the functions that each test calls
SLOW = "takes too long"
_FIRST = "the first operation of a table has no operands, so it is a number or a variable"
_ITSELF = "the first is compared to itself"
EQUIVALENT = {
    "expressions: ExpressionTable.total: return all(self._is_total(self.entries[at]) for at in self.needed(roots)) -> "
    "return all(self._is_total(self.entries[at]) for at in [*(self.needed(roots))][1:])": _FIRST,
    "mission: _turns: size = root_up(funnel.trace * before) + max(map(abs, funnel.along)) + funnel.beside -> size = "
    "root_down(funnel.trace * before) + max(map(abs, funnel.along)) + funnel.beside": "the other roots round by more",
    "motion: Motion.require_continuous: table.needed(roots) -> [*(table.needed(roots))][1:]": _FIRST,
    "procedures: _checked: ast.walk(tree) -> [*(ast.walk(tree))][1:]": "the first node is the module itself",
    "slope_rows: Rows.__init__: sizes = [max(cover[k][k] for cover in covers) for k in range(self.states)] -> "
    "sizes = [min(cover[k][k] for cover in covers) for k in range(self.states)]": "numbers are scaled by a power of 2",
    "region_exact: is_positive_definite: any(a[i][j] != a[j][i] for i in range(n) for j in range(i)) -> "
    "any(a[i][j] != a[j][i] for i in [*(range(n))][1:] for j in range(i))": "the first row has nothing on its left",
    "slopes: is_definite: inner = min(len(used), max(0, (_CHUNK // len(lower)).bit_length() - 1)) -> inner = "
    "min(len(used), min(0, (_CHUNK // len(lower)).bit_length() - 1))": "the same vertices, one after the other",
    "slopes: _pair: all(x[j] * first[i] == x[i] * first[j] for x in triples.values() for j in range(3)) -> "
    "all(x[j] * first[i] == x[i] * first[j] for x in [*(triples.values())][1:] for j in range(3))": _ITSELF,
    "instructions: evaluate: part = max(1, _TABLE // max(1, block.size)) -> "
    "part = max(1, _TABLE // min(1, block.size))": "the same points, in fewer parts",
    "instructions: evaluate: part = max(1, _TABLE // max(1, block.size)) -> "
    "part = min(1, _TABLE // max(1, block.size))": "the same points, in more parts",
    "identity: Exact._reduced: atom = max(squared, key=lambda k: (len(k), k)) -> "
    "atom = min(squared, key=lambda k: (len(k), k))": "each square is replaced, in whichever order",
}
"""By name of a mutant that changes no verdict: the reason. They are not run."""


@dataclass(frozen=True)
class Mutant:
    """A mutant of a module of the checker."""

    module: str
    change: Change

    @property
    def id(self) -> str:
        """Return a name that stays the same if other lines of the module change."""
        return f"{self.module}: {self.change.function}: {self.change.old} -> {self.change.new}"

    def digest(self, test: str) -> str:
        """Return the digest of the mutated source and of the file of a test."""
        file = ROOT / test.partition("::")[0]
        text = file.read_text(encoding="utf-8") if file.is_file() else ""
        return sha256(f"{self.change.source}\0{test}\0{text}".encode()).hexdigest()


@dataclass(frozen=True)
class Result:
    """The result of a mutant: the test that caught it (or "", or `SLOW`), and the processor time [s]."""

    by: str
    seconds: float

    @property
    def caught(self) -> bool:
        """Return whether a test failed."""
        return self.by not in ("", SLOW)


def mutants(modules: Sequence[str]) -> list[Mutant]:
    """Return the mutants of these modules."""
    return [Mutant(m, c) for m in modules for c in changes((PACKAGE / f"{m}.py").read_text(encoding="utf-8"))]


def install(mutant: Mutant) -> None:
    """Give the functions of the loaded module the code of the mutant, wherever other modules refer to them."""
    module = importlib.import_module(f"surctl.certcheck.{mutant.module}".removesuffix(".__init__"))
    new = ModuleType(module.__name__)
    new.__dict__.update(__file__=module.__file__, __package__=module.__package__, __path__=vars(module).get("__path__"))
    sys.modules[module.__name__] = new  # a dataclass looks up the module of its class
    try:
        exec(compile(mutant.change.source, str(module.__file__), "exec"), vars(new))
    finally:
        sys.modules[module.__name__] = module
    _replace(vars(module), vars(new), module.__name__)


def _replace(old: Any, new: Any, module: str) -> None:
    for name, value in list(old.items()):
        other = new.get(name)
        if isinstance(value, type):
            if value.__module__ == module:
                _replace(vars(value), vars(other), module)
            continue
        function, mutated = _function(value), _function(other)
        if isinstance(function, FunctionType) and isinstance(mutated, FunctionType):
            if function.__module__ == module:
                function.__code__, function.__defaults__ = mutated.__code__, mutated.__defaults__
                function.__kwdefaults__ = mutated.__kwdefaults__
        elif name.strip("_").isupper() and repr(value) != repr(other):  # a constant of the module
            for place in _loaded():
                if vars(place).get(name) is value:
                    setattr(place, name, other)


def _function(value: Any) -> Any:
    """Return the function below a cache, a property or a method."""
    for name in ("__wrapped__", "__func__", "fget"):
        if isinstance(getattr(value, name, None), FunctionType):  # a context manager is a function around another
            return getattr(value, name)
    return value


def _loaded() -> list[ModuleType]:
    return [m for name, m in list(sys.modules.items()) if name.startswith(("surctl.certcheck", "tests.certcheck"))]


def without_caches() -> None:
    """Empty the caches of the checker's functions."""
    for module in _loaded():
        for value in list(vars(module).values()):
            if callable(clear := getattr(value, "cache_clear", None)):
                clear()


def passes(item: pytest.Item, after: pytest.Item | None) -> bool:
    """Run a test; fixtures that the test `after` it needs too stay."""
    return not any(report.failed for report in runtestprotocol(item, log=False, nextitem=after))


def forked(work: Callable[[], Any]) -> tuple[int, int]:
    """Start work in a process of its own; return its id and the end of a pipe that gets the result as JSON."""
    receive, send = os.pipe()
    process = os.fork()
    if process:
        os.close(send)
        return process, receive
    try:
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        with os.fdopen(send, "w") as pipe:
            json.dump(work(), pipe)
    finally:
        os._exit(0)  # nothing of the parent is run or written twice


def recorded(items: Sequence[pytest.Item]) -> dict[str, tuple[float, list[str]]]:
    """Return the time [s] of each test and the functions of the checker that it calls.

    Raises:
        RuntimeError: a test fails.
    """
    known = json.loads(CALLS.read_text()) if CALLS.is_file() else {}
    calls: dict[str, tuple[float, list[str]]] = {}
    for path, group in groupby(items, key=lambda item: item.path):
        tests = list(group)
        digest = sha256("\0".join([path.read_text(), *(item.nodeid for item in tests)]).encode()).hexdigest()
        called = {name.split(":")[0] for _, names in known.get(digest, {}).values() for name in names}
        if digest not in known or not all((PACKAGE / f"{module}.py").is_file() for module in called):
            process, pipe = forked(lambda tests=tests: _record(tests))
            with os.fdopen(pipe) as file:
                text = file.read()
            os.waitpid(process, 0)
            found = json.loads(text or "null")
            if not isinstance(found, dict):
                raise RuntimeError(f"a test fails without a mutant: {found or path}")
            known[digest] = found
            CALLS.write_text(json.dumps(known))
        calls |= known[digest]
    return calls


def _record(items: Sequence[pytest.Item]) -> dict[str, tuple[float, list[str]]] | str:
    called: set[Any] = set()
    calls = {}
    for item, after in pairwise((*items, None)):
        assert item is not None
        called.clear()
        without_caches()
        began = time.process_time()
        sys.setprofile(lambda frame, event, _: called.add(frame.f_code) if event == "call" else None)
        good = passes(item, None)
        sys.setprofile(None)
        if not good and not passes(item, after):  # some tests limit the time, and the profile takes time
            return item.nodeid
        names = {f"{Path(c.co_filename).stem}: {c.co_qualname.partition('.<')[0]}" for c in called
                 if c.co_filename.startswith(f"{PACKAGE}{os.sep}")}  # fmt: skip
        calls[item.nodeid] = time.process_time() - began, sorted(names)
    return calls


class Campaign:
    """A plugin of pytest that loads all tests once, and runs them on each mutant in a process of its own."""

    def __init__(self, tried: Sequence[Mutant], *, workers: int, patience: float, anew: bool) -> None:
        self.tried, self.workers, self.patience, self.anew = tried, workers, patience, anew
        self.results: dict[Mutant, Result] = {}
        self.values: dict[tuple[str, str], Any] = {}  # of the fixtures of whole files, by file and name
        self.error = "the tests cannot be loaded"

    def pytest_collection(self) -> None:
        """Let Hypothesis neither shrink nor store what it finds."""
        from hypothesis import Phase, settings  # pytest must load it first

        settings.register_profile("mutants", settings(), phases=[Phase.explicit, Phase.generate], database=None)
        settings.load_profile("mutants")

    @pytest.hookimpl(tryfirst=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Any:
        """Return the value that a fixture of a whole file had without a mutant, if it is known."""
        value = self.values.get((fixturedef.baseid, fixturedef.argname))
        if value is not None:
            fixturedef.cached_result = value, fixturedef.cache_key(request), None
        return value

    def pytest_fixture_post_finalizer(self, fixturedef: Any) -> None:
        """Store the value of a fixture of a whole file."""
        if fixturedef.scope == "module" and fixturedef.cached_result and fixturedef.cached_result[2] is None:
            self.values.setdefault((fixturedef.baseid, fixturedef.argname), fixturedef.cached_result[0])

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run the mutants."""
        try:
            calls = recorded(session.items)
        except RuntimeError as error:
            self.error = str(error)
            return True
        self.error = ""
        for item in sorted(session.items, key=lambda item: calls[item.nodeid][0]):
            fixtures = (found[-1] for found in item._fixtureinfo.name2fixturedefs.values())  # type: ignore[attr-defined]
            if any(f.scope == "module" and f.baseid == item.parent.nodeid and (f.baseid, f.argname) not in self.values
                   for f in fixtures):  # fmt: skip
                passes(item, None)
        gc.freeze()
        items = {item.nodeid: item for item in session.items}
        known: dict[str, tuple[str, str]] = json.loads(CAUGHT.read_text()) if CAUGHT.is_file() else {}
        running: dict[int, tuple[Mutant, int]] = {}
        waiting = [mutant for mutant in self.tried[::-1] if mutant.id not in EQUIVALENT]
        while waiting or running:
            while waiting and len(running) < self.workers:
                mutant = waiting.pop()
                digest, first = known.get(mutant.id, ("", ""))
                if not self.anew and first in items and digest == mutant.digest(first):
                    self.results[mutant] = Result(first, 0.0)
                    continue
                tests = sorted(_tests(mutant, calls), key=lambda test, first=first: (test != first, _cost(calls[test])))
                chosen = [items[test] for test in tests]
                process, pipe = forked(lambda m=mutant, chosen=chosen: attempt(m, chosen, self.patience))
                running[process] = mutant, pipe
            if running:
                process, _, used = os.wait3(0)
                mutant, pipe = running.pop(process)
                with os.fdopen(pipe) as file:
                    by = json.loads(file.read() or json.dumps(SLOW))
                result = self.results[mutant] = Result(by, used.ru_utime + used.ru_stime)
                if result.caught:
                    stored = json.loads(CAUGHT.read_text()) if CAUGHT.is_file() else {}  # others may run at once
                    CAUGHT.write_text(json.dumps(stored | {mutant.id: (mutant.digest(by), by)}))
                else:
                    print(f"{mutant.id}: {by or 'survives'}", file=sys.__stderr__, flush=True)
        return True


def _cost(calls: tuple[float, list[str]]) -> float:
    """Return a measure of how late a test comes: short tests that call few functions are the first."""
    return calls[0] * len(calls[1])


def _tests(mutant: Mutant, calls: dict[str, tuple[float, list[str]]]) -> list[str]:
    """Return the tests that call the function of a mutant, or the module's functions if none calls it."""
    function = f"{mutant.module}: {mutant.change.function}"
    inner = [t for t, (_, names) in calls.items() if any(n == function or function.startswith(f"{n}.") for n in names)]
    return inner or [t for t, (_, names) in calls.items() if any(n.startswith(f"{mutant.module}: ") for n in names)]


def attempt(mutant: Mutant, tests: Sequence[pytest.Item], patience: float) -> str:
    """Return the first test that fails on a mutant; empty if none does."""
    resource.setrlimit(resource.RLIMIT_CPU, (int(time.process_time() + patience) + 1,) * 2)
    without_caches()
    install(mutant)
    failed = (item.nodeid for item, after in pairwise((*tests, None)) if item and not passes(item, after))
    return next(failed, "")


def printed(tried: Sequence[Mutant], results: dict[Mutant, Result]) -> str:
    """The tables."""
    modules: dict[str, Counter[str]] = {}
    for mutant, result in results.items():
        modules.setdefault(mutant.module, Counter()).update(["mutants", *["caught"] * result.caught])
    caught = sum(result.caught for result in results.values())
    same = [mutant for mutant in tried if mutant.id in EQUIVALENT]
    lines = [f"{caught} of {len(results)} mutants are caught; {len(same)} others change no verdict.", "",
             "| module | mutants | caught |", "|---|---|---|"]  # fmt: skip
    lines += [f"| `{name}` | {n['mutants']} | {n['caught']} |" for name, n in sorted(modules.items())]
    if left := sorted({path.stem for path in PACKAGE.glob("*.py")} - {mutant.module for mutant in tried}):
        lines += ["", f"Modules that were not run: {', '.join(f'`{name}`' for name in left)}."]
    kinds = Counter(mutant.change.kind for mutant in results)
    lines += ["", "| the mutant | number |", "|---|---|", *(f"| {k} | {n} |" for k, n in sorted(kinds.items()))]
    open_ = [m for m, r in results.items() if not r.caught]
    for what, rows in (
        ("survives", [(m, "") for m in open_]),
        ("changes nothing", [(m, EQUIVALENT[m.id]) for m in same]),
    ):
        lines += ["", f"| {what} | instead of | with | because |", "|---|---|---|---|"] if rows else []
        for mutant, reason in rows:
            change = mutant.change
            texts = (f"`{text.replace('|', '∣')}`" for text in (change.old, change.new))
            lines.append(f"| `{mutant.module}`, {change.function} | {' | '.join(texts)} | {reason} |")
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=f"the mutants of {QUICK}, with its own tests")
    parser.add_argument("--module", action="append", metavar="NAME", help="of this module; several times for several")
    parser.add_argument("--tests", nargs="+", metavar="FILE", help=f"only these instead of all in {TESTS}")
    parser.add_argument("--workers", type=int, default=1, help="mutants that are tested at once")
    parser.add_argument("--patience", type=float, default=30.0, help="processor time [s] of the tests of a mutant")
    parser.add_argument("--write", action="store_true", help="write README.md beside this file")
    given = parser.parse_args(words)
    names = sorted(path.stem for path in PACKAGE.glob("*.py"))
    if unknown := set(given.module or ()) - set(names):
        parser.error(f"--module: {', '.join(sorted(unknown))}: not among {', '.join(names)}")
    if given.write and given.quick:
        parser.error("--write: the README is not written from --quick; drop one of both")
    os.chdir(ROOT)
    CAUGHT.parent.mkdir(exist_ok=True)
    tried = mutants([QUICK] if given.quick else given.module or names)
    campaign = Campaign(tried, workers=given.workers, patience=given.patience, anew=given.quick)
    tests = [f"{TESTS}/test_{QUICK}.py"] if given.quick else given.tests or [str(TESTS)]
    options = ["-qq", "--no-summary", "-o", "addopts=", "-p", "no:cacheprovider", "-p", "no:xdist"]
    pytest.main([*tests, *options], plugins=[campaign])
    if campaign.error:
        print(f"error: {campaign.error}", file=sys.stderr)
        return 2
    text = printed(tried, {mutant: campaign.results[mutant] for mutant in tried if mutant in campaign.results})
    print(text)
    if given.write:
        folder = Path(__file__).parent
        about = folder.joinpath("about.md").read_text(encoding="utf-8")
        folder.joinpath("README.md").write_text(f"{about}\n{text}\n", encoding="utf-8")
    return 0 if all(result.caught for result in campaign.results.values()) else 1


if __name__ == "__main__":
    sys.exit(main())

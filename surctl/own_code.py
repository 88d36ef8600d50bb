"""Functions in a user's file, FILE.py:FUNCTION: --trust, SHA-256, imports from its folder, errors with line, remedy.

A pinned reference is one text, `FILE.py:FUNCTION#SHA256` with the absolute path, so that cases, caches, recordings and
worker processes can store this text like the name of a built-in object. Before the function runs, the file is compared
with the SHA-256.
"""

from __future__ import annotations

import contextlib
import hashlib
import sys
import traceback
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from surctl.errors import InputError, SurctlError, nearest

__all__ = ["called", "check_trusted", "is_own", "label", "object_of", "own_file", "pinned", "remedy_of"]

Built = TypeVar("Built")

_MARK = ".py:"
_REMEDIES = {
    "truth value of a CasADi": "use casadi.if_else instead of if, casadi.fmax instead of max, casadi.logic_and for and",
    "has no number": "use casadi.sin instead of math.sin, and the like, and no float()",
}
"""Remedies by a part of the message of an error."""
_LONGEST = 200  # characters of an error of the user's code in the message


def is_own(reference: str) -> bool:
    """Return whether a reference names a function in a file, and not something built in.

    Example:
        >>> from surctl.own_code import is_own
        >>> is_own("my_law.py:wall"), is_own("guarded")
        (True, False)
    """
    return _MARK in reference


def pinned(reference: str, *, key: str, folder: Path | None = None) -> str:
    """Return the reference with the file's absolute path and the SHA-256 of its text.

    Args:
        reference: FILE.py:FUNCTION, with or without #SHA256.
        key: option or key that holds the reference, for error messages.
        folder: folder of a relative path; None: the working folder.

    Raises:
        InputError: the file cannot be read, or its text is not the one that #SHA256 states.

    Example:
        >>> from pathlib import Path
        >>> from surctl.own_code import label, pinned
        >>> _ = Path("mine.py").write_text("def answer():\\n    return 42\\n")
        >>> reference = pinned("mine.py:answer", key="--law")
        >>> label(reference), reference[-8:]
        ('mine.py:answer', '058f8c76')
    """
    path, function, stated = _parts(reference)
    whole = (folder or Path()) / path
    digest = hashlib.sha256(_text(whole, key)).hexdigest()
    if stated and stated != digest:
        raise InputError(
            "has changed since this program first read it",
            file=whole,
            key=key,
            value=f"{path.name}:{function}",
            remedy="restore the file, or start again with its present text",
        )
    return f"{whole.resolve()}:{function}#{digest}"


def label(reference: str) -> str:
    """Return a reference without folder and SHA-256, for display; the name of a built-in object is unchanged.

    Example:
        >>> from surctl.own_code import label
        >>> label("/home/ann/my_law.py:wall#2cf24dba"), label("guarded")
        ('my_law.py:wall', 'guarded')
    """
    if not is_own(reference):
        return reference
    path, function, _ = _parts(reference)
    return f"{path.name}:{function}"


def own_file(reference: str) -> str:
    """Return FILE.py:FUNCTION with the absolute path, without SHA-256: for error messages and commands.

    Example:
        >>> from surctl.own_code import own_file
        >>> own_file("/home/ann/my_law.py:wall#2cf24dba")
        '/home/ann/my_law.py:wall'
    """
    return reference.partition("#")[0]


def check_trusted(reference: str, *, file: object, key: str, trust: bool) -> None:
    """Raise InputError if a file names a function, so that its code would run, and the user did not set `trust`.

    Example:
        >>> from surctl.own_code import check_trusted
        >>> check_trusted("my_law.py:wall", file="a.toml", key="law", trust=False)
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: a.toml: law = 'my_law.py:wall': names Python code; read it, then add --trust to run it
    """
    if is_own(reference) and not trust:
        raise InputError(
            "names Python code",
            file=file,
            key=key,
            value=label(reference),
            remedy="read it, then add --trust to run it",
        )


@cache
def object_of(reference: str, kind: type[Built], *, key: str) -> Built:
    """Return the object that a function returns when called without arguments; the object is cached.

    Args:
        reference: pinned reference, see `pinned`.
        kind: class of the object.
        key: option or key that holds the reference, for error messages.

    Raises:
        InputError: the file has changed, has no such function, or raises an error, or the function returns another
            type.

    Example:
        >>> from pathlib import Path
        >>> from surctl.own_code import object_of, pinned
        >>> _ = Path("mine.py").write_text("def answer():\\n    return 42\\n")
        >>> object_of(pinned("mine.py:answer", key="--law"), int, key="--law")
        42
    """
    path, function, stated = _parts(reference)
    space = _executed(path, stated, key)
    builder = space.get(function)
    if function in space and not callable(builder):
        problem, remedy = f"is of type {type(builder).__name__}, not a function", "write a function that returns it"
        raise InputError(problem, file=path, key=key, value=function, remedy=remedy)
    if not callable(builder):
        here = space["__name__"]
        known = [name for name, value in space.items() if getattr(value, "__module__", None) == here]
        remedy = nearest(function, known) if known else f"write a function {function} that returns a {kind.__name__}"
        raise InputError("has no such function", file=path, key=key, value=function, remedy=remedy)
    built = _guarded(path, function, builder)
    if not isinstance(built, kind):
        raise InputError(
            f"returns {type(built).__name__}, not {kind.__name__}",
            file=path,
            key=function,
            remedy=f"return a surctl {kind.__name__}",
        )
    return built


@cache
def _executed(path: Path, digest: str, key: str) -> dict[str, object]:
    """Run the file as a module of its own."""
    text = _text(path, key)
    if hashlib.sha256(text).hexdigest() != digest:
        raise InputError(
            "has changed since this program first read it", file=path, key=key, remedy="start again with its new text"
        )
    name = f"surctl_own_{path.stem}_{digest[:12]}"
    module = ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module
    try:
        # not through the import system, whose cached bytecode can be that of another text
        _guarded(path, "import", lambda: exec(compile(text, path, "exec"), vars(module)))
    except BaseException:
        del sys.modules[name]
        raise
    return vars(module)


def called(reference: str, function: Callable[..., Any], *arguments: object) -> Any:
    """Call a function of the file that a reference names; an error in the file becomes one line with its location.

    Example:
        >>> from surctl.own_code import called
        >>> called("mine.py:answer", lambda: 1 / 0)
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: mine.py: answer: fails with ZeroDivisionError: division by zero; correct the file
    """
    path, name, _ = _parts(reference)
    return _guarded(path, name, lambda: function(*arguments))


@contextlib.contextmanager
def _searched(folder: Path) -> Iterator[None]:
    """Search the folder for imports, as for a script; restore sys.path afterwards, also if the code changes it."""
    path, before = sys.path, list(sys.path)
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        path[:] = before
        sys.path = path


def _guarded(path: Path, key: str, call: Callable[[], Any]) -> Any:
    try:
        # what the file prints must not stand in a command's JSON
        with _searched(path.parent), contextlib.redirect_stdout(sys.stderr):
            return call()
    except InputError as error:
        line = None if error.__cause__ is None else _line(path, error.__cause__)
        raise error.inside(path if line is None else f"{path}, line {line}", error.key or key) from None
    except SurctlError:
        raise
    except (Exception, SystemExit) as error:
        line = error.lineno if isinstance(error, SyntaxError) else _line(path, error)
        text = " ".join(str(error).split())
        text = text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
        raise InputError(
            f"fails with {type(error).__name__}: {text}",
            file=path if line is None else f"{path}, line {line}",
            key=key,
            remedy=remedy_of(error),
        ) from error


def remedy_of(error: Exception | SystemExit) -> str:
    """Return what to do about an error of the user's code, such as one that CasADi raises for `if` on an expression.

    Example:
        >>> from surctl.own_code import remedy_of
        >>> remedy_of(ZeroDivisionError("division by zero"))
        'correct the file'
    """
    return next((remedy for part, remedy in _REMEDIES.items() if part in str(error)), "correct the file")


def _line(path: Path, error: BaseException) -> int | None:
    """Return the last line of the file that the traceback of an error contains."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    return lines[-1] if lines else None


def _parts(reference: str) -> tuple[Path, str, str]:
    path, _, rest = reference.rpartition(_MARK)
    function, _, digest = rest.partition("#")
    return Path(f"{path}{_MARK[:-1]}"), function, digest


def _text(path: Path, key: str) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", file=path, key=key, remedy="give FILE.py:FUNCTION"
        ) from None

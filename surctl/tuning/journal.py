"""Storage of trials in optuna's journal, batch by batch, so that an interrupted tuning can resume."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from surctl.errors import InputError
from surctl.files import write_file

if TYPE_CHECKING:
    from optuna import Study
    from optuna.storages import JournalStorage
    from optuna.trial import FrozenTrial

__all__ = ["BEST", "Journal", "quiet_optuna"]

BEST = "best-so-far.toml"
"""Name of the gain file that an unfinished tuning leaves beside its journal."""

_OBJECTIVES = ["minimize", "minimize"]
_HARMED = (ValueError, KeyError, TypeError, AttributeError)  # possible errors when a file is not a journal


def quiet_optuna() -> Any:
    """Import the module optuna on first use, limit its log to warnings, and return it."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


class Journal:
    """File that stores the finished trials of each optuna study under the name of the study.

    Only one process at a time can lock the file; the lock ends with the process. An incomplete last line, which an
    interrupted process may leave, is removed.

    Args:
        path: path of the file; None stores the trials in memory.

    Raises:
        InputError: the file is in use, cannot be used, or is not a journal.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self._file: BinaryIO | None = None if path is None else _hold(path)
        self._storage: Any = None
        self._in_memory: dict[str, list[FrozenTrial]] = {}
        self._held: Callable[[], AbstractContextManager[None]] = nullcontext
        if path is not None:
            try:
                self._storage, self._held = _open(path)
            except InputError:
                self.close()
                raise

    def close(self) -> None:
        """Close the file and release its lock."""
        if self._file is not None:
            self._file.close()

    def note_best(self, text: str) -> None:
        """Write the text of the best gains so far to the file `BEST` beside the journal; InputError if it cannot."""
        if self.path is not None:
            write_file(self.path.with_name(BEST), text)

    def trials(self, name: str) -> list[FrozenTrial]:
        """Return the finished trials of a study, oldest first; InputError if the file cannot be used."""
        if self._storage is None:
            return list(self._in_memory.get(name, []))
        with self._file_errors():
            finished: list[FrozenTrial] = self._study(name).get_trials()
        return finished

    def append(self, name: str, trials: Sequence[FrozenTrial]) -> None:
        """Write finished trials to the disk at once, before the call returns; InputError if the disk is full."""
        if self._storage is None:
            self._in_memory.setdefault(name, []).extend(trials)
            return
        with self._file_errors():
            study = self._study(name)
            with self._held():
                study.add_trials(trials)

    @contextmanager
    def _file_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            why = f"cannot be written ({error.strerror})"
            raise InputError(why, file=self.path, key="--out", remedy="free disk space; the command resumes") from None
        except _HARMED:
            raise _unusable(self.path or Path(), "it is not a journal of trials") from None

    def _study(self, name: str) -> Study:
        optuna = quiet_optuna()
        return optuna.create_study(storage=self._storage, study_name=name, directions=_OBJECTIVES, load_if_exists=True)


def _hold(path: Path) -> BinaryIO:
    # opened and locked, without an incomplete line at the end
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("a+b")
    except OSError as error:
        raise _unusable(path, str(error.strerror)) from None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise _unusable(path, "another tuning uses it") from None
    file.seek(0)
    whole = file.read()
    if whole and not whole.startswith(b'{"op_code"'):
        file.close()
        raise _unusable(path, "it is not a journal of trials")
    os.truncate(path, whole.rfind(b"\n") + 1)
    return file


def _open(path: Path) -> tuple[JournalStorage, Any]:
    # the context manager collects all entries and writes them together at its exit
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock

    class Alone(JournalFileOpenLock):  # type: ignore[misc]
        # does nothing, because this process has already locked the file
        def acquire(self) -> bool:
            return True

        def release(self) -> None:
            return None

    class Batched(JournalFileBackend):  # type: ignore[misc]
        # one disk access for a batch of trials, instead of one access per entry
        def __init__(self, file: str) -> None:
            super().__init__(file, Alone(file))
            self.written = Path(file).read_bytes().count(b"\n")
            self.back: list[dict[str, Any]] | None = None

        def append_logs(self, logs: list[dict[str, Any]]) -> None:
            if self.back is not None:
                self.back += logs
                return
            super().append_logs(logs)
            self.written += len(logs)

        def read_logs(self, log_number_from: int) -> Iterator[dict[str, Any]]:
            yield from super().read_logs(log_number_from)
            yield from (self.back or [])[max(0, log_number_from - self.written) :]

        @contextmanager
        def held(self) -> Iterator[None]:
            self.back = []
            try:
                yield
            finally:
                logs, self.back = self.back, None
                if logs:
                    self.append_logs(logs)

    backend = Batched(str(path))
    try:
        return JournalStorage(backend), backend.held
    except _HARMED:
        raise _unusable(path, "it is not a journal of trials") from None


def _unusable(path: Path, why: str) -> InputError:
    return InputError(f"cannot be used ({why})", file=path, key="--out", remedy="name another folder with --out")

"""Where a sweep keeps its finished points, so that a killed one resumes."""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Sequence
from pathlib import Path

from surctl import __version__
from surctl.errors import InputError

__all__ = ["Store"]


class Store:
    """A CSV file of grid points; its first line names the request, and another request starts afresh.

    Args:
        path: the file; None keeps nothing.
        request: text of everything that the result depends on.
        columns: names of the columns after the two grid indices.
    """

    def __init__(self, path: Path | None, *, request: str, columns: Sequence[str]) -> None:
        self.path, self.columns = path, tuple(columns)
        digest = hashlib.sha256(request.encode()).hexdigest()
        self.title = f"# surctl {__version__} sweep {digest}"

    def load(self) -> dict[tuple[int, int], tuple[float, ...]]:
        """Finished points of the same request; a line that a kill cut short is dropped.

        Raises:
            InputError: the file cannot be read or written.
        """
        if self.path is None:
            return {}
        try:
            text = self.path.read_text(encoding="utf-8") if self.path.exists() else ""
            lines = text.splitlines()
            kept = lines[2:] if lines[:1] == [self.title] else []
            rows = {point: row for point, row in map(self._parse, csv.reader(kept)) if point is not None}
            self.path.parent.mkdir(parents=True, exist_ok=True)
            # written anew, so that a half line does not stay in the middle
            self.path.write_text("\n".join([self.title, ",".join(("i", "j", *self.columns)), ""]), encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(
                f"cannot be used ({error})", file=self.path, key="store", remedy="name another folder with --out"
            ) from None
        for point, row in rows.items():
            self.append(point, row)
        return rows

    def append(self, point: tuple[int, int], row: Sequence[float]) -> None:
        """Add one finished point and flush it."""
        if self.path is None:
            return
        with self.path.open("a", encoding="utf-8", newline="") as file:
            csv.writer(file).writerow([*point, *(repr(float(v)) for v in row)])

    def _parse(self, fields: Sequence[str]) -> tuple[tuple[int, int] | None, tuple[float, ...]]:
        try:
            if len(fields) != len(self.columns) + 2:
                return None, ()
            return (int(fields[0]), int(fields[1])), tuple(float(f) for f in fields[2:])
        except ValueError:
            return None, ()

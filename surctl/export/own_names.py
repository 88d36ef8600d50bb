"""File-scope C names with the prefix of their file, so that files of several bundles may form one compilation unit."""

from __future__ import annotations

import re

__all__ = ["with_own_names"]

_FUNCTION = re.compile(r"^static (?:inline )?(?:const )?\w+ \*?(\w+)\(", re.MULTILINE)


def with_own_names(text: str, prefix: str, *, bundle: str) -> str:
    """Return C text whose static functions begin with `prefix`, unless they begin with the bundle's name already.

    Members of structs (after `.` or `->`) keep their names, and so do comments and strings without a call.
    """
    names = {name for name in _FUNCTION.findall(text) if not name.startswith(f"{bundle}_")}
    if not names:
        return text
    call = re.compile(rf"(?<![\w.>])({'|'.join(sorted(map(re.escape, names)))})(?=\()")
    return call.sub(rf"{prefix}_\1", text)

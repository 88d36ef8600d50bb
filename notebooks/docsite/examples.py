"""An extension of the docstring parser: `Example:` is code, as `Examples:` is; `__post_init__` is not shown."""

from __future__ import annotations

import re
from typing import Any

import griffe


class Examples(griffe.Extension):
    """Rename the section in each docstring before it is parsed; otherwise the code becomes running text."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rename the section of one module, class, function or attribute; hide the checks of a dataclass."""
        if obj.is_class:
            obj.members.pop("__post_init__", None)
        if obj.docstring:
            obj.docstring.value = re.sub(r"^( *)Example:$", r"\1Examples:", obj.docstring.value, flags=re.MULTILINE)

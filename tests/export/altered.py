"""A bundle whose C was changed."""

from __future__ import annotations

import re
from dataclasses import replace
from types import MappingProxyType

from surctl.export import Bundle


def altered(bundle: Bundle, pattern: str, new: str) -> Bundle:
    """The bundle with the first match of a pattern in its C changed; it is in one file alone."""
    files = [file for file in bundle.sources if re.search(pattern, bundle.files[file], flags=re.DOTALL)]
    assert len(files) == 1, files
    text = re.sub(pattern, new, bundle.files[files[0]], count=1, flags=re.DOTALL)
    return replace(bundle, files=MappingProxyType({**bundle.files, files[0]: text}))

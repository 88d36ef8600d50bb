"""The two programs of the guide "Coming from pink": that of surctl, and that of pink if it is installed.

python analysis/45_robots/from_pink.py
"""

from __future__ import annotations

import doctest
import importlib.util
import os
import re
import tempfile
from pathlib import Path
from typing import Any

PAGE = Path(__file__).parents[2] / "notebooks" / "guides" / "coming-from" / "pink.md"


def main() -> None:
    """Run the programs and compare where they end."""
    text = PAGE.read_text(encoding="utf-8")
    examples = [
        example
        for block in re.findall(r"^```pycon\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)
        for example in doctest.DocTestParser().get_examples(block)
    ]
    program = re.search(r"^```text\n(import pink.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)
    assert program is not None
    names: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        print("surctl: ", end="")
        for example in examples:
            exec(example.source, names)
        if importlib.util.find_spec("pink") is None:
            print("pink is not installed: pip install pin-pink daqp")
        else:
            theirs = dict(names)
            exec(program[1], theirs)
            q = theirs["configuration"].q
            away = 1e3 * abs(names["arm"].pose("tool", q) - names["goal"])[:3, 3].max()
            print(
                f"pink: {away:.4f} mm from the goal; largest difference of a joint {abs(q - names['q']).max():.1e} rad"
            )
        os.chdir(PAGE.parent)


if __name__ == "__main__":
    main()

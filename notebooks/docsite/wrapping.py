"""Where a browser may break a line of code: not inside an option or a short name, but after each part of a path."""

from __future__ import annotations

import re
from html import unescape

__all__ = ["LONGEST", "with_whole_words"]

LONGEST = 24  # characters that stay together; they fit beside each other on a phone
_COMMANDS = re.compile(r'<div class="language-(?:console|text) highlight">.*?</div>', re.DOTALL)
_INLINE = re.compile(r"(?<!<pre>)(?<!</span>)<code>([^<]*)</code>")
_FIRST = re.compile(r"<code[^>]*>(?:<span[^>]*>|<a [^>]*></a>)*(?:python|surctl|pip|git) ")
_TAG = re.compile(r"(<[^>]+>)")
_HYPHENATED = re.compile(r"[^\s<>]*-[^\s<>]*")


def with_whole_words(html: str) -> str:
    """Return the page with options and short names that browsers do not break at a hyphen, also in commands."""
    html = _COMMANDS.sub(lambda found: _commands(found[0]), html)
    return _INLINE.sub(lambda found: _inline(found[1]), html)


def _inline(text: str) -> str:
    kind = ' class="long"' if len(unescape(text)) > 2 * LONGEST else ""  # may break anywhere in a narrow column
    return f"<code{kind}>{_paths(_whole(text))}</code>"


def _commands(block: str) -> str:
    if "language-text" in block:
        if not _FIRST.search(block):
            return block
        block = block.replace("language-text", "language-console", 1)
    return "".join(part if part.startswith("<") else _whole(part) for part in _TAG.split(block))


def _whole(text: str) -> str:
    def one(found: re.Match[str]) -> str:
        word = unescape(found[0])
        short = len(word) <= LONGEST and any(letter.isalpha() for letter in word)
        return f'<span class="whole">{found[0]}</span>' if short else found[0]

    return _HYPHENATED.sub(one, text)


def _paths(text: str) -> str:
    # a long path may break after each folder and file
    if len(text) <= LONGEST:
        return text
    return "".join(
        part if part.startswith("<") else re.sub(r"(/|::)(?=\w)", r"\1<wbr>", part) for part in _TAG.split(text)
    )

"""Terms of the glossary: the first use of a term on a page is linked to its definition."""

from __future__ import annotations

import re
from pathlib import Path

__all__ = ["link_terms", "terms_of"]

_ENTRY = re.compile(r"^### (.+?) \{ ?#([\w-]+) ?\}$", re.MULTILINE)
_TAG = re.compile(r"(<[^>]+>)")
_CLOSED = ("code", "pre", "a", "h1", "h2", "h3", "h4", "th", "math", "strong")


def terms_of(glossary: Path) -> dict[str, str]:
    """Return the anchor of each term: `### term, other form { #anchor }` is one entry."""
    found = _ENTRY.findall(glossary.read_text(encoding="utf-8"))
    return {form.strip(): anchor for forms, anchor in found for form in forms.split(",")}


def link_terms(html: str, terms: dict[str, str], page: str) -> str:
    """Link the first use of each term in running text to the glossary."""
    if not terms:
        return html
    longest = sorted(terms, key=len, reverse=True)
    short = [form for form in longest if form.isupper()]  # abbreviations: LOS is not "loses"
    words, letters = ("|".join(map(re.escape, forms)) for forms in ([f for f in longest if f not in short], short))
    word = re.compile(rf"(?<![\w-])(?<!s' )(?:({words})(?:e?s)?|(?-i:({letters})s?))(?![\w-])", re.IGNORECASE)
    anchors = {form.lower(): anchor for form, anchor in terms.items()}
    used: set[str] = set()
    inside: list[str] = []

    def linked(found: re.Match[str]) -> str:
        anchor = anchors[(found[1] or found[2]).lower()]
        if anchor in used:
            return found[0]
        used.add(anchor)
        return f'<a class="term" href="{page}#{anchor}">{found[0]}</a>'

    out: list[str] = []
    for part in _TAG.split(html):
        if part.startswith("<"):
            name = re.match(r"</?(\w+)", part)
            if name and name[1] in _CLOSED:
                inside = inside[:-1] if part.startswith("</") else [*inside, name[1]]
            out.append(part)
        else:
            out.append(part if inside else word.sub(linked, part))
    return "".join(out)

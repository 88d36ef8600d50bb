r"""Formulas as MathML: `$…$` and `$$…$$` of a page become elements that browsers draw without script or network.

Pages of the guides state formulas in TeX, docstrings with Unicode characters, which `help()` shows as they are.
"""

from __future__ import annotations

import re
from html import unescape
from html.entities import html5
from xml.etree import ElementTree

from docutils.utils.math.latex2mathml import tex2mathml

__all__ = ["as_mathml", "equation_links", "with_mathml"]

_INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)
_BLOCK = re.compile(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', re.DOTALL)
_NUMBER = re.compile(r"(?<![\w)(])\((\d{1,2})\)")
_TAG = re.compile(r"(<[^>]+>)")
_ENTITY = re.compile(r"&((?!amp;|lt;|gt;|quot;)\w+;)")
_SPACE, _ACCENTS = "http://www.w3.org/1998/Math/MathML", ("˙", "¨", "^", "~", "¯")
LAST = 20  # equations of the paper


def with_mathml(html: str) -> str:
    """Return the page with MathML in place of TeX; ValueError names a formula that cannot be converted."""
    html = _BLOCK.sub(lambda found: _formulas(found[1]), html)
    return _INLINE.sub(lambda found: as_mathml(found[1]), html)


def _formulas(tex: str) -> str:
    """Return displayed formulas; on a narrow screen, those that `\\qquad` separates are set below each other."""
    parts = [""]
    for piece in re.split(r"\\qquad", tex):
        whole = parts[-1].count("{") == parts[-1].count("}") and parts[-1].count(r"\begin") == parts[-1].count(r"\end")
        if parts[-1] and whole:
            parts.append(piece)
        else:
            parts[-1] += rf"\qquad{piece}" if parts[-1] else piece
    shown = "".join(as_mathml(part, block=True) for part in parts)
    return shown if len(parts) == 1 else f'<div class="formulas">{shown}</div>'


def as_mathml(tex: str, *, block: bool = False) -> str:
    """Return a formula in TeX as MathML; ValueError names one that cannot be converted."""
    try:
        return _accents(str(tex2mathml(unescape(tex).strip(), as_block=block)))
    except Exception as error:
        raise ValueError(f"formula {tex!r}: {error}") from error


def _accents(mathml: str) -> str:
    """Set the index of an accented letter beside it: docutils sets it below. Bars of a norm keep the height of text."""
    ElementTree.register_namespace("", _SPACE)
    tree = ElementTree.fromstring(_ENTITY.sub(lambda found: html5.get(found[1], found[0]), mathml))
    for stacked in list(tree.iter(f"{{{_SPACE}}}munderover")):
        letter, index, accent = stacked
        if accent.text in _ACCENTS:
            over = ElementTree.Element(f"{{{_SPACE}}}mover", accent="true")
            over.extend((letter, accent))
            stacked.tag = f"{{{_SPACE}}}msub"
            stacked[:] = [over, index]
    for bar in tree.iter(f"{{{_SPACE}}}mo"):
        if bar.text in ("‖", "|", "∥"):
            bar.set("stretchy", "false")
    return ElementTree.tostring(tree, encoding="unicode")


def equation_links(html: str, page: str) -> str:
    """Link the numbers (1) to (20) of the paper's equations in running text to their formulas."""
    out: list[str] = []
    inside: list[str] = []
    for part in _TAG.split(html):
        if part.startswith("<"):
            name = re.match(r"</?(\w+)", part)
            if name and name[1] in ("code", "pre", "a", "h1", "h2", "h3", "h4"):
                inside = inside[:-1] if part.startswith("</") else [*inside, name[1]]
            out.append(part)
        elif inside:
            out.append(part)
        else:
            out.append(_NUMBER.sub(lambda found: _linked(found, page), part))
    return "".join(out)


def _linked(found: re.Match[str], page: str) -> str:
    number = int(found[1])
    return f'<a href="{page}#eq-{number}">({number})</a>' if 1 <= number <= LAST else found[0]

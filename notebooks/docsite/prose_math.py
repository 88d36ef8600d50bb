"""Formulas within the sentences of docstrings: a run of symbols and operators is found and marked for MathML.

Docstrings state formulas with Unicode characters (V̇ ≤ −a V, with V = ξᵀPξ), so `help()` and editors show them as they
are. A formula begins and ends with a symbol, a number or a bracket, and has an operator, an index or an accent.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable
from html import escape, unescape

__all__ = ["formulas_in", "mark_formulas"]

_MARKS = "\u0302\u0303\u0304\u0307\u0308"
_LETTER = rf"[A-Za-zα-ωϑϕΓΔΘΛΞΠΦΨΩ][{_MARKS}]?"
_SYMBOL = rf"{_LETTER}\d{{0,2}}(?:_(?:[A-Za-z0-9]+|{_LETTER}))?(?:[⁰¹²³⁴-⁹⁺⁻ᵀ]+|\*(?!\*))?"
_FUNCTION = r"(?:sin|cos|tan|exp|log|ln|min|max|det|diag|atan2?|asin|acos|tanh|sat|sign)(?=\()"
_TOKEN = re.compile(
    rf"(?P<relation>[=≤≥<>≈≠∈⪯⪰←→])|(?P<operator>[+−·/×±,;|])|(?P<open>‖[⁰¹²³⁴-⁹]*|[(√∂∇∫Σ½])|(?P<close>\)[⁰¹²³⁴-⁹⁺⁻ᵀ]*)"
    rf"|(?P<function>{_FUNCTION})|(?P<number>\d+(?:\.\d+)?(?:[⁰¹²³⁴-⁹⁺⁻]+)?)|(?P<symbol>(?:{_SYMBOL})+)"
)
_STRONG = re.compile(rf"[=≤≥≈≠∈⪯⪰‖√∂∇∫Σ½⁰¹²³⁴-⁹⁺⁻ᵀ{_MARKS}]|[<>]|[^\W\d]_\w|[\w)]·[\w(]")
_UNITS = frozenset(["m", "s", "N", "kg", "rad", "Hz", "mm", "cm", "g", "Pa", "W", "ms", "us", "ns", "Nm", "deg"])
_UNIT = re.compile(
    rf"(?:1|{'|'.join(sorted(_UNITS))})[⁰¹²³⁴-⁹⁺⁻]*(?:[ ·/(]+(?:{'|'.join(sorted(_UNITS))})\)?[⁰¹²³⁴-⁹⁺⁻]*)*"
)
_SHAPE = re.compile(r"\((?:[^()]|\([^()]*\))*,\)| \([A-Za-z0-9·+ ]+(?:, [A-Za-z0-9·+ ]+)+\)| \([A-Z]\d+\)")
_NAMED = re.compile(rf"\w_(?:{'|'.join(sorted(_UNITS - {'m', 's', 'g', 'W', 'N'}))}|index)")  # a column of a table
_LINK = re.compile(r"\(\d{1,2}\)")  # a number of an equation, no factor
_LEAST = 2  # tokens of a formula without index or accent


def _is_symbol(word: str) -> bool:
    """Return whether letters in a row are a symbol or a product, and no word."""
    letters = re.findall(r"[^\W\d_]", word.split("_", 1)[0])
    if len(letters) == 1 or (len(word) == len(letters) == _LEAST and (word.isupper() or word in ("dt", "dx"))):
        return True
    plain = re.fullmatch(r"[A-Za-z0-9_*]+", word)
    return not plain and not re.search(r"[a-z]{3}", word.split("_", 1)[0])


def formulas_in(text: str) -> list[tuple[int, int]]:
    """Return begin and end of each formula in a text without markup.

    Example:
        >>> text = unicodedata.normalize("NFD", "Return c > 0 [1/s] such that V̇ ≤ −a V for V = ξᵀPξ.")
        >>> [unicodedata.normalize("NFC", text[a:b]) for a, b in formulas_in(text)]
        ['c > 0', 'V̇ ≤ −a V', 'V = ξᵀPξ']
    """
    found: list[tuple[int, int]] = []
    at = 0
    while at < len(text):
        run = _run(text, at)
        span = _trimmed(text, run)
        if span is not None:
            found.append(span)
        at = run[-1][1] if run else at + 1
        if not run:  # to the end of this word
            word = re.compile(r"\w+").match(text, at - 1)
            at = max(at, word.end()) if word else at
    return found


def _run(text: str, at: int) -> list[tuple[int, int, str]]:
    """Return the tokens (begin, end, kind) of the longest row of symbols and operators at a place."""
    run: list[tuple[int, int, str]] = []
    if at and (text[at - 1].isalnum() or text[at - 1] in "_`\"'/.-^|"):
        return run
    depth = 0
    while at < len(text):
        space = re.compile(r"\s+").match(text, at)
        begin = space.end() if space and run else at
        token = _TOKEN.match(text, begin)
        if token is None or _LINK.match(text, begin) or _SHAPE.match(text, begin - bool(space)) or (space and not run):
            break
        kind, word = str(token.lastgroup), token[0]
        after = text[token.end() : token.end() + 1]
        if kind == "symbol" and (not _is_symbol(word) or after.isalnum() or after in ("_", "'", "’", "-")):
            break
        if kind == "number" and (after.isalnum() and not re.match(r"[A-Za-zα-ω]\b", text[token.end() :])):
            break
        if run and run[-1][2] == "number" and space and word in _UNITS:
            break
        if run and space and word in ("a", "I") and run[-1][2] in ("symbol", "number", "close"):
            break
        if word in (",", ";") and depth <= 0:
            break
        if kind == "close":
            if depth <= 0:
                break
            depth -= 1
        depth += word == "("
        run.append((begin, token.end(), kind))
        at = token.end()
    return run


def _trimmed(text: str, run: list[tuple[int, int, str]]) -> tuple[int, int] | None:
    """Return the part of a row of tokens that is a formula, or None."""
    run = list(run)
    while run and (run[0][2] in ("relation", "close") or text[run[0][0]] in "+·/×,;"):
        run.pop(0)
    while run and run[0][2] == "symbol" and text[run[0][0] : run[0][1]] in ("a", "I") and len(run) > 1:
        if run[1][2] not in ("symbol", "open"):
            break
        run.pop(0)  # the article
    while run:
        part = text[run[0][0] : run[-1][1]]
        last = text[run[-1][0] : run[-1][1]]
        whole = part.count("(") == part.count(")") and part.count("‖") % 2 == 0 and part.count("|") % 2 == 0
        if whole and (run[-1][2] in ("symbol", "number", "close") or last[0] in "‖|½"):
            break
        run.pop()
    if not run:
        return None
    part = text[run[0][0] : run[-1][1]]
    if _UNIT.fullmatch(part) or _NAMED.fullmatch(part):
        return None
    has_symbol = any(kind == "symbol" for _, _, kind in run)
    return (run[0][0], run[-1][1]) if has_symbol and _STRONG.search(part) else None


_TAG = re.compile(r"(<[^>]+>)")
_LITERAL = ("code", "pre", "a", "h1", "h2", "h3", "h4", "math", "script", "style", "nav")


def mark_formulas(html: str, mathml: Callable[[str], str]) -> str:
    """Replace the formulas in the running text of a page by what `mathml` returns for them."""
    out: list[str] = []
    inside: list[str] = []
    for part in _TAG.split(html):
        if part.startswith("<"):
            name = re.match(r"</?(\w+)", part)
            if name and name[1] in _LITERAL:
                inside = inside[:-1] if part.startswith("</") else [*inside, name[1]]
            out.append(part)
        elif inside:
            out.append(part)
        else:
            out.append(_marked(unicodedata.normalize("NFD", unescape(part)), mathml))
    return "".join(out)


def _marked(text: str, mathml: Callable[[str], str]) -> str:
    parts, at = [], 0
    for begin, end in formulas_in(text):
        formula = unicodedata.normalize("NFC", text[begin:end])
        parts += [escape(unicodedata.normalize("NFC", text[at:begin]), quote=False), mathml(formula)]
        at = end
    return "".join([*parts, escape(unicodedata.normalize("NFC", text[at:]), quote=False)])

"""TeX of formulas written with Unicode characters, as in docstrings, where `help()` shows them as they are."""

from __future__ import annotations

import re
import unicodedata
from itertools import accumulate

__all__ = ["as_tex"]

_RAISED = dict(zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻ᵀ", "0123456789+-T", strict=True))
_LOWERED = dict(zip("₀₁₂₃₄₅₆₇₈₉", "0123456789", strict=True))
_ACCENTS = {"\u0307": r"\dot", "\u0308": r"\ddot", "\u0303": r"\tilde", "\u0302": r"\hat", "\u0304": r"\bar"}
_SIGNS = {
    "−": "-", "·": r"\cdot ", "≤": r"\le ", "≥": r"\ge ", "\x00": r"\ne ", "≈": r"\approx ", "‖": r"\Vert ",
    "∂": r"\partial ", "∇": r"\nabla ", "∫": r"\int ", "∈": r"\in ", "∞": r"\infty ", "×": r"\times ", "→": r"\to ",
    "±": r"\pm ", "½": r"\frac{1}{2}", "…": r"\dots ", "⪯": r"\preceq ", "⪰": r"\succeq ", "∩": r"\cap ", "∪": r"\cup ",
    "⟨": r"\langle ", "⟩": r"\rangle ", "←": r"\leftarrow ", "≡": r"\equiv ", "°": r"^{\circ}",
}  # fmt: skip
_NAMES = {"sin", "cos", "tan", "exp", "log", "ln", "min", "max", "det", "dim"}


def as_tex(formula: str) -> str:
    r"""Return a formula of Unicode characters in TeX.

    Example:
        >>> as_tex("V̇ ≤ −λ_min ‖e‖²")
        '\\dot{V} \\le  -\\lambda _{\\mathrm{min}} \\Vert e\\Vert ^{2}'
    """
    text = unicodedata.normalize("NFD", formula.replace("≠", "\x00"))
    text = re.sub(r"([{}%#&])", r"\\\1", text)
    text = re.sub(r"_\(([^()]*)\)|_([A-Za-z0-9]+(?:,[a-z0-9]+)*)", lambda m: f"_{{{_index(m[1] or m[2])}}}", text)
    text = re.sub(r"(?<![\w{])([^\W\d_])(\d{1,2})(?![\d.])", r"\1_{\2}", text)  # k1, m22
    text = re.sub(r"\^\(([^()]*)\)", r"^{\1}", text)
    text = _words(text)
    text = _roots(text)
    text = re.sub("[" + "".join(_RAISED) + "]+", lambda m: "^{" + "".join(_RAISED[c] for c in m[0]) + "}", text)
    text = re.sub("[" + "".join(_LOWERED) + "]+", lambda m: "_{" + "".join(_LOWERED[c] for c in m[0]) + "}", text)
    marks = "".join(_ACCENTS)
    text = re.sub(f"(.)([{marks}])", lambda m: f"{_ACCENTS[m[2]]}{{{m[1]}}}", text)
    return "".join(_SIGNS.get(c) or _letter(c) for c in text)


def _letter(letter: str) -> str:
    """Return the TeX of a letter; Σ is the sign of a sum."""
    name = unicodedata.name(letter, "")
    if not name.startswith("GREEK "):
        return letter
    word = name.split()[-1].lower().replace("lamda", "lambda")
    return r"\sum " if letter == "Σ" else "\\" + (word.title() if "CAPITAL" in name else word) + " "


def _index(text: str) -> str:
    if text in ("phi", "psi", "theta", "omega"):
        return rf"\{text} "
    return text if len(text) < 3 or not text.isalpha() else rf"\mathrm{{{text}}}"


def _words(text: str) -> str:
    """Set words upright; single letters and indices stay as they are."""

    def upright(found: re.Match[str]) -> str:
        word = found[0]
        return rf"\{word} " if word in _NAMES else rf"\mathrm{{{word}}}"

    return re.sub(r"(?<![\\{A-Za-z])[A-Za-z]{3,}\d?(?![A-Za-z}])", upright, text)


def _roots(text: str) -> str:
    """Replace √(…) and √x by \\sqrt."""
    while "√" in text:
        before, _, rest = text.partition("√")
        if rest.startswith("("):
            depths = accumulate({"(": 1, ")": -1}.get(letter, 0) for letter in rest)
            end = next((k for k, depth in enumerate(depths) if depth == 0), len(rest))
            inside, rest = rest[1:end], rest[end + 1 :]
        else:
            first = re.match(r"\w[\u0300-\u036f]?(?:_\{[^}]*\})?", rest)
            inside, rest = (first[0], rest[first.end() :]) if first else ("", rest)
        text = f"{before}\\sqrt{{{inside}}}{rest}"
    return text

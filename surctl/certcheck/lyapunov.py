"""Check of a certificate of kind `lyapunov`, which claims a region of attraction or an ultimate bound.

Ω is the set of all states in the box with V < level. The claim has one of two properties.

`stability`: every solution that starts in Ω stays in Ω and converges to the equilibrium, which is asymptotically
stable. With a rate, V also decays at least as exp(−rate t), or by the factor 1 − rate in each step. The proof shows,
with r² = Σ ((x_k − x*_k)/scale_k)²:

1. V ≥ factor · (r²)^power with factor > 0 where V ≤ level (`positive`);
2. V ≥ level on every face of the box (continuous time), or that a successor lies in the box (discrete time);
3. the change of V is at most −rate · V, or, without a rate, at most −factor · (r²)^power (`decrease`);
4. V is continuous, and V < level at the equilibrium, which lies inside the box: so Ω is a neighbourhood of it.

`bound`: every solution that starts in Ω stays in Ω, and V decays to the bound: V' ≤ −rate · (V − inner) + Σ gain_j w_j²
for the parameters w_j of `gains`, so that V ends below the bound inner + max Σ gain_j w_j² / rate. The bound must not
exceed level; in discrete time with rate 1, one step may lead to the bound, which must then be less than level. V need
not be positive.

The change of V (`change`) is compared with the one that the checker computes from the dynamics.

A certificate whose V is a quadratic form about the equilibrium may state `slopes` in the place of all these proofs,
with feedbacks of the limits or none; then `surctl.certcheck.slopes` decides. Only such a claim may have a `radius` of
each coordinate: the equilibrium lies within these radii of the stated point, about which Ω is, and the rate is that of
V about the equilibrium. If parameters vary in time, solutions converge to the box of the radii instead. A claim with
radii may be about constant parameters only (`constant`), each with its own equilibrium: solutions that start in Ω then
stay in the box and converge to it, and V about it decreases.

`surctl.certcheck.sampled` decides about a plant under a sampled controller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

from surctl.certcheck.document import Rejected, record
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.inequality import Obligation, check_all, listed, number
from surctl.certcheck.motion import Motion, decimal_text, read_motion, rest_of
from surctl.certcheck.radii import narrowed, read_constant, read_radii, widened
from surctl.certcheck.region_exact import inverse
from surctl.certcheck.sampled import check as check_sampled
from surctl.certcheck.slopes import Decrease, check_decrease, quadratic_form, require_in_box

__all__ = ["check"]

_MOTION = {
    "name", "time", "property", "states", "parameters", "dynamics", "function", "level", "rate", "about",
}  # fmt: skip
_FRAME = {"format", "version", "kind", "claim", "sha256", "change", "proofs"}
_LARGEST_POWER = 8


def check(document: Mapping[str, Any]) -> None:
    """Raise Rejected unless the certificate proves its claim."""
    claim = document["claim"]
    if claim["time"] == "sampled":
        check_sampled(document)
        return
    motion = read_motion(claim)
    function = claim["function"]
    if "slopes" in document:
        _check_slopes(document, motion)
        return
    change = motion.verify_change(function, document["change"])
    inside = [f"({function}) - {decimal_text(claim['level'])}"]
    if claim["property"] == "stability":
        needed = _stability(document, motion, function, change, inside)
    elif claim["property"] == "bound":
        needed = _bound(document, motion, function, change, inside)
    else:
        raise Rejected(f"the property {claim['property']!r} is not known")
    check_all(needed, document["proofs"], motion.normal)


def _check_slopes(document: Mapping[str, Any], motion: Motion) -> None:
    """Raise Rejected unless the slope rule proves the claim; the region must lie in the box."""
    claim = document["claim"]
    record(document, _FRAME - {"change", "proofs"} | {"slopes"}, "the certificate")
    stated = record(document["slopes"], {"feedbacks"} & document["slopes"].keys(), "slopes").get("feedbacks", [])
    feedbacks = [[Fraction(repr(number(x))) for x in listed(row)] for row in listed(stated)]
    level, rate = Fraction(repr(number(claim["level"]))), Fraction(0)
    if claim["rate"] is not None:
        _rate(claim["rate"], motion)
        rate = Fraction(repr(claim["rate"]))
    gains, constant, radii, fixed = dict[str, Fraction](), Fraction(0), list[Fraction](), False
    if claim["property"] == "stability":
        record(claim, _MOTION | {"equilibrium"} | claim.keys() & {"radius", "constant"}, "claim")
        radii, fixed = read_radii(claim, motion.states), read_constant(claim)
        centre = [rest_of(value)[1] for value in _equilibrium(motion, claim["equilibrium"])]
    elif claim["property"] == "bound":
        gains, constant = _gains(claim, motion), rate * Fraction(repr(number(claim["inner"])))
        centre = [Fraction(0)] * len(motion.states)
    else:
        raise Rejected(f"the property {claim['property']!r} is not known")
    p = quadratic_form(motion.states, claim["function"], centre)
    own, wide = (narrowed(motion.state_box, radii), widened(p, level, radii)) if fixed else (motion.state_box, level)
    require_in_box(inverse(p), centre, wide, own)
    if not motion.discrete:
        table = ExpressionTable(motion.names)
        motion.require_continuous(table, [table.read(text) for text in motion.rates], "the dynamics contain")
    needed = Decrease(p, centre, level, rate, gains, constant, radii, fixed)
    check_decrease(motion.names, motion.box, motion.rates, needed, discrete=motion.discrete, feedbacks=feedbacks)


def _stability(
    document: Mapping[str, Any], motion: Motion, function: str, change: str, inside: Sequence[str]
) -> list[Obligation]:
    claim = document["claim"]
    record(claim, _MOTION | {"equilibrium"}, "claim")
    record(document, _FRAME | {"scales", "positive", "decrease"}, "the certificate")
    level = decimal_text(claim["level"])
    distance = _distance(motion, claim["equilibrium"], listed(document["scales"]))
    motion.require_inside(function, claim["level"], claim["equilibrium"])
    states = motion.states, motion.state_box
    needed = [Obligation(*states, _power(distance, document["positive"]), function, inside)]
    needed += motion.stays(inside) if motion.discrete else _faces(motion, level, function)
    if claim["rate"] is None:
        loss = _power(distance, document["decrease"])
    else:
        if document["decrease"] is not None:
            raise Rejected("'decrease' must be null because the claim has a rate")
        loss = f"{_rate(claim['rate'], motion)}*({function})"
    return [*needed, _decrease(motion, function, change, f"-({loss})", inside)]


def _bound(
    document: Mapping[str, Any], motion: Motion, function: str, change: str, inside: Sequence[str]
) -> list[Obligation]:
    claim = document["claim"]
    _gains(claim, motion)
    record(document, _FRAME, "the certificate")
    driving = "0" + "".join(f" + {decimal_text(gain)}*{name}^2" for name, gain in claim["gains"].items())
    right = f"-({_rate(claim['rate'], motion)}*(({function}) - {decimal_text(claim['inner'])})) + ({driving})"
    needed = motion.stays(inside) if motion.discrete else _faces(motion, decimal_text(claim["level"]), function)
    return [*needed, _decrease(motion, function, change, right, inside)]


def _gains(claim: Mapping[str, Any], motion: Motion) -> dict[str, Fraction]:
    """Return the gain of each disturbance; raise Rejected unless V ends below the level."""
    record(claim, _MOTION | {"inner", "gains"}, "claim")
    rate, inner, level = (Fraction(repr(number(claim[key]))) for key in ("rate", "inner", "level"))
    ranges = dict(zip(motion.names, motion.box, strict=True))
    gains, most = dict[str, Fraction](), Fraction(0)
    for name, gain in claim["gains"].items():
        if name not in ranges or name in motion.states or number(gain) < 0:
            raise Rejected("a gain is negative, or does not belong to a parameter")
        gains[name] = Fraction(repr(gain))
        most += gains[name] * max(Fraction(repr(end)) ** 2 for end in ranges[name])
    if not inner + most / rate <= level:
        raise Rejected("the bound exceeds the level")
    if motion.discrete and rate == 1 and inner + most == level:
        raise Rejected("V may reach the level in one step")
    return gains


def _decrease(motion: Motion, function: str, change: str, right: str, inside: Sequence[str]) -> Obligation:
    left = f"({change}) - ({function})" if motion.discrete else change
    return Obligation(motion.names, motion.box, left, right, inside)


def _faces(motion: Motion, level: str, function: str) -> list[Obligation]:
    """Return the obligations that V ≥ level on both faces of the box in every state."""
    box = list(motion.state_box)
    return [
        Obligation(motion.states, [*box[:k], (end, end), *box[k + 1 :]], level, function)
        for k, ends in enumerate(box)
        for end in ends
    ]


def _distance(motion: Motion, equilibrium: object, scales: Sequence[object]) -> str:
    rest = _equilibrium(motion, equilibrium)
    if len(scales) != len(motion.states) or any(number(scale) <= 0 for scale in scales):
        raise Rejected("the scales are not one positive number for each state")
    return " + ".join(
        f"(({name} - {rest_of(value)[0]})/{decimal_text(scale)})^2"
        for name, value, scale in zip(motion.states, rest, scales, strict=True)
    )


def _equilibrium(motion: Motion, stated: object) -> list[object]:
    """Return the stated coordinates of the equilibrium, in the order of the states."""
    if not isinstance(stated, dict) or set(stated) != set(motion.states):
        raise Rejected("the equilibrium does not name every state once")
    return [stated[name] for name in motion.states]


def _power(distance: str, stated: object) -> str:
    if not isinstance(stated, dict) or set(stated) != {"factor", "power"} or number(stated["factor"]) <= 0:
        raise Rejected("a bound has no positive factor")
    power = stated["power"]
    if type(power) is not int or not 1 <= power <= _LARGEST_POWER:
        raise Rejected(f"a power is not an integer from 1 to {_LARGEST_POWER}")
    return f"{decimal_text(stated['factor'])}*({distance})^{power}"


def _rate(rate: object, motion: Motion) -> str:
    value = number(rate)
    if value <= 0 or (motion.discrete and value > 1):
        raise Rejected("the rate is not positive, or exceeds 1 in discrete time")
    return decimal_text(rate)

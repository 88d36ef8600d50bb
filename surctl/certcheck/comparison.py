"""How numbers of a claim are compared with those of an exported controller (which: `belonging`); hashes, period."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mpmath import libmp

from surctl.certcheck.bundle import Manifest
from surctl.certcheck.elementary import Undefined
from surctl.certcheck.enclosure import enclose, span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.leaves import Leaves

__all__ = ["ALIKE", "LIMITS", "ROUNDING", "Comparison", "Part"]

ROUNDING = {
    "float64": "rounding: the proof holds for exact real numbers; the bundle computes in float64",
    "float32": "rounding: the proof holds for exact real numbers; the bundle rounds constants, gains and results to "
    "float32, and no bound of these errors is derived",
}
"""What a certificate does not cover, for each precision of the exported code."""
ALIKE = (
    ("mass", "mass_kg", ("m11", "m22")),
    ("linear drag", "linear_drag", ("Xu", "Yv")),
    ("quadratic drag", "quadratic_drag", ("Xuu", "Yvv")),
)
LIMITS = ("Fu_max", "Fv_max")
_ROUNDED = 1e-9  # largest slack, relative to the largest value of a side
_NO_TERMS: Mapping[str, float] = {}
_EQUATION_3 = {
    "radius", "m11", "m22", "m33", "m44", "Xu", "Yv", "Zw", "Nr", "Xuu", "Yvv", "Zww", "Nrr", "Fu_max", "Fv_max",
    "Fw_max", "Fr_max", "thrust_lag",
}  # fmt: skip
"""The parameters of equation (3); the certificates about the motion of the vehicle cover no further terms."""


class Part:
    """A part of a claim; reading one of its entries, for a comparison, marks the entry as bound."""

    def __init__(self, leaves: Leaves, name: str) -> None:
        self._leaves, self._name = leaves, name

    def __getitem__(self, key: str) -> Any:
        return self._leaves.take(self._name, key)


class Comparison:
    """What differs, and what is not covered, of one claim and one bundle.

    Attributes:
        leaves: the claim, of which each entry must be taken.
        differs, excludes, undecided: the messages.
    """

    def __init__(self, claim: Mapping[str, Any], manifest: Manifest) -> None:
        self.claim, self.manifest, self.leaves = claim, manifest, Leaves(claim)
        self.take = self.leaves.take
        self.differs, self.excludes, self.undecided = list(manifest.wrong), list[str](), list[str]()
        self.ranges = manifest.ranges or {}

    def gains(self, name: str) -> Sequence[float]:
        """Return the values of a gain; empty if the bundle does not state it."""
        return self.manifest.gains.get(name, ())

    def numbers(self, *names: str) -> list[float]:
        """Return the stated ones of some parameters of the vehicle."""
        return [self.manifest.values[name] for name in names if name in self.manifest.values]

    def limits(self) -> list[float]:
        """Return the thrust limits of surge and sway [N]: those of the law, then of the vehicle."""
        return [*self.gains("thrust_limit")[:2], *self.numbers(*LIMITS)]

    def of(self, part: str) -> Part:
        """Return a part of the claim by its name."""
        return Part(self.leaves, part)

    def conditions(self, part: str, *keys: str) -> None:
        """Add an exclusion with the conditions under which the claim holds, about which the bundle says nothing."""
        numbers = (f"{key} = {self.take(part, key)!r}" for key in keys)
        self.excludes.append(f"conditions: {', '.join(numbers)}")

    def yaw_limits(self) -> list[float]:
        """Return the yaw moments [N m] of the law and of the vehicle, in both directions."""
        return [*self.gains("thrust_limit")[3:4], *self.numbers("Fr_max", "Fr_reverse")]

    def equal(self, what: str, certified: float, have: Sequence[float]) -> None:
        """Compare a number with the first one of the bundle."""
        if not have:
            self.unknown(what)
        elif have[0] != certified:
            self.differs.append(f"{what}: {certified!r} certified, {have[0]!r} exported")

    def entry(
        self, name: str, certified: Any, have: Sequence[float], at: int, ranges: Mapping[str, tuple[float, float]]
    ) -> None:
        """Compare a number, or the range of a parameter of the claim, with a number of the bundle."""
        if not isinstance(certified, str):
            self.equal(f"{name}[{at}]", certified, have[at : at + 1])
        elif certified not in ranges or len(have) <= at or not ranges[certified][0] <= have[at] <= ranges[certified][1]:
            self.differs.append(f"{name}[{at}]: the range of {certified} does not contain the exported number")

    def slack(self, slack: float) -> None:
        """Report a slack that is more than rounding: a share of the largest values that the sides may take."""
        if not slack:
            return
        variables = self.claim["variables"]
        table = ExpressionTable([row["name"] for row in variables])
        roots = [table.read(self.claim[side]) for side in ("left", "right")]
        try:
            sides = enclose(table, roots, [span(row["lower"], row["upper"]) for row in variables])
        except Undefined:
            sides = []
        scale = max((abs(libmp.to_float(end)) for side in sides for end in side), default=0.0)
        if not slack <= _ROUNDED * scale:
            self.differs.append(f"slack: {slack!r} {self.claim['unit']} is more than rounding")

    def unknown(self, what: str) -> None:
        """Report what the bundle does not state."""
        self.differs.append(f"{what}: the bundle does not state it; export the controller again")

    def gain(self, name: str, certified: float, at: int = 0) -> None:
        """Compare an entry of a gain."""
        self.equal(f"{name}[{at}]", certified, self.gains(name)[at : at + 1])

    def believed(self, law: Part) -> None:
        """Compare the law's model (mass and drag in surge and sway) with the certified values."""
        for _, key, _ in ALIKE:
            for axis, model in enumerate(law[key]):
                self.gain(key.removesuffix("_kg"), model, axis)

    def at_least(self, what: str, certified: float, unit: str, have: Sequence[float]) -> None:
        """Report a number of the bundle below the certified one."""
        if not have:
            self.unknown(what)
        elif min(have) < certified:
            self.differs.append(f"{what}: at least {certified!r} {unit} certified, {min(have)!r} exported")

    def at_most(self, what: str, certified: float, unit: str, have: Sequence[float]) -> None:
        """Report a number of the bundle above the certified one."""
        if not have:
            self.unknown(what)
        elif max(have) > certified:
            self.differs.append(f"{what}: at most {certified!r} {unit} certified, {max(have)!r} exported")

    def within(self, what: str, ends: Sequence[float], names: Sequence[str]) -> None:
        """Compare the vehicle's parameters with a certified range; add an exclusion if the vehicle file's is wider."""
        low, high = ends
        for name in names:
            if name not in self.manifest.values:
                self.unknown(name)
                continue
            value = self.manifest.values[name]
            if not low <= value <= high:
                self.differs.append(f"{what}: {low!r} to {high!r} certified, the vehicle's {name} is {value!r}")
        stated = [self.ranges[name] for name in names if name in self.ranges]
        if stated and (min(a for a, _ in stated) < low or max(b for _, b in stated) > high):
            text = f"{min(a for a, _ in stated)!r} to {max(b for _, b in stated)!r} in the vehicle file"
            self.excludes.append(f"{what}: {text}, {low!r} to {high!r} certified")

    def lower_ends(self, what: str, certified: float, unit: str) -> None:
        """Add an exclusion if the vehicle file allows a thrust limit below the certified one."""
        least = [self.ranges[name][0] for name in LIMITS if name in self.ranges]
        if least and min(least) < certified:
            self.excludes.append(f"{what}: {min(least)!r} {unit} in the vehicle file, {certified!r} {unit} certified")

    # ---- helpers of all comparisons

    def hashes(self, *, lawless: bool = False, terms: Mapping[str, float] = _NO_TERMS) -> None:
        """Compare digests of law and vehicle, and the vehicle's terms; add the exclusions of the claim."""
        texts = "assumes" if "assumes" in self.claim else "excludes"
        self.excludes += [*self.take(texts), ROUNDING[self.manifest.real]]  # the reader compared the texts
        for key in ("system", "sha256_vehicle", *(() if lawless else ("sha256_law",))):
            self.take(key)
        self.digests(self.claim["sha256_vehicle"], "" if lawless else self.claim["sha256_law"])
        self.terms(terms)

    def digests(self, certified: str, law: str) -> None:
        """Compare the certified digests of the vehicle and of the law; "" for no law."""
        laws, vehicle = self.manifest.laws, self.manifest.vehicle
        if law and law not in laws:
            self.differs.append(f"law: SHA-256 {law[:12]} certified, {laws[0][:12]} exported")
        if not vehicle:
            self.differs.append("vehicle: the bundle does not name a vehicle")
        elif certified != vehicle:
            self.differs.append(f"vehicle: SHA-256 {certified[:12]} certified, {vehicle[:12]} exported")
        if self.manifest.ranges is None:
            self.unknown("ranges of the vehicle")

    def terms(self, certified: Mapping[str, float] = _NO_TERMS) -> None:
        """Compare the vehicle's terms beside equation (3) with the certified ones."""
        have = {name: value for name, value in self.manifest.values.items() if name not in _EQUATION_3}
        if terms := sorted(set(have) - set(certified)):
            self.differs.append(f"vehicle: it has {', '.join(terms)}, which the certificate does not cover")
        for name, value in certified.items():
            if name not in have:
                self.differs.append(f"vehicle: it does not have {name}, which is certified")
            elif have[name] != value:
                self.differs.append(f"{name}: {value!r} certified, {have[name]!r} exported")

    def vehicle(self, vehicle: Part, *, ratio: float = 1.0) -> None:
        """Compare the vehicle's masses and drag with the certified ranges, for masses of at most this ratio."""
        masses = sorted((self.manifest.values.get(name, 0.0), name) for name in ALIKE[0][2])
        for what, key, names in ALIKE:
            # of unequal masses, the range is that of the lighter one
            self.within(what, vehicle[key], (masses[0][1],) if what == "mass" and ratio > 1 else names)
        (light, _), (heavy, _) = masses
        if heavy > light * ratio:
            share = "equal for surge and sway" if ratio == 1 else f"at most {ratio!r} times the lighter one"
            self.differs.append(f"mass: {share} certified, {light!r} kg and {heavy!r} kg exported")

    def alike(self, asymmetry: float) -> None:
        """Compare the difference of the drag in surge and sway with a certified asymmetry."""
        for what, _, names in ALIKE[1:]:
            pair = self.numbers(*names)
            if len(pair) == 2 and abs(pair[0] - pair[1]) > asymmetry * (pair[0] + pair[1]) / 2:
                self.differs.append(
                    f"{what}: surge and sway may differ by a share of {asymmetry!r}, "
                    f"but {pair[0]!r} and {pair[1]!r} are exported"
                )

    def factors(self, what: str, asymmetry: float, rows: Sequence[tuple[str, str, tuple[str, str]]]) -> None:
        """Compare the differences of the ratios of the vehicle's parameters to the law's with a certified asymmetry."""
        values, law = self.manifest.values, self.claim["law"]
        ratios = [
            values[name] / law[key][axis]
            for _, key, names in rows for axis, name in enumerate(names) if name in values and law[key][axis]
        ]  # fmt: skip
        if ratios and (apart := max(ratios) - min(ratios)) > asymmetry * (max(ratios) + min(ratios)) / 2:
            text = f"factors that differ by {apart:.3g} exported"
            self.differs.append(f"{what}: factors that differ by a share of {asymmetry!r} certified, {text}")

    def late(self, lag: Sequence[float], period: float) -> None:
        """Compare thrust lag and control period, or add that the claim does not cover them."""
        self.period(period)
        if not any(lag):
            self.excludes.append("thrust lag: the certificate assumes thrust without lag")
        else:
            self.within("thrust_lag", lag, ("thrust_lag",))

    def period(self, certified: float) -> None:
        """Compare the control period, or add that the claim does not cover held commands."""
        if certified == 0:
            text = "sampling: the certificate does not cover commands that are held for a control period"
            self.excludes.insert(0, text)
        elif certified != self.manifest.period:
            self.differs.append(f"period: {certified!r} s certified, {self.manifest.period!r} s exported")

"""Whether a certificate that was accepted is about an exported controller: every number of it against the manifest's.

Nothing is taken from a hash alone. A vehicle's number must lie in the range that is certified, a gain must be the one
that is certified, a bound must hold for what is exported; a number that the manifest does not name is not known, and
what is not known does not belong. Where the vehicle's file says that a number may be further off than is certified, or
the certificate leaves something out, it belongs, and what is not covered is named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot
from typing import Any

from surctl.certcheck.braking_claim import read_claim as read_braking
from surctl.certcheck.bundle import Manifest, stated_sha256
from surctl.certcheck.region_claim import read_claim as read_region

__all__ = ["Belonging", "compare"]

_ROUNDING = "rounding: what is proved holds for real numbers, the bundle computes in {}"
_GROUND_TRUTH = (
    "perception: the certificate covers the law with true positions as input; the bundle perceives for itself"
)
_KINEMATIC = "dynamics, sampling and sensing: it is an inequality about the loop of its variables, in their ranges"
_RULE = "law: it is about a rule that brakes in time, which the exported law does not follow"
_ALIKE = (
    ("mass", "mass_kg", ("m11", "m22")),
    ("linear drag", "linear_drag", ("Xu", "Yv")),
    ("quadratic drag", "quadratic_drag", ("Xuu", "Yvv")),
)
_VARIABLES = {"m": ("m11", "m22"), "X": ("Xu", "Yv"), "X2": ("Xuu", "Yvv")}
"""Variables of the inequalities about braking that are numbers of the vehicle."""
_GUARDED = (
    ("margin", "margin_m"), ("reaction", "reaction_s"), ("brake", "brake"), ("k_v", "k_v_per_s"), ("k_i", "k_i_per_s2"),
)  # fmt: skip
_STOPPING = ("lightest_kg", "heaviest_kg", "most_n", "lag_s", "linear_drag", "quadratic_drag")
_LIMITS = ("Fu_max", "Fv_max")


@dataclass(frozen=True)
class Belonging:
    """Whether a certificate is about this controller.

    Attributes:
        differs: what is not the same; empty when it belongs.
        excludes: what the certificate leaves out of the controller that flies.
    """

    differs: tuple[str, ...]
    excludes: tuple[str, ...]

    @property
    def belongs(self) -> bool:
        """Whether nothing differs."""
        return not self.differs

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {"belongs": self.belongs, "differs": list(self.differs), "excludes": list(self.excludes)}


def compare(document: Mapping[str, Any], manifest: Manifest) -> Belonging:
    """Whether a certificate that was accepted is about the controller of a manifest.

    Args:
        document: the certificate.
        manifest: of the bundle.
    """
    comparison = _Comparison(document["claim"], manifest)
    {"region": comparison.region, "braking": comparison.braking, "heading": comparison.heading}.get(
        document["kind"], comparison.inequality
    )()
    return Belonging(tuple(comparison.differs), tuple(comparison.excludes))


class _Comparison:
    def __init__(self, claim: Mapping[str, Any], manifest: Manifest) -> None:
        self.claim, self.manifest = claim, manifest
        self.differs, self.excludes = list(manifest.wrong), list[str]()
        self.ranges = manifest.ranges or {}

    # ---- kinds

    def inequality(self) -> None:
        name = str(self.claim["name"])
        self.excludes += [_KINEMATIC, _ROUNDING.format(self.manifest.real)]
        expected = self.manifest.claims.get(name)
        if expected is None:
            self.differs.append(f"claim {name!r} does not concern the exported law, so it is not bound to the bundle")
        elif expected != stated_sha256(self.claim):
            self.differs.append(f"claim {name!r} for the bundle's gains, vehicle and cruise is another one")
        elif name.startswith("braking-"):
            for variable in self.claim["variables"]:
                if variable["name"] in _VARIABLES:
                    ends = variable["lower"], variable["upper"]
                    self._within(variable["name"], ends, _VARIABLES[variable["name"]])

    def heading(self) -> None:
        self.differs.append("law: it is about the paper's law, steered by heading; what is exported steers by velocity")

    def region(self) -> None:
        read_region(self.claim)  # every number is one
        vehicle, law = self.claim["vehicle"], self.claim["law"]
        self._hashes()
        self.excludes += [*self.claim["excludes"], _ROUNDING.format(self.manifest.real)]
        for name in ("k1", "lookahead", "k_v", "k_i", "wait", "cruise", "cap"):
            self._gain(name, law[name])
        self._believed(law)
        self._vehicle(vehicle)
        self._alike(vehicle["asymmetry"])
        self._at_least("thrust_limit", vehicle["thrust_n"], "N", self._limits())
        self._at_most("yaw rate", vehicle["yaw_rate_rad_per_s"], "rad/s", self._gains("spin"))
        self._lower_ends("thrust", vehicle["thrust_n"], "N")
        self._period(law["period_s"])
        if vehicle["lag_s"] == [0, 0]:
            self.excludes.append("lag of the thrusters")
        else:
            self._within("thrust_lag", vehicle["lag_s"], ("thrust_lag",))
        self._perception()

    def braking(self) -> None:
        read_braking(self.claim)
        vehicle, law, met = self.claim["vehicle"], self.claim["law"], self.claim["encounter"]
        self._hashes(lawless=law is None)
        self.excludes += [*self.claim["assumes"], _ROUNDING.format(self.manifest.real)]
        self._vehicle(vehicle)
        limits = self._limits()
        self._at_least("thrust_limit", vehicle["brake_n"], "N", limits)
        self._lower_ends("thrust", vehicle["brake_n"], "N")
        self._at_most("thrust", vehicle["most_n"], "N", limits)
        if len(limits) == 4 and (both := hypot(*limits[:2])) > vehicle["most_n"]:
            self.excludes.append(f"thrust of both axes together: up to {both:.3g} N, {vehicle['most_n']!r} N certified")
        self._at_most("thrust_lag", vehicle["lag_s"], "s", self._numbers("thrust_lag"))
        self._at_most("yaw rate", met["turn_rad_per_s"], "rad/s", self._gains("spin"))
        if met["turn_rad_per_s"]:
            self._at_most("thrust across", vehicle["side_n"], "N", limits)
        cap = self._gains("cap")
        self._at_most("speed", met["fastest_m_per_s"], "m/s", cap)
        if cap and cap[0] > met["sideways_m_per_s"]:
            text = f"more than {met['sideways_m_per_s']!r} m/s, of {cap[0]!r} m/s that may be asked for"
            self.excludes.append(f"speed across the direction of the obstacle: {text}")
        self._period(self.claim["watch"]["period_s"])
        if law is None:
            self.excludes.append(_RULE)
            return
        for name, key in _GUARDED:
            self._gain(name, law[key])
        self._believed(law)
        for at in (0, 1):
            self._at_least("thrust_limit", law["limit_n"], "N", self._gains("thrust_limit")[at : at + 1])
        for at, key in enumerate(_STOPPING):
            self._gain("stopping", law["stopping"][key], at)
        self._perception()

    # ---- numbers

    def _gains(self, name: str) -> Sequence[float]:
        return self.manifest.gains.get(name, ())

    def _numbers(self, *names: str) -> list[float]:
        return [self.manifest.values[name] for name in names if name in self.manifest.values]

    def _limits(self) -> list[float]:
        """Thrust limits of the law, then of the vehicle; not all of them where one is not known."""
        return [*self._gains("thrust_limit")[:2], *self._numbers(*_LIMITS)]

    def _unknown(self, what: str) -> None:
        self.differs.append(f"{what}: not known of this bundle; export the controller again")

    def _gain(self, name: str, certified: float, at: int = 0) -> None:
        have = self._gains(name)
        if len(have) <= at:
            self._unknown(f"{name}[{at}]")
        elif have[at] != certified:
            self.differs.append(f"{name}[{at}]: {certified!r} certified, {have[at]!r} exported")

    def _believed(self, law: Mapping[str, Any]) -> None:
        """What the law believes of surge and of sway."""
        for port, key in (("mass", "mass_kg"), ("linear_drag", "linear_drag"), ("quadratic_drag", "quadratic_drag")):
            for axis in (0, 1):
                self._gain(port, law[key], axis)

    def _at_least(self, what: str, certified: float, unit: str, have: Sequence[float]) -> None:
        if not have:
            self._unknown(what)
        elif min(have) < certified:
            self.differs.append(f"{what}: at least {certified!r} {unit} certified, {min(have)!r} exported")

    def _at_most(self, what: str, certified: float, unit: str, have: Sequence[float]) -> None:
        if not have:
            self._unknown(what)
        elif max(have) > certified:
            self.differs.append(f"{what}: at most {certified!r} {unit} certified, {max(have)!r} exported")

    def _within(self, what: str, ends: Sequence[float], names: Sequence[str]) -> None:
        """The vehicle's numbers lie in what is certified; where its file gives wider ranges, that is not covered."""
        low, high = ends
        for name in names:
            if name not in self.manifest.values:
                self._unknown(name)
                continue
            value = self.manifest.values[name]
            if not low <= value <= high:
                self.differs.append(f"{what}: {low!r} to {high!r} certified, the vehicle's {name} is {value!r}")
        stated = [self.ranges[name] for name in names if name in self.ranges]
        if stated and (min(a for a, _ in stated) < low or max(b for _, b in stated) > high):
            text = f"{min(a for a, _ in stated)!r} to {max(b for _, b in stated)!r} by the vehicle's file"
            self.excludes.append(f"{what}: {text}, {low!r} to {high!r} certified")

    def _lower_ends(self, what: str, certified: float, unit: str) -> None:
        """What the vehicle's file leaves of a limit."""
        least = [self.ranges[name][0] for name in _LIMITS if name in self.ranges]
        if least and min(least) < certified:
            self.excludes.append(f"{what}: {min(least)!r} {unit} by the vehicle's file, {certified!r} certified")

    # ---- what all share

    def _hashes(self, *, lawless: bool = False) -> None:
        laws, vehicle = self.manifest.laws, self.manifest.vehicle
        if not lawless and self.claim["sha256_law"] not in laws:
            self.differs.append(f"law: {self.claim['sha256_law'][:12]} certified, {laws[0][:12]} exported")
        if not vehicle:
            self.differs.append("vehicle: the bundle names none")
        elif self.claim["sha256_vehicle"] != vehicle:
            self.differs.append(f"vehicle: {self.claim['sha256_vehicle'][:12]} certified, {vehicle[:12]} exported")
        if self.manifest.ranges is None:
            self._unknown("ranges of the vehicle")

    def _vehicle(self, vehicle: Mapping[str, Any]) -> None:
        for what, key, names in _ALIKE:
            self._within(what, vehicle[key], names)
        masses = self._numbers("m11", "m22")
        if len(set(masses)) > 1:
            self.differs.append(f"mass: one of surge and sway certified, {masses[0]!r} and {masses[1]!r} exported")

    def _alike(self, asymmetry: float) -> None:
        for what, _, names in _ALIKE[1:]:
            pair = self._numbers(*names)
            if len(pair) == 2 and abs(pair[0] - pair[1]) > asymmetry * (pair[0] + pair[1]) / 2:
                self.differs.append(
                    f"{what}: surge and sway alike to {asymmetry!r} certified, {pair[0]!r} and {pair[1]!r} exported"
                )

    def _period(self, certified: float) -> None:
        if certified == 0:
            self.excludes.append("sampling: commands that are held for a period")
        elif certified != self.manifest.period:
            self.differs.append(f"period: {certified!r} s certified, {self.manifest.period!r} s exported")

    def _perception(self) -> None:
        if self.claim["sha256_law"] == self.manifest.laws[1] != self.manifest.laws[0]:
            self.excludes.append(_GROUND_TRUTH)

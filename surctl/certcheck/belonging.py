"""Decide whether an accepted certificate applies to an exported controller, by comparing its numbers with the manifest.

It is not enough that the hashes are equal. Each vehicle parameter must lie in its certified range, each gain must equal
the certified gain, and each certified bound must hold for the exported controller. If the certificate states a
parameter, gain or bound that the manifest lacks, the certificate does not belong to the controller. If the vehicle file
gives a wider range than the certificate, or if the certificate does not cover a part of the controller, the certificate
still belongs to the controller, and `excludes` names what is not covered.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot
from typing import Any

from surctl.certcheck.braking_claim import read_claim as read_braking
from surctl.certcheck.bundle import Manifest, stated_sha256
from surctl.certcheck.region_claim import read_claim as read_region
from surctl.certcheck.steering_claim import read_claim as read_steering
from surctl.certcheck.turning_claim import read_claim as read_turning

__all__ = ["Belonging", "compare"]

_ROUNDING = "rounding: the proof holds for exact real numbers; the bundle computes in {}"
_GROUND_TRUTH = (
    "perception: the certificate covers the law with true positions as input; the exported law uses its own perception"
)
_KINEMATIC = (
    "dynamics, sampling and sensing: the certificate proves one inequality for its variables within their ranges, "
    "and nothing about the rest of the loop"
)
_STATED = "dynamics: that they are those of plant and controller is stated by the certificate, and not checked"
_RULE = "law: the certificate is about a braking rule that is not part of the exported law"
_ALIKE = (
    ("mass", "mass_kg", ("m11", "m22")),
    ("linear drag", "linear_drag", ("Xu", "Yv")),
    ("quadratic drag", "quadratic_drag", ("Xuu", "Yvv")),
)
_VARIABLES = {"m": ("m11", "m22"), "X": ("Xu", "Yv"), "X2": ("Xuu", "Yvv")}
"""For each variable of the braking inequalities, the vehicle parameters that it represents."""
_GUARDED = (
    ("margin", "margin_m"), ("reaction", "reaction_s"), ("brake", "brake"), ("k_v", "k_v_per_s"), ("k_i", "k_i_per_s2"),
)  # fmt: skip
_STOPPING = ("lightest_kg", "heaviest_kg", "most_n", "lag_s", "linear_drag", "quadratic_drag")
_LIMITS = ("Fu_max", "Fv_max")
_NO_TERMS: Mapping[str, float] = {}
_EQUATION_3 = {
    "radius", "m11", "m22", "m33", "m44", "Xu", "Yv", "Zw", "Nr", "Xuu", "Yvv", "Zww", "Nrr", "Fu_max", "Fv_max",
    "Fw_max", "Fr_max", "thrust_lag",
}  # fmt: skip
"""The parameters of equation (3); the certificates about the motion of the vehicle cover no further terms."""


@dataclass(frozen=True)
class Belonging:
    """Result of the comparison of a certificate with an exported controller.

    Attributes:
        differs: one message for each mismatch; empty if the certificate belongs to the controller.
        excludes: one message for each part of the exported controller that the certificate does not cover.
    """

    differs: tuple[str, ...]
    excludes: tuple[str, ...]

    @property
    def belongs(self) -> bool:
        """Return whether the certificate belongs to the controller, i.e. whether `differs` is empty."""
        return not self.differs

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        return {"belongs": self.belongs, "differs": list(self.differs), "excludes": list(self.excludes)}


def compare(document: Mapping[str, Any], manifest: Manifest) -> Belonging:
    """Compare an accepted certificate with the manifest of an exported controller.

    Args:
        document: the certificate.
        manifest: the manifest of the bundle.
    """
    comparison = _Comparison(document["claim"], manifest)
    kinds = {
        "region": comparison.region, "braking": comparison.braking, "heading": comparison.heading,
        "turning": comparison.turning, "steering": comparison.steering, "lyapunov": comparison.motion,
        "barrier": comparison.motion,
    }  # fmt: skip
    kinds.get(document["kind"], comparison.inequality)()
    return Belonging(tuple(comparison.differs), tuple(comparison.excludes))


class _Comparison:
    def __init__(self, claim: Mapping[str, Any], manifest: Manifest) -> None:
        self.claim, self.manifest = claim, manifest
        self.differs, self.excludes = list(manifest.wrong), list[str]()
        self.ranges = manifest.ranges or {}

    # ---- comparison for each kind of certificate

    def inequality(self) -> None:
        name = str(self.claim["name"])
        self.excludes += [_KINEMATIC, _ROUNDING.format(self.manifest.real)]
        expected = self.manifest.claims.get(name)
        if expected is None:
            self.differs.append(f"claim {name!r} does not concern the exported law, so it is not bound to the bundle")
        elif expected != stated_sha256(self.claim):
            self.differs.append(f"claim {name!r} is not the one for the bundle's gains, vehicle and cruise speed")
        elif name.startswith("braking-"):
            self._terms()
            for variable in self.claim["variables"]:
                if variable["name"] in _VARIABLES:
                    ends = variable["lower"], variable["upper"]
                    self._within(variable["name"], ends, _VARIABLES[variable["name"]])

    def motion(self) -> None:
        about = self.claim["about"]
        if not about:
            self.differs.append("dynamics: the certificate does not state the controller that its dynamics are about")
            return
        if about["controller"] != self.manifest.laws[0]:
            self.differs.append("controller: the certificate is about another controller")
        for name, values in about["gains"].items():
            for at, value in enumerate(values):
                self._gain(name, value, at)
            if len(values) < len(self._gains(name)):
                self.differs.append(f"{name}: the certificate states {len(values)} of {len(self._gains(name))} values")
        lacking = sorted(set(self.manifest.gains) - set(about["gains"]))
        self.differs += [f"{name}: the certificate does not state this gain" for name in lacking]
        self.excludes += [_STATED, _ROUNDING.format(self.manifest.real)]
        if self.claim["time"] == "continuous":
            self.excludes.append("sampling: the certificate is about the control law in continuous time")

    def heading(self) -> None:
        self.differs.append(
            "law: the certificate covers the paper's law, which steers by heading; the exported law steers by velocity"
        )

    def region(self) -> None:
        read_region(self.claim)  # raises Rejected unless every number is valid
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
        self._late(vehicle["lag_s"], law["period_s"])
        self._perception()

    def turning(self) -> None:
        read_turning(self.claim)
        vehicle, law = self.claim["vehicle"], self.claim["law"]
        self._hashes(terms=vehicle["terms"])
        self.excludes += [*self.claim["excludes"], _ROUNDING.format(self.manifest.real)]
        for name in ("k1", "lookahead", "k_v", "wait", "cruise", "cap"):
            self._gain(name, law[name])
        self._gain("k_i", law["k_i"])
        for (what, key, names), factor in zip(_ALIKE, ("mass_factor", "drag_factor", "drag_factor"), strict=True):
            for axis, name in enumerate(names):
                model = law[key][axis]
                self._gain(key.removesuffix("_kg"), model, axis)
                self._within(f"{what} {name}", [model * end for end in vehicle[factor]], (name,))
        self._factors("mass", vehicle["mass_asymmetry"], _ALIKE[:1])
        for row in _ALIKE[1:]:  # the linear and the quadratic coefficients have their own factors
            self._factors("drag", vehicle["drag_asymmetry"], (row,))
        for axis, name in enumerate(_LIMITS):
            limits = name, name.replace("max", "reverse")
            have = [*self._gains("thrust_limit")[axis : axis + 1], *self._numbers(*limits)]
            self._at_least(f"thrust_limit of {name}", vehicle["thrust_n"][axis], "N", have)
            self._lower_ends("thrust", vehicle["thrust_n"][axis], "N")
        self._at_most("yaw rate", vehicle["yaw_rate_rad_per_s"], "rad/s", self._gains("spin"))
        yaw = [*self._gains("thrust_limit")[3:4], *self._numbers("Fr_max", "Fr_reverse")]
        self._at_least("thrust_limit of yaw", vehicle["munk_moment_nm"], "N m", yaw)
        self._late(vehicle["lag_s"], law["period_s"])
        self._perception()

    def steering(self) -> None:
        read_steering(self.claim)
        vehicle, law = self.claim["vehicle"], self.claim["law"]
        self._hashes(terms=vehicle["terms"])
        self.excludes += [*self.claim["excludes"], _ROUNDING.format(self.manifest.real)]
        for name in (
            "k_psi",
            "k_r",
            "crab_time",
            "sideslip",
            "lookahead",
            "cruise",
            "cap",
            "k_i",
            "munk",
            "centripetal",
            "fin_share",
        ):
            self._gain(name, law[name])
        for at, axis in enumerate((0, 1, 3)):
            self._gain("mass", law["mass"][at], axis)
            self._within("mass", [law["mass"][at] * end for end in vehicle["mass_factor"]], (f"m{axis + 1}{axis + 1}",))
        for at, (axis, names) in enumerate(((1, ("Yv", "Yvv")), (3, ("Nr", "Nrr")))):
            own = vehicle["linear_drag"][at], law["quadratic_drag"][at]
            for key, value, name in zip(("linear_drag", "quadratic_drag"), own, names, strict=True):
                self._gain(key, law[key][at], axis)
                self._within("drag", [value * end for end in vehicle["drag_factor"]], (name,))
        yaw = [*self._gains("thrust_limit")[3:4], *self._numbers("Fr_max", "Fr_reverse")]
        self._at_least("thrust_limit of yaw", vehicle["moment_nm"], "N m", yaw)

    def braking(self) -> None:
        read_braking(self.claim)
        vehicle, law, met = self.claim["vehicle"], self.claim["law"], self.claim["encounter"]
        self._hashes(lawless=law is None)
        self.excludes += [*self.claim["assumes"], _ROUNDING.format(self.manifest.real)]
        self._vehicle(vehicle, ratio=vehicle["mass_ratio"])
        if vehicle["drag"] == "along":
            self._alike(0.0)
        limits = self._limits()
        self._at_least("thrust_limit", vehicle["brake_n"], "N", limits)
        self._lower_ends("thrust", vehicle["brake_n"], "N")
        self._at_most("thrust", vehicle["most_n"], "N", limits)
        if len(limits) == 4 and (both := hypot(*limits[:2])) > vehicle["most_n"]:
            text = f"up to {both:.3g} N possible, up to {vehicle['most_n']!r} N certified"
            self.excludes.append(f"thrust of both axes together: {text}")
        self._at_most("thrust_lag", vehicle["lag_s"], "s", self._numbers("thrust_lag"))
        self._at_most("yaw rate", met["turn_rad_per_s"], "rad/s", self._gains("spin"))
        if met["turn_rad_per_s"] or vehicle["mass_ratio"] > 1:
            self._at_most("thrust across", vehicle["side_n"], "N", limits)
        cap = self._gains("cap")
        self._at_most("speed", met["fastest_m_per_s"], "m/s", cap)
        if cap and cap[0] > met["sideways_m_per_s"]:
            text = f"up to {met['sideways_m_per_s']!r} m/s certified, up to {cap[0]!r} m/s may be commanded"
            self.excludes.append(f"speed across the direction of the obstacle: {text}")
        self._period(self.claim["watch"]["period_s"])
        if law is None:
            self.excludes.append(_RULE)
            return
        self._at_most("speed wanted", law["cap_m_per_s"], "m/s", cap)
        for name, key in _GUARDED:
            self._gain(name, law[key])
        self._believed(law)
        for at in (0, 1):
            self._at_least("thrust_limit", law["limit_n"], "N", self._gains("thrust_limit")[at : at + 1])
        for at, key in enumerate(_STOPPING):
            self._gain("stopping", law["stopping"][key], at)
        self._perception()

    # ---- comparison of numbers

    def _gains(self, name: str) -> Sequence[float]:
        return self.manifest.gains.get(name, ())

    def _numbers(self, *names: str) -> list[float]:
        return [self.manifest.values[name] for name in names if name in self.manifest.values]

    def _limits(self) -> list[float]:
        # thrust limits of the law, then of the vehicle [N]; a limit missing in the manifest is left out
        return [*self._gains("thrust_limit")[:2], *self._numbers(*_LIMITS)]

    def _unknown(self, what: str) -> None:
        self.differs.append(f"{what}: the bundle does not state it; export the controller again")

    def _gain(self, name: str, certified: float, at: int = 0) -> None:
        have = self._gains(name)
        if len(have) <= at:
            self._unknown(f"{name}[{at}]")
        elif have[at] != certified:
            self.differs.append(f"{name}[{at}]: {certified!r} certified, {have[at]!r} exported")

    def _believed(self, law: Mapping[str, Any]) -> None:
        """Compare the law's model (mass and drag in surge and sway) with the certified values."""
        for port, key in (("mass", "mass_kg"), ("linear_drag", "linear_drag"), ("quadratic_drag", "quadratic_drag")):
            for axis in (0, 1):
                self._gain(port, law[key][axis] if isinstance(law[key], list) else law[key], axis)

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
        """Compare the vehicle's parameters with a certified range; add an exclusion if the vehicle file's is wider."""
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
            text = f"{min(a for a, _ in stated)!r} to {max(b for _, b in stated)!r} in the vehicle file"
            self.excludes.append(f"{what}: {text}, {low!r} to {high!r} certified")

    def _lower_ends(self, what: str, certified: float, unit: str) -> None:
        """Add an exclusion if the vehicle file allows a thrust limit below the certified one."""
        least = [self.ranges[name][0] for name in _LIMITS if name in self.ranges]
        if least and min(least) < certified:
            self.excludes.append(f"{what}: {min(least)!r} {unit} in the vehicle file, {certified!r} {unit} certified")

    # ---- helpers of all comparisons

    def _hashes(self, *, lawless: bool = False, terms: Mapping[str, float] = _NO_TERMS) -> None:
        laws, vehicle = self.manifest.laws, self.manifest.vehicle
        if not lawless and self.claim["sha256_law"] not in laws:
            self.differs.append(f"law: SHA-256 {self.claim['sha256_law'][:12]} certified, {laws[0][:12]} exported")
        if not vehicle:
            self.differs.append("vehicle: the bundle does not name a vehicle")
        elif self.claim["sha256_vehicle"] != vehicle:
            certified = self.claim["sha256_vehicle"][:12]
            self.differs.append(f"vehicle: SHA-256 {certified} certified, {vehicle[:12]} exported")
        if self.manifest.ranges is None:
            self._unknown("ranges of the vehicle")
        self._terms(terms)

    def _terms(self, certified: Mapping[str, float] = _NO_TERMS) -> None:
        """Compare the vehicle's terms beside equation (3) with the certified ones."""
        have = {name: value for name, value in self.manifest.values.items() if name not in _EQUATION_3}
        if terms := sorted(set(have) - set(certified)):
            self.differs.append(f"vehicle: it has {', '.join(terms)}, which the certificate does not cover")
        for name, value in certified.items():
            if name not in have:
                self.differs.append(f"vehicle: it does not have {name}, which is certified")
            elif have[name] != value:
                self.differs.append(f"{name}: {value!r} certified, {have[name]!r} exported")

    def _vehicle(self, vehicle: Mapping[str, Any], *, ratio: float = 1.0) -> None:
        masses = sorted((self.manifest.values.get(name, 0.0), name) for name in _ALIKE[0][2])
        for what, key, names in _ALIKE:
            # of unequal masses, the range is that of the lighter one
            self._within(what, vehicle[key], (masses[0][1],) if what == "mass" and ratio > 1 else names)
        (light, _), (heavy, _) = masses
        if heavy > light * ratio:
            share = "equal for surge and sway" if ratio == 1 else f"at most {ratio!r} times the lighter one"
            self.differs.append(f"mass: {share} certified, {light!r} kg and {heavy!r} kg exported")

    def _alike(self, asymmetry: float) -> None:
        for what, _, names in _ALIKE[1:]:
            pair = self._numbers(*names)
            if len(pair) == 2 and abs(pair[0] - pair[1]) > asymmetry * (pair[0] + pair[1]) / 2:
                self.differs.append(
                    f"{what}: surge and sway may differ by a share of {asymmetry!r}, "
                    f"but {pair[0]!r} and {pair[1]!r} are exported"
                )

    def _factors(self, what: str, asymmetry: float, rows: Sequence[tuple[str, str, tuple[str, str]]]) -> None:
        """Compare the differences of the ratios of the vehicle's parameters to the law's with a certified asymmetry."""
        values, law = self.manifest.values, self.claim["law"]
        ratios = [
            values[name] / law[key][axis]
            for _, key, names in rows for axis, name in enumerate(names) if name in values and law[key][axis]
        ]  # fmt: skip
        if ratios and (apart := max(ratios) - min(ratios)) > asymmetry * (max(ratios) + min(ratios)) / 2:
            text = f"factors that differ by {apart:.3g} exported"
            self.differs.append(f"{what}: factors that differ by a share of {asymmetry!r} certified, {text}")

    def _late(self, lag: Sequence[float], period: float) -> None:
        self._period(period)
        if not any(lag):
            self.excludes.append("thrust lag: the certificate assumes thrust without lag")
        else:
            self._within("thrust_lag", lag, ("thrust_lag",))

    def _period(self, certified: float) -> None:
        if certified == 0:
            self.excludes.append("sampling: the certificate does not cover commands that are held for a control period")
        elif certified != self.manifest.period:
            self.differs.append(f"period: {certified!r} s certified, {self.manifest.period!r} s exported")

    def _perception(self) -> None:
        if self.claim["sha256_law"] == self.manifest.laws[1] != self.manifest.laws[0]:
            self.excludes.append(_GROUND_TRUTH)

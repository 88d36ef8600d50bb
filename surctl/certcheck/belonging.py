"""`check --bundle`: which numbers of each kind must agree with an exported controller; units, what is not covered.

It is not enough that hashes are equal. Each vehicle parameter must lie in its certified range, each gain must equal the
certified gain, each certified bound must hold for the exported controller, and the dynamics of a loop must be those
that the checker derives from the instruction lists of the bundle. What a certificate states about the law of a robot is
compared with the law's list at some hundreds of points, which `excludes` says. If the certificate states a parameter,
gain or bound that the manifest lacks, the certificate does not belong to the controller. Each number and text of a
claim is compared, is a condition or label that is printed, or is proved by the certificate itself; one that is none of
these is unbound, and then the certificate does not belong either. If the vehicle file gives a wider range than the
certificate, or if the certificate does not cover a part of the controller, the certificate still belongs to the
controller, and `excludes` names what is not covered.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot
from typing import Any

from surctl.certcheck.braking_claim import STOPPING
from surctl.certcheck.braking_claim import read_claim as read_braking
from surctl.certcheck.bundle import Listed, Manifest, Port, stated_sha256
from surctl.certcheck.comparison import ALIKE, LIMITS, ROUNDING, Comparison
from surctl.certcheck.document import MALFORMED, Rejected
from surctl.certcheck.elementary import Undefined
from surctl.certcheck.law_points import Law, compare_braking, compare_following
from surctl.certcheck.loop_dynamics import compare_dynamics
from surctl.certcheck.patience import PATIENCE, patient
from surctl.certcheck.steering import STEERED, STEERED_EXCLUDES, compare_steering
from surctl.certcheck.turning_claim import TurningClaim
from surctl.certcheck.turning_claim import read_claim as read_turning

__all__ = ["Belonging", "compare"]
_GROUND_TRUTH = (
    "perception: the certificate covers the law with true positions as input; the exported law uses its own "
    "perception, and that it is otherwise the same law is stated by the export, not compared"
)
_KINEMATIC = (
    "dynamics, sampling and sensing: the certificate proves one inequality for its variables within their ranges, "
    "and nothing about the rest of the loop"
)
_MODEL = "plant: that the plant of the bundle describes the real one is an assumption"
_PATH = (
    "path: a bundle has no path, so the certificate covers the one that it states; the rule by which the law passes "
    "from one leg to the next is not compared"
)
_RULE = "law: the certificate is about a braking rule alone, to which it binds no law"
_BY_EXPORT = (
    "statement: the export states the inequality for the gains, the vehicle and the cruise speed; the instruction list "
    "is not evaluated"
)
_CODE = "code: that the C files compute what the instruction list states is shown by their tests, not by this check"
_POINTS = "law: its commands are compared with the instruction list at some hundreds of points, not everywhere"
_STAGES = (
    "stages: the certificate covers the law before the exported law's further stages, such as allocation; that it is "
    "otherwise the same law is stated by the export, not compared"
)
_VARIABLES = {"m": ("m11", "m22"), "X": ("Xu", "Yv"), "X2": ("Xuu", "Yvv")}
"""For each variable of the braking inequalities, the vehicle parameters that it represents."""
_GUARDED = (
    ("margin", "margin_m"), ("reaction", "reaction_s"), ("brake", "brake"), ("k_v", "k_v_per_s"), ("k_i", "k_i_per_s2"),
)  # fmt: skip
_FORCE = re.compile("([YN][uvr]?[vru]|m12|m14|Y0|N0)")  # parameters of a vehicle that matter to the heading loop
_VECTORS = ("plant_state", "controller_state", "gains", "parameters", "reference", "disturbance")
_PROVED = {
    "function", "level", "rate", "equilibrium", "radius", "inner", "gains", "initial", "unsafe", "multiplier", "stays",
    "constant",
}  # fmt: skip
"""Entries of a claim about dynamics that the certificate itself proves."""
_DISTURBED = (
    "current_m_per_s", "force_n", "place_error_m", "velocity_error_m_per_s", "heave_m_per_s", "heave_m_per_s2",
    "yaw_rad_per_s2",
)  # fmt: skip
"""Entries of a claim about a cruise that are conditions about things outside the exported code."""
_ENDS = ("lower", "upper")
_SAMPLED = ("next", "commands", "period_s")
"""Entries of a claim about a sampled loop that are compared with the bundle."""


@dataclass(frozen=True)
class Belonging:
    """Result of the comparison of a certificate with an exported controller.

    Attributes:
        differs: one message for each mismatch; empty if the certificate belongs to the controller.
        excludes: one message for each part of the exported controller that the certificate does not cover.
        unbound: path and value of each number or text of the claim that nothing binds to the controller.
        undecided: one message for each part of the dynamics that is not shown to be that of the exported controller,
            though no point shows a difference.
    """

    differs: tuple[str, ...]
    excludes: tuple[str, ...]
    unbound: tuple[str, ...] = ()
    undecided: tuple[str, ...] = ()

    @property
    def belongs(self) -> bool:
        """Return whether the certificate belongs to the controller: nothing differs, is unbound or is undecided."""
        return not (self.differs or self.unbound or self.undecided)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        texts = {key: list(getattr(self, key)) for key in ("differs", "unbound", "undecided", "excludes")}
        return {"belongs": self.belongs, **texts}


def compare(document: Mapping[str, Any], manifest: Manifest) -> Belonging:
    """Compare an accepted certificate with an exported controller.

    Args:
        document: the certificate, of which `kind` and `claim` are read.
        manifest: the manifest of the bundle.
    """
    if document["kind"] == "mission":  # the claim about one leg is about the controller
        inner = compare({"kind": "turning", "claim": document["claim"]["loop"]}, manifest)
        return replace(inner, excludes=(_PATH, *inner.excludes))
    comparison = _Comparison(document["claim"], manifest)
    kinds = {
        "braking": comparison.braking,
        "turning": comparison.turning, "lyapunov": comparison.motion,
        "barrier": comparison.motion, "interval": comparison.inequality,
    }  # fmt: skip
    try:
        with patient(PATIENCE):
            kinds[document["kind"]]()
    except (Rejected, Undefined) as reason:
        comparison.differs.append(f"law: {reason}")
    except MALFORMED:  # each number may be forged
        comparison.differs.append("bundle: its entries and those of the certificate do not fit together")
    if not comparison.differs:
        comparison.excludes.append(_CODE)
    if manifest.extra:
        comparison.excludes.append(f"files: {', '.join(manifest.extra)} are results of a compiler, which are not read")
    lists = comparison.differs, comparison.excludes, comparison.leaves.left(), comparison.undecided
    return Belonging(*map(tuple, lists))


def _units(ports: Sequence[Port], entries: Sequence[Any]) -> dict[str, str]:
    """Return the unit of each entry of a vector by the name that the claim gives it."""
    units: list[str] = []
    for port in ports:
        each = [unit.strip() for unit in port.unit.split(",")]
        units += each if len(each) == port.size else [port.unit] * port.size
    return {entry: unit for entry, unit in zip(entries, units, strict=False) if isinstance(entry, str)}


class _Comparison(Comparison):
    # ---- comparison for each kind of certificate

    def inequality(self) -> None:
        name = str(self.claim["name"])
        self.excludes += [_KINEMATIC, _BY_EXPORT, ROUNDING[self.manifest.real]]
        expected = self.manifest.claims.get(name)
        if expected is None:
            self.differs.append(f"claim {name!r} does not concern the exported law, so it is not bound to the bundle")
        elif expected != stated_sha256(self.claim):
            self.differs.append(f"claim {name!r} is not the one for the bundle's gains, vehicle and cruise speed")
        elif name.startswith("braking-"):
            self.terms()
            for variable in self.claim["variables"]:
                if variable["name"] in _VARIABLES:
                    ends = variable["lower"], variable["upper"]
                    self.within(variable["name"], ends, _VARIABLES[variable["name"]])
        for key in ("name", "statement", "unit", "variables", "left", "right", "constraints"):
            self.take(key)  # the hash covers them
        self.slack(self.take("slack"))

    def motion(self) -> None:
        if "system" in (self.claim["about"] or {}):
            self.steering()
            return
        about = self.take("about") or {}
        if "plant_state" not in about:
            self.differs.append("dynamics: the certificate does not state the loop that its dynamics are about")
            return
        if about["controller"] != self.manifest.laws[0]:
            self.differs.append("controller: the certificate is about another controller")
        lists = [self.manifest.lists.get(about["plant"][at : at + 64]) for at in (0, 64)]
        plant, measured = lists
        if (
            len(about["plant"]) != 2 * 64
            or plant is None
            or measured is None
            or "values" not in plant.numbers
            or "outputs" not in measured.vectors
        ):
            self.differs.append("plant: the bundle does not contain the plant that the certificate is about")
            return
        ranges = {row["name"]: (row["lower"], row["upper"]) for row in self.claim["parameters"]}
        for name, values in about["gains"].items():
            for at, value in enumerate(values):
                self.entry(name, value, self.gains(name), at, ranges)
        lacking = sorted(set(self.manifest.gains) - set(about["gains"]))
        self.differs += [f"{name}: the certificate does not state this gain" for name in lacking]
        for at, value in enumerate(about["parameters"]):
            self.entry("parameter of the plant", value, plant.numbers["values"], at, ranges)
        self.period(about["period_s"])
        self._loop(about, (self.manifest.lists[self.manifest.laws[0]], plant, measured))
        sampled = self.claim["time"] == "sampled"
        for key in ("time", "property", "dynamics", "states", "parameters", *(_SAMPLED if sampled else ())):
            self.take(key)  # compared by the evaluation
        for key in self.claim.keys() & _PROVED:
            self.take(key)
        for at, value in enumerate(about["controller_state"]):  # a state at rest keeps its first value
            if not isinstance(value, str):
                start = self.manifest.lists[self.manifest.laws[0]].numbers["initial_state"]
                self.equal(f"state of the controller[{at}]", value, start[at : at + 1])
        rest = [value for value in about["plant_state"] if not isinstance(value, str)]
        for key, values in {"plant state at rest": rest, **{key: about[key] for key in _VECTORS[-2:]}}.items():
            have = self.manifest.reference if key == "reference" else None
            words = f", but is {', '.join(map(str, have or ()))} in the run of the bundle"
            other = words if have and [*have] != values else ""
            if values:
                self.excludes.append(f"{key}: it is assumed to be {', '.join(map(str, values))}{other}")
        if self.claim.get("constant"):
            self.excludes.append("parameters: each is assumed to be constant, at any value of its range")
        self.excludes += [_MODEL, ROUNDING[self.manifest.real]]
        if sampled:
            self.excludes.append("delay: the command is assumed to act at the instant of its sample")
            self.excludes.append(f"jitter: each control period is assumed to last exactly {about['period_s']!r} s")
        else:
            self.excludes.insert(0, "sampling: the certificate is about the control law in continuous time")

    def turning(self) -> None:
        claim = read_turning(self.claim)
        vehicle, law = self.of("vehicle"), self.of("law")
        self.hashes(terms=vehicle["terms"])
        for name in ("k1", "lookahead", "k_v", "wait", "cruise", "cap"):
            self.gain(name, law[name])
        self.gain("k_i", law["k_i"])
        for (what, key, names), factor in zip(ALIKE, ("mass_factor", "drag_factor", "drag_factor"), strict=True):
            for axis, name in enumerate(names):
                model = law[key][axis]
                self.gain(key.removesuffix("_kg"), model, axis)
                self.within(f"{what} {name}", [model * end for end in vehicle[factor]], (name,))
        self.factors("mass", vehicle["mass_asymmetry"], ALIKE[:1])
        for row in ALIKE[1:]:  # the linear and the quadratic coefficients have their own factors
            self.factors("drag", vehicle["drag_asymmetry"], (row,))
        for axis, name in enumerate(LIMITS):
            limits = name, name.replace("max", "reverse")
            have = [*self.gains("thrust_limit")[axis : axis + 1], *self.numbers(*limits)]
            self.at_least(f"thrust_limit of {name}", vehicle["thrust_n"][axis], "N", have)
            self.lower_ends("thrust", vehicle["thrust_n"][axis], "N")
        self.at_most("yaw rate", vehicle["yaw_rate_rad_per_s"], "rad/s", self.gains("spin"))
        self.at_least("thrust_limit of yaw", vehicle["munk_moment_nm"], "N m", self.yaw_limits())
        self.late(vehicle["lag_s"], law["period_s"])
        self.conditions("vehicle", *_DISTURBED)
        self.conditions("motion", "curvature_per_m")
        self.take("motion")
        self._follows(claim)

    def steering(self) -> None:
        about, values = self.of("about"), self.manifest.values
        if about["system"] != "steered" or tuple(about["excludes"]) != STEERED_EXCLUDES:
            self.differs.append("law: the restrictions are not those of the heading loop of the law steered")
        self.excludes += [*STEERED_EXCLUDES, ROUNDING[self.manifest.real]]
        self.digests(about["sha256_vehicle"], about["sha256_law"])
        self.equal("k_i", 0.0, self.gains("k_i"))
        ranges = {row["name"]: (row["lower"], row["upper"]) for row in self.claim["parameters"]}
        covered = {"m11", "m22", "m24", "m44"}
        for name, value in values.items():
            if name in covered or _FORCE.fullmatch(name):
                if name in ranges:
                    self.within(name, ranges[name], (name,))
                elif value:
                    self.differs.append(f"vehicle: it has {name}, which the certificate does not cover")
        for name in ranges.keys() - values.keys() - {"u", "u_model", "share"}:
            self.unknown(name)
        for name in ranges.keys() & {"u", "u_model"}:
            for value in self.gains("cruise"):
                if not ranges[name][0] <= value <= ranges[name][1]:
                    text = (
                        f"{ranges[name][0]!r} to {ranges[name][1]!r} m/s certified, the cruise speed is {value!r} m/s"
                    )
                    self.differs.append(f"speed: {text}")
        if self.claim["time"] != "continuous":
            self.differs.append("time: the heading loop is compared in continuous time")
        for row in (*self.claim["states"], *self.claim["parameters"]):
            if row["unit"] != (unit := STEERED.get(row["name"], "1")):
                self.differs.append(f"{row['name']}: in {row['unit']} certified, in {unit} exported")
        sway = max(abs(row[end]) for row in self.claim["states"] if row["name"] == "sway" for end in _ENDS)
        cap = self.gains("cap")[0]
        least = cap / hypot(cap, sway)
        if not (ranges["share"][0] <= least and ranges["share"][1] >= 1):
            text = f"{ranges['share'][0]!r} to {ranges['share'][1]!r} certified, the speed cap leaves {least:.4g} to 1"
            self.differs.append(f"share: {text}")
        fins = self.manifest.fins or {}
        most = [fins["moment_nm"]] if fins else self.yaw_limits()[1:]
        for value in self.gains("thrust_limit")[3:4]:
            self.at_least("thrust_limit of yaw", value, "N m", most)
        self.excludes.append(f"conditions: u = {list(ranges['u'])!r}")
        for key in self.claim.keys() & _PROVED | {"time", "property", "dynamics", "states", "parameters"}:
            self.take(key)  # compared, or proved by the certificate
        self.excludes.append(f"name: {self.take('name')!r} is a label, which nothing is compared with")
        for exported in self._laws(about["sha256_law"]):
            compare_steering(exported, self.claim, fins, self.differs.append)

    def braking(self) -> None:
        claim = read_braking(self.claim)
        vehicle, met, watch, law = self.of("vehicle"), self.of("encounter"), self.of("watch"), self.claim["law"]
        self.hashes(lawless=law is None)
        self.vehicle(vehicle, ratio=vehicle["mass_ratio"])
        if vehicle["drag"] == "along":
            self.alike(0.0)
        limits = self.limits()
        self.at_least("thrust_limit", vehicle["brake_n"], "N", limits)
        self.lower_ends("thrust", vehicle["brake_n"], "N")
        self.at_most("thrust", vehicle["most_n"], "N", limits)
        if len(limits) == 4 and (both := hypot(*limits[:2])) > vehicle["most_n"]:
            text = f"up to {both:.3g} N possible, up to {vehicle['most_n']!r} N certified"
            self.excludes.append(f"thrust of both axes together: {text}")
        self.at_most("thrust_lag", vehicle["lag_s"], "s", self.numbers("thrust_lag"))
        for radius in self.numbers("radius"):  # the law measures the clearance from the radius hull
            text = f"hull: the vehicle has a radius of {radius!r} m"
            self.differs += [f"{text}, {own!r} m exported" for own in self.gains("hull") if own < radius]
        self.at_most("yaw rate", met["turn_rad_per_s"], "rad/s", self.gains("spin"))
        if claim.turn or claim.ratio > 1:
            self.at_most("thrust across", vehicle["side_n"], "N", limits)
        self.conditions("vehicle", "side_n")
        cap = self.gains("cap")
        self.at_most("speed", met["fastest_m_per_s"], "m/s", cap)
        if cap and cap[0] > met["sideways_m_per_s"]:
            text = f"up to {met['sideways_m_per_s']!r} m/s certified, up to {cap[0]!r} m/s may be commanded"
            self.excludes.append(f"speed across the direction of the obstacle: {text}")
        self.period(watch["period_s"])
        self.conditions("watch", "age_s", "range_error_m", "speed_error_m_per_s")
        self.conditions("encounter", "obstacles_m_per_s", "current_m_per_s", "disturbance_n", "sideways_m_per_s")
        self.take("table")  # what the certificate proves
        if law is None:
            self.differs.append(_RULE)
            return
        law = self.of("law")
        self.at_most("speed wanted", law["cap_m_per_s"], "m/s", cap)
        for name, key in _GUARDED:
            self.gain(name, law[key])
        self.believed(law)
        for at in (0, 1):
            self.at_least("thrust_limit", law["limit_n"], "N", self.gains("thrust_limit")[at : at + 1])
        stopping = law["stopping"]
        for at, key in enumerate(STOPPING):
            self.gain("stopping", stopping[key], at)
        for key in ("barrier", "gain"):
            law[key]  # bound by the evaluation
        for exported in self._laws(self.claim["sha256_law"]):
            compare_braking(exported, claim, self.differs.append)

    # ---- evaluation of the instruction lists

    def _laws(self, digest: str) -> list[Law]:
        """Return the certified law, and the exported one if it has the same inputs; none if something differs."""
        if self.differs:  # the first mismatch explains those that would follow
            return []
        certified, exported = (self.manifest.lists.get(key) for key in (digest, self.manifest.laws[0]))
        if certified is None or exported is None:
            self.differs.append("law: the bundle does not contain the instruction list of the certified law")
            return []
        self.excludes.append(_POINTS)
        laws = [Law(certified, self.manifest)]
        inputs = [{port.name for port in listed.vectors["inputs"]} for listed in (certified, exported)]
        if certified is not exported:
            if inputs[0] == inputs[1]:
                laws.append(Law(exported, self.manifest))
            else:
                self.excludes.append(_GROUND_TRUTH if inputs[1] - inputs[0] != {"working"} else _STAGES)
        return laws

    def _follows(self, claim: TurningClaim) -> None:
        yaw_rate = float(claim.yaw_rate)
        for law in self._laws(self.claim["sha256_law"]):
            fastest = compare_following(law, claim, self.differs.append)
            if fastest > yaw_rate:
                text = f"up to {yaw_rate!r} rad/s certified, the law may ask for {fastest:.3g} rad/s"
                self.excludes.append(f"yaw rate: {text}")

    def _loop(self, about: Mapping[str, Any], lists: tuple[Listed, Listed, Listed]) -> None:
        if self.differs:
            return
        rows = [*self.claim["states"], *self.claim["parameters"]]
        names, box = [row["name"] for row in rows], [(row["lower"], row["upper"]) for row in rows]
        flat = {"gains": [value for name in self.manifest.gains for value in about["gains"][name]]}
        vectors = {key: flat.get(key, about[key]) for key in _VECTORS}
        unknown = {e for entries in vectors.values() for e in entries if isinstance(e, str)} - set(names)
        states = {row["name"] for row in self.claim["states"]}
        places = [e for key in _VECTORS[:2] for e in vectors[key] if isinstance(e, str)]
        if unknown or set(places) != states or len(places) != len(states):
            self.differs.append("dynamics: the certificate does not say which state of the loop each of its states is")
            return
        controller, plant, measured = (listed.vectors for listed in lists)
        known = {port.name for port in measured["outputs"]}
        ports = (plant["state"], controller["state"], controller["gains"], plant["parameters"],
                 [port for port in controller["inputs"] if port.name not in known], plant["disturbances"])  # fmt: skip
        units: dict[str, str] = {}
        for key, of_vector in zip(_VECTORS, ports, strict=True):
            units |= _units(of_vector, vectors[key])
        for row in rows:
            if units.get(row["name"]) != row["unit"]:
                have = units.get(row["name"], "no number")
                self.differs.append(f"{row['name']}: in {row['unit']} certified, in {have} exported")
        sampled = self.claim["time"] == "sampled"
        if self.claim["time"] not in ("continuous", "sampled"):
            self.differs.append("time: the loop of a bundle is compared in continuous time, or sampled")
        if sampled:
            self.equal("period_s", self.claim["period_s"], [self.manifest.period])
            units = _units(plant["inputs"], [row["name"] for row in self.claim["commands"]])
            for row in self.claim["commands"]:
                if units[row["name"]] != row["unit"]:
                    self.differs.append(f"{row['name']}: in {row['unit']} certified, in {units[row['name']]} exported")
        if self.take("name") != lists[1].text.partition("\n")[0].removeprefix("program ").removeprefix("routine "):
            self.differs.append(f"plant: {self.claim['name']!r} certified, another one exported")
        if not self.differs:
            commands = {row["name"]: row["value"] for row in self.claim["commands"]} if sampled else {}
            further = (self.claim["next"], commands) if sampled else None
            results = compare_dynamics(
                names, box, self.claim["dynamics"], vectors, lists, self.manifest.period, further
            )
            for messages, texts in zip((self.differs, self.undecided), results, strict=True):
                messages += [f"dynamics: {text}" for text in texts]

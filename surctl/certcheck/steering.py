"""The heading loop of a craft without sway force under the law `steered`, as a `lyapunov` certificate states it.

The dynamics are these texts, with the gains of the bundle and the parameters of the claim; a certificate with any other
text is about another loop. What the texts state about the law is compared with the law's instruction list at points:
the yaw moment, and the motion of the two filters. The motion of the craft is that of equations (2) and (3) of Basso et
al. with further terms of hydrodynamic forces.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.law_points import Law, Report, leg_of, report_difference, values_at

__all__ = ["STEERED", "STEERED_EXCLUDES", "Gains", "compare_steering", "heading_loop"]

Array: TypeAlias = NDArray[np.float64]
Gains: TypeAlias = Mapping[str, Sequence[float]]

STEERED = {"y_e": "m", "psi": "rad", "v": "m/s", "r": "rad/s", "crab": "rad", "sway": "m/s"}
"""States of the heading loop of a craft without sway force, with units: cross-track error, heading to the path, sway
speed, yaw rate, and the two filters of the law: crab angle and modelled sway speed."""

STEERED_EXCLUDES = (
    "the path is one straight leg, on which the law commands a positive speed; guidance is los",
    "no obstacle is near, so that the law chooses the desired course and speed",
    "the surge loop is not covered: the surge speed u, and that of the law's model, may vary in any way in their range",
    "measured position, heading and velocity are exact; there is no current and no wave",
    "the thrusters deliver every commanded yaw moment up to its limit, whatever the surge force; fins do so up to the "
    "share (speed / cruise)^2 of it below the cruise speed, with a side force in proportion to the moment",
    "the thrust has no lag; commands are not held, and the two filters of the law are continuous in time",
    "heave is 0, and roll and pitch are left out",
)
"""Restrictions of a claim about this loop; a certificate repeats the restrictions word for word."""

_POINTS = 160
_SLOWEST, _MUNK_SHARE, _YAW_SHARE, _LEAST_RATE = 0.25, 0.5, 0.85, 1e-3  # of the law
_COVERED = {"u", "u_model", "share", "m11", "m22", "m24", "m44"}


def heading_loop(gains: Gains, names: Collection[str], side: float = 0.0) -> dict[str, str]:
    """Return the text of the rate of each of the states `STEERED`, and as `moment` that of the yaw moment.

    Args:
        gains: numbers of the law by name, one for each axis for `mass`, `linear_drag`, `quadratic_drag` and
            `thrust_limit`, otherwise one.
        names: names of the parameters of the claim: `u`, `share`, `m22`, `m44`, and those of `u_model`, `m11`, `m24`
            and of the force coefficients that the craft has.
        side: sway force for each N m of the yaw moment [1/m].

    Raises:
        Rejected: a parameter is not part of the loop.
    """
    for name in names:
        if name not in _COVERED and not re.fullmatch("[YN][uvr]?[vr]", name):
            raise Rejected(f"the parameter {name} is not part of the heading loop")
    cruise, water = gains["cruise"][0], "u_model" if "u_model" in names else "u"
    away = cruise / _number(_planned(gains, repr(cruise)))
    error = f"psi + (atan(y_e/{max(gains['lookahead'][0], away)!r}) + crab)"
    planned = _planned(gains, water)
    turn = f"min(max(-({gains['k_psi'][0]!r}*({error})), -{planned}), {planned})"
    drag, square, inertia = (gains[key][3] for key in ("linear_drag", "quadratic_drag", "mass"))
    free = f"{drag!r}*{turn} + {turn}*{square!r}*abs({turn}) + {inertia * gains['k_r'][0]!r}*({turn} - r)"
    free = f"{free} + u*{gains['munk'][0]!r}*(share*sway)"
    most = _most(gains, "u")
    moment = f"min(max({free}, -({most})), {most})"
    m11, m22, m24, m44 = (name if name in names else "0" for name in ("m11", "m22", "m24", "m44"))
    along = {"Yr": m11, "Nv": f"m22 - {m11}", "Nr": m24}
    force, torque = (f"{thrust}{_damping(names, axis, along)}" for axis, thrust in
                     (("Y", f"{side!r}*{moment}" if side else ""), ("N", moment)))  # fmt: skip
    rates = {"v": f"({force})/{m22}", "r": f"({torque})/{m44}"}
    if "m24" in names:
        cross = "m24/(m22*m44 - m24^2)"
        rates["v"] = f"({force})/(m22 - m24^2/m44) - {cross}*({torque})"
        rates["r"] = f"({torque})/(m44 - m24^2/m22) - ({force})*({cross})"
    sway, mass = f"{gains['linear_drag'][1]!r} + {gains['quadratic_drag'][1]!r}*abs(sway)", gains["mass"][1]
    return {
        "y_e": "u*sin(psi) + v*cos(psi)", "psi": "r", **rates,
        "crab": f"(atan(v/u) - crab)/{gains['crab_time'][0]!r}",
        "sway": f"-(r*({water}*{gains['centripetal'][0] / mass!r}) + sway*(({sway})/{mass!r}))",
        "moment": moment,
    }  # fmt: skip


def _damping(names: Collection[str], axis: str, along: Mapping[str, str]) -> str:
    """Return the forces by sway speed and yaw rate in the direction of an axis, Y or N."""
    text = ""
    for speed in "vr":
        own = [name for name in sorted(names) if re.fullmatch(f"{axis}[uvr]?{speed}", name)]
        plain = [
            name if len(name) == 2 else f"{name}*abs({name[1]})" for name in own if name[1] != "u" or len(name) == 2
        ]
        with_u = [along[axis + speed]] if axis + speed in along else []
        with_u += [name for name in own if len(name) == 3 and name[1] == "u"]
        plain += [f"u*({' + '.join(with_u)})"] if with_u else []
        text += f" - {speed}*({' + '.join(plain)})" if plain else ""
    return text


def _most(gains: Gains, speed: str, share: float = 1.0) -> str:
    """Return a share of the largest yaw moment at a surge speed [N m]; that of fins grows with the speed."""
    fins, most = gains["fin_share"][0], share * gains["thrust_limit"][3]
    if not fins:
        return repr(most)
    ratio = f"min(max({speed}, 0)/{gains['cruise'][0]!r}, 1)"
    return f"{most!r}*(1 - {'' if fins == 1 else f'{fins!r}*'}(1 - {ratio}^2))"


def _planned(gains: Gains, speed: str) -> str:
    """Return the largest yaw rate that the law plans at a surge speed [rad/s]."""
    u, munk, centripetal = f"max({speed}, {_SLOWEST * gains['cruise'][0]!r})", gains["munk"][0], gains["centripetal"][0]
    drag, square = gains["linear_drag"], gains["quadratic_drag"]
    drift = f"min({gains['sideslip'][0]!r}*{u}, {_most(gains, u, _MUNK_SHARE)}/max({u}*{abs(munk)!r}, 1e-06))"
    sideways = f"({drag[1]!r}*{drift} + {drift}*({drift}*{square[1]!r}))"
    damping = repr(drag[3])
    if centripetal < 0:  # the craft drifts inwards, so that the Munk moment acts against the turn
        damping = f"({drag[3]!r} + max({munk!r}*{u}*({-centripetal!r}*{u}/{max(drag[1], 1e-6)!r}), 0))"
    root = f"sqrt({damping}^2 + {_most(gains, u, 4 * square[3] * _YAW_SHARE)})"
    limit = f"{_most(gains, u, 2 * _YAW_SHARE)}/max({damping} + {root}, 1e-06)"
    if not gains["fin_share"][0] and centripetal >= 0:
        limit = repr(_number(limit))
    return f"max(min({sideways}/max({u}*{abs(centripetal)!r}, 1e-06), {limit}), {_LEAST_RATE!r})"


def _number(text: str) -> float:
    return float(values_at((), np.zeros((0, 1)), {"": text})[""][0])


def compare_steering(law: Law, claim: Mapping[str, Any], fins: Mapping[str, float], report: Report) -> None:
    """Compare the dynamics of a claim with the texts of the heading loop, and these with the law's list.

    The points lie in the region, half of them at its border.

    Args:
        law: the exported law.
        claim: a claim of kind `lyapunov` about the system `steered`.
        fins: the bundle's numbers of fins; empty if the craft has none.
        report: function that gets one message if something differs.
    """
    rows = [*claim["states"], *claim["parameters"]]
    names = [row["name"] for row in rows]
    if names[: len(STEERED)] != list(STEERED) or set(claim["dynamics"]) != set(STEERED):
        raise Rejected("the states are not those of the heading loop")
    if bool(fins) != ("u_model" in names):
        raise Rejected("the law for fins, and no other, has a surge speed u_model of its own")
    gains = {name: values.tolist() for name, values in law.gains.items()}
    texts = heading_loop(gains, names[len(STEERED) :], fins.get("side_per_m", 0.0))
    table = ExpressionTable(names)
    for name in STEERED:
        if table.read(claim["dynamics"][name]) != table.read(texts[name]):
            report(f"dynamics: the rate of {name} is not that of the heading loop with these gains")
            return
    rng, n, dt = np.random.default_rng(12), _POINTS, law.period
    low, high = (np.array([row[key] for row in rows])[:, None] for key in ("lower", "upper"))
    points = low + (high - low) * rng.random((len(rows), n))
    [value] = values_at(names, points, {"V": claim["function"]}).values()
    points[: len(STEERED)] *= np.sqrt(claim["level"] / value) * np.where(np.arange(n) % 2, 1.0, rng.random(n))
    at = dict(zip(names, points, strict=True))
    y, psi, v, r, crab, sway = points[: len(STEERED)]
    leg = leg_of(0.7, 400 * gains["lookahead"][0])
    mission = leg.mission(law) | {"walls": 1e3 * leg.mission(law)["walls"]}
    inputs = law.inputs(n, eta=leg.pose(np.zeros(n), y, psi, -3.0), nu=np.vstack([at["u"], v, np.zeros(n), r]))
    water = at.get("u_model", at["u"])
    outputs, after = law.step(law.state(n, progress=leg.progress, crab=crab, sway=sway, surge=water), inputs, **mission)
    late = {name: law.part("state", after, name)[0] for name in ("crab", "sway")}
    damping = (gains["linear_drag"][1] + gains["quadratic_drag"][1] * np.abs(sway)) / gains["mass"][1]
    own = values_at(names, points, {name: texts[name] for name in late})
    # the law's filters take one implicit step, and the moment is that of their new values
    rates = {"crab": (late["crab"] - crab) / dt * (1 + dt / gains["crab_time"][0]),
             "sway": (late["sway"] - sway) / dt * (1 + dt * damping)}  # fmt: skip
    moved = np.vstack([points[:4], late["crab"], late["sway"], points[len(STEERED) :]])
    ends = []
    for share in (next(row["lower"] for row in rows if row["name"] == "share"), 1.0):
        moved[names.index("share")] = share  # what the speed cap leaves of the law's sway speed is not known
        ends.append(values_at(names, moved, {"moment": texts["moment"]})["moment"])
    most = values_at(names, points, {"most": _most(gains, "u")})["most"]
    moment = np.clip(outputs["tau"][3], -most, most)
    compared = [("moment", "N m", np.clip(moment, np.minimum(*ends), np.maximum(*ends)), moment)]
    compared += [(f"rate of {name}", f"{STEERED[name]}/s", own[name], rate) for name, rate in rates.items()]
    for what, unit, claimed, exported in compared:
        if (apart := law.same.apart(claimed[None], exported[None])).any():
            k = int(np.argmax(apart))
            place = f"y_e = {y[k]:.4g} m, heading {psi[k]:.4g} rad, yaw rate {r[k]:.4g} rad/s"
            report_difference(report, what, place, unit, claimed[k : k + 1], exported[k : k + 1])
            return

"""Two more laws of one's own: an orbit with a state, and station keeping with a super-twisting velocity controller.

    surctl simulate orbit.toml --law orbit_law.py:orbit
    surctl simulate orbit.toml --law orbit_law.py:station

Super-twisting: Levant 1993, Int. J. Control 58(6), eq. (6): u = k1 |e|^(1/2) sign(e) + z, z' = k2 sign(e).
"""

from collections.abc import Mapping

import casadi as ca

from surctl.control import Decision, GainSpec, LawSource, Situation
from surctl.ir import Port
from surctl.tasks import depth_task, heading_task, velocity_task

TURN = (Port("turned", (1,), "rad", "angle about the centre so far"),)
ORBIT = {
    "radius": GainSpec("m", "radius of the orbit", default=1.0, range=(0.6, 2.0)),
    "k_orbit": GainSpec("1/m", "gain of the radial error", default=2.0, range=(0.5, 6.0)),
}
STATION = {
    "approach": GainSpec("1/s", "speed towards the station over the distance", default=0.4, range=(0.1, 1.0)),
    "twist": GainSpec("m^0.5/s^1.5", "gain k1 of super-twisting", default=0.3, range=(0.05, 1.0)),
    "twist_i": GainSpec("m/s^2", "gain k2 of super-twisting", default=0.02, range=(0.0, 0.2), zero_allowed=True),
}


def around(s: Situation) -> Decision:
    """Orbit the middle of the site counter-clockwise, looking ahead; the state counts the angle."""
    walls = s.p["walls"]
    offset = s.eta[:2] - ca.vertcat(walls[0] + walls[1], walls[2] + walls[3]) / 2
    distance = ca.sqrt(ca.sumsqr(offset) + 1e-9)
    outwards = offset / distance
    tangent = ca.vertcat(-outwards[1], outwards[0])
    slope = s.p["k_orbit"] * (distance - s.p["radius"])
    velocity = s.p["cruise"] * (tangent - slope * outwards) / ca.sqrt(1 + slope * slope)
    turned = s.x["turned"] + s.dt * ca.dot(velocity, tangent) / ca.fmax(distance, s.p["radius"] / 2)
    heading = heading_task(s.eta, ca.atan2(velocity[1], velocity[0]), gain=s.p["k_psi"])
    tasks = [velocity_task(s.eta, velocity), depth_task(s.eta, s.p["depth"], gain=s.p["k2"]), heading]
    return Decision(tasks, velocity=velocity, state={"turned": turned})


def keep(s: Situation) -> Decision:
    """Go to the end of the path and stay there."""
    towards = s.p["approach"] * (s.p["waypoints"][-1, :].T - s.eta[:2])
    velocity = towards * ca.fmin(1, s.p["cruise"] / ca.fmax(ca.sqrt(ca.sumsqr(towards)), 1e-6))
    return Decision(
        [velocity_task(s.eta, velocity), depth_task(s.eta, s.p["depth"], gain=s.p["k2"])], velocity=velocity
    )


def super_twisting(reference: ca.SX, nu: ca.SX, state: ca.SX, p: Mapping[str, ca.SX], dt: float) -> tuple[ca.SX, ca.SX]:
    """Return thrust (4, 1) before limits, and the next state z (4, 1): drag at the reference plus super-twisting."""
    error = reference - nu
    sign = ca.if_else(error > 0, 1, ca.if_else(error < 0, -1, 0))
    drag = p["linear_drag"] * reference + p["quadratic_drag"] * reference * ca.fabs(reference)
    thrust = drag + p["mass"] * (p["twist"] * ca.sqrt(ca.fabs(error)) * sign + state)
    return thrust, state + dt * p["twist_i"] * sign


def orbit() -> LawSource:
    """Return the orbit, with a state of its own."""
    return LawSource("orbit", around, gains=ORBIT, state=TURN)


def station() -> LawSource:
    """Return station keeping, with a velocity controller of its own."""
    return LawSource("station", keep, gains=STATION, thrust=super_twisting)

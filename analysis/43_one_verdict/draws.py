"""Vehicles with gains, and systems of a user's own, that a seed determines."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np

from surctl.ir import Layout, Port
from surctl.marine.control import Gains, load_gains
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.system import Controller, Cost, Plant, System

__all__ = ["SYSTEM_SECONDS", "loop", "vehicle"]

SYSTEM_SECONDS = 2.0
_CRAFT = ("sur400", "sur540-flooded", "bluerov2-wu")


def vehicle(seed: int) -> tuple[Vehicle, Gains, float]:
    """Return a vehicle with or without ranges, gains from weak to wild, and a cruise speed [m/s]."""
    rng = np.random.default_rng(seed)
    base = load_vehicle(_CRAFT[seed % 3])
    parameters = dict(base.parameters)
    for name in ("m33", "m44", "Xu", "Nr", "thrust_lag"):
        factor = rng.uniform(0.8, 1.25)
        span = parameters[name].range and tuple(float(factor * end) for end in parameters[name].range)
        parameters[name] = replace(parameters[name], value=float(base[name] * factor), range=span)
    gains = load_gains("default")
    gains = gains.with_values({n: gains[n] * rng.uniform(0.5, 2.0) for n in ("k_v", "k_r", "k_psi", "lookahead", "k1")})
    return replace(base, name=f"drawn{seed}", parameters=parameters), gains, float(rng.uniform(0.08, 0.2))


@cache
def loop(seed: int) -> System:
    """Return a plant of 1 to 4 states under state feedback with limits: some unstable, some saturated, some robust."""
    rng = np.random.default_rng([7, seed])
    n, m = int(rng.integers(1, 5)), int(rng.integers(1, 3))
    A, B = rng.normal(0, 1, (n, n)) - rng.uniform(0, 1.5) * np.eye(n), rng.normal(0, 1, (n, m))
    K, limit = rng.normal(0, 1, (m, n)) + 1.5 * rng.uniform() * B.T, float(10 ** rng.uniform(-1, 2))
    state = Layout((Port("x", (n,), "m", "place", 0.3),))
    force = Layout((Port("u", (m,), "N", "force"),))
    cubic = float(rng.choice([0.0, 0.2]))
    plant = Plant(
        f"plant{seed}", state, force,
        lambda x, f, d, p: p["pull"] * (ca.DM(A) @ x["x"]) - cubic * x["x"] ** 3 + ca.DM(B) @ f["u"] / p["mass"],
        parameters=Layout((Port("pull", (1,), "1/s", "of the plant", 1.0), Port("mass", (1,), "kg", "moved", 1.0))),
    )  # fmt: skip
    law = Controller(
        f"law{seed}", float(rng.choice([0.01, 0.05, 0.1])), state, force,
        lambda x, u, p: ca.fmin(ca.fmax(-p["k"] * (ca.DM(K) @ u["x"]), -limit), limit),
        gains=Layout((Port("k", (1,), "N/m", "of the feedback", 1.0),)),
    )  # fmt: skip
    costs = {
        "end": Cost(lambda s: ca.sumsqr(s.x["x"]), "final", "m^2", "at the end", at_most=0.5),
        "work": Cost(lambda s: ca.sumsqr(s.f["u"]), "rms", "N^2"),
    }
    ranges = {"plant.pull": (0.9, 1.1), "plant.mass": (0.8, 1.25)} if seed % 2 else {}
    return System(plant, law, costs=costs, ranges=ranges)

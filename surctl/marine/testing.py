"""Check whether a law of the user's own can be built, run and exported, and whether its tasks stay finite."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import check_count
from surctl.ir import replay
from surctl.marine.control import Law, LawSource, load_gains
from surctl.marine.control.build import build_law_of
from surctl.marine.simulation import law_numbers, load_scenario
from surctl.marine.vehicle import load_vehicle
from surctl.system import NONFINITE
from surctl.system.controller import lost_entry
from surctl.testing.ranges import CheckFailed, checked_type

__all__ = [
    "LawReport",
    "check_law",
]

Array: TypeAlias = NDArray[np.float64]

_COMPARED = 20  # points at which CasADi is compared, which takes most of the time
_SAME = 1e-9  # [N, N m]


@dataclass(frozen=True)
class LawReport:
    """Properties of a law that passed the check.

    Attributes:
        name: name of the law.
        levels: (name, number of rows) of each priority level, highest first.
        state, gains: names of the states and of the gains that the law defines itself.
        samples: number of poses, velocities and states at which the law was evaluated.
        digest: SHA-256 of what the law computes.
    """

    name: str
    levels: tuple[tuple[str, int], ...]
    state: tuple[str, ...]
    gains: tuple[str, ...]
    samples: int
    digest: str


def check_law(source: LawSource, *, samples: int = 200, extent: float = 5.0, seed: int = 0) -> LawReport:
    """Check a law: two builds give equal instructions; thrust and next state are finite, thrust within its limits.

    The law is built for true positions in its first priority mode. At random poses, velocities, obstacle points and
    states, the instruction list and CasADi must agree, the thrust must respect the limits of vehicle sur540-flooded,
    and no value may be NaN or infinite.

    Args:
        source: the law.
        samples: number of random points.
        extent: largest |x|, |y|, |z| of random poses [m]; ψ is in (−π, π).
        seed: seed of numpy's PCG64 generator.

    Raises:
        CheckFailed: the law fails; the message states where.
        InputError: the law cannot be built, or `samples` is not positive.

    Example:
        >>> from surctl.marine.control import Decision, LawSource
        >>> from surctl.tasks import depth_task
        >>> from surctl.marine.testing import check_law
        >>> hold = LawSource("hold", lambda s: Decision([depth_task(s.eta, s.p["depth"], gain=s.p["k2"])]))
        >>> check_law(hold).levels
        (('depth', 1),)
    """
    check_count("samples", samples, least=1)
    checked_type(source, LawSource, key="check_law")
    law, again = build_law_of(source), build_law_of(source)
    what = f"law {source.name}"
    if law.block.digest() != again.block.digest():
        raise CheckFailed(what, "two builds give different instructions; `decide` must not draw random numbers")
    gains = load_gains("default").with_own(source.gains)
    vehicle = load_vehicle("sur540-flooded")
    p = law_numbers(load_scenario("tank-speed-010"), gains, vehicle)
    x, u = _points(law, samples, extent, np.random.default_rng(seed))
    tau, following, _, telemetry = replay(law.block, x, u, np.tile(p, (samples, 1)))
    finite = [np.isfinite(values).all(axis=1) for values in (tau, following, telemetry)]
    for k in np.flatnonzero(~np.all(finite, axis=0))[:1]:
        raise CheckFailed(what, f"{lost_entry(law, x[k], u[k], p)} is not finite", at=_at(law, x[k], u[k]))
    over = np.flatnonzero((np.abs(tau) > np.asarray(vehicle.thrust_limit) * (1 + 1e-12)).any(axis=1))
    if over.size:
        raise CheckFailed(what, "thrust exceeds the limits", at=_at(law, x[over[0]], u[over[0]]))
    for k in range(min(samples, _COMPARED)):
        step = law.step(x[k], u[k], p)
        if step.status == NONFINITE or not np.allclose(step.tau, tau[k], rtol=0, atol=_SAME):
            raise CheckFailed(what, "CasADi and the instruction list differ", at=_at(law, x[k], u[k]))
    return LawReport(
        source.name,
        tuple((name, rows) for name, rows, _ in law.levels),
        tuple(port.name for port in source.state),
        tuple(source.gains),
        samples,
        law.block.digest(),
    )


def _points(law: Law, count: int, extent: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return random states and inputs: poses, velocities, and one obstacle point at a random position."""
    x = np.tile(law.initial_state(), (count, 1))
    x[count // 2 :] += rng.uniform(-1, 1, x[count // 2 :].shape)
    u = np.tile(law.inputs.pack(), (count, 1))
    eta, nu = law.inputs.slice("eta"), law.inputs.slice("nu")
    u[:, eta] = rng.uniform(-1, 1, (count, 4)) * [extent, extent, extent, np.pi]
    u[:, nu] = rng.uniform(-0.3, 0.3, (count, 4))
    if "contacts" in law.inputs:
        first = law.inputs.slice("contacts").start
        u[:, first : first + 2] = rng.uniform(-extent, extent, (count, 2))
        u[:, first + 2], u[:, first + 5] = 0.3, 1.0
    return x, u


def _at(law: Law, x: Array, u: Array) -> str:
    eta, nu = (np.round(u[law.inputs.slice(name)], 3).tolist() for name in ("eta", "nu"))
    return f"eta {eta}, nu {nu}, state {np.round(x, 3).tolist()}"

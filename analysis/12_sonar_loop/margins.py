"""Study 12: margins of the linear loop of a law with sonars about a straight cruise.

    python analysis/12_sonar_loop/margins.py [--quick]

The loop is the code that runs: CasADi differentiates the own-state filter (at its steady covariance) and the decision;
the plant with its thrust lag is that of `plant_jacobians`, and a command acts one period late. The hull does not turn,
no obstacle is near, and all water is known. A fix comes every second period, so the loop repeats after two periods: it
is stable if the eigenvalues of two periods together lie in the unit circle (apart from a shift along the path).

The band of law `calm` has two linear limits: for large signals it passes the demand (`still` = 0), for small ones it is
a lag of the time constant `settle`. Between them, the command differs from the demand by the half width of the band at
most, which is a bounded disturbance of the first loop: it cannot make that loop unstable.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from surctl.control import build_law, law_parameters, law_source, load_gains
from surctl.guidance import Path
from surctl.ir import to_casadi
from surctl.sensing import Equipment, OwnStateFilter
from surctl.vehicle import load_vehicle, plant_jacobians, plant_parameters

Array = NDArray[np.float64]
FAR, LONGEST = 1e6, 60  # m; periods of extra delay
FILTERED = (
    "position",
    "velocity",
    "disturbance",
    "accelerations",
    "thrust",
    "turn",
)  # the rest is constant in a cruise
REMEMBERED = ("eased", "pushed", "held")  # of the law; the target moves on without the measurements, and k_i is 0
FILTERS: dict[tuple[str, str, float, float], list[tuple[Array, ...]]] = {}
SHIFT = 1e-5  # distance of an eigenvalue from 1 that counts as the shift along the path

LAWS: tuple[tuple[str, str, dict[str, float]], ...] = (
    ("guarded", "-", {}), ("calm", "full", {"still": 0.0}), ("calm", "lag", {}),
)  # fmt: skip


class Loop:
    """Two periods of the linear loop, with a factor and a delay at the thrust commands of some axes."""

    def __init__(self, name: str, vessel: str, cruise: float, gains: dict[str, float], manoeuvre: float) -> None:
        law, vehicle, own = build_law(name, sonar=True), load_vehicle(vessel), Equipment().own
        assert own is not None
        source = law_source(name)
        noise = source.model_noise
        filt = OwnStateFilter(
            dt=law.dt, latency=own.fixes.latency, period=own.fixes.period, position_sd=own.position_sd,
            yaw_sd=own.yaw_sd, rate_sd=own.rate_sd, model_noise=noise,
            acceleration_noise=float(np.hypot(source.acceleration_noise, noise * manoeuvre)),
        )  # fmt: skip
        whole = load_gains("default").with_own(source.gains).with_values(gains)
        path, site = Path([[-FAR, 0.0], [FAR, 0.0]]), (-2 * FAR, 2 * FAR, -2 * FAR, 2 * FAR)
        p = law_parameters(whole, vehicle, path=path, depth=0.0, cruise=cruise, cap=1.5 * cruise, walls=site)
        p = law.gains.pack({**law.gains.split(p), "spin": 0.0}) if "spin" in law.gains else p
        nu = np.array([cruise, 0.0, 0.0, 0.0])
        (A,), (B,), (trim,) = plant_jacobians(plant_parameters(vehicle)[None], nu[None])
        exact = expm(np.block([[A, B], [np.zeros((4, 16))]]) * law.dt)
        self.dt, self.late, self.plant = law.dt, filt.late, (exact[:12, :12], exact[:12, 12:])
        about = (name, vessel, cruise, manoeuvre)  # other gains of the law: the same filter
        if about not in FILTERS:
            FILTERS[about] = self._filtered(filt, law.gains.split(p), nu, trim)
        self.filter = FILTERS[about]
        self.decide = self._decided(law, p, nu, cruise)

    def _filtered(self, filt: OwnStateFilter, p: dict[str, Array], nu: Array, trim: Array) -> list[tuple[Array, ...]]:
        ports = filt.ports()
        x = {port.name: ca.SX.sym(port.name, *_shape(port.shape)) for port in ports}
        tau, fix, fresh, turn = ca.SX.sym("tau", 4), ca.SX.sym("fix", 3), ca.SX.sym("fresh"), ca.SX.sym("turn", 2)
        model = {k: ca.DM(np.ravel(p[k])) for k in ("mass", "linear_drag", "quadratic_drag", "thrust_limit")}
        done = filt.update(x, fix=fix, fix_fresh=fresh, yaw=turn[0], yaw_rate=turn[1], tau=tau, model=model)
        flat = [ca.vec(x[port.name]) for port in ports]
        after = [ca.vec(done.state[port.name]) for port in ports]
        some = [ca.vec(done.state[k]) for k in FILTERED]
        step = ca.Function("step", [*flat, tau, fix, fresh, turn], after)
        results, by = (
            ca.vertcat(*some, done.eta, done.nu),
            ca.vertcat(*(ca.vec(x[k]) for k in FILTERED), fix, turn, tau),
        )
        slope = ca.Function("slope", [*flat, tau, fix, fresh, turn], [ca.jacobian(results, by)])
        state = [np.full(ca.vec(x[port.name]).shape, float(np.ravel(port.default)[0])) for port in ports]
        found: list[Array] = []
        for k in range(802):  # until the covariance is steady; the last two, without and with a fix
            here = np.array([nu[0] * self.dt * (k - self.late), 0.0, 0.0])
            given = [*state, trim, here, float(k % 2 == 1), np.zeros(2)]
            if k >= 800:
                found.append(np.array(slope(*given)))
            state = [np.array(each) for each in step(*given)]
        n = found[0].shape[0] - 8
        return [(J[:, :n], J[:, n : n + 3], J[:, n + 3 : n + 5], J[:, n + 5 :]) for J in found]

    def _decided(self, law: object, p: Array, nu: Array, cruise: float) -> tuple[Array, Array]:
        outputs, state = law.perception.outputs, law.state  # type: ignore[attr-defined]
        closed = to_casadi(law.stages.closed)  # type: ignore[attr-defined]
        names = [k for k in REMEMBERED if k in state]
        ports = [port for port in state.ports if port.name not in {q.name for q in law.perception.state.ports}]
        at = np.concatenate([np.ravel(np.broadcast_to(port.default, port.shape or (1,))) for port in ports]).astype(
            float
        )
        start = {}
        k = 0
        for port in ports:
            start[port.name] = slice(k, k + int(np.prod(port.shape)))
            k = start[port.name].stop
        x = at.copy()
        x[start["progress"]] = FAR
        if "eased" in start:
            x[start["eased"]] = [cruise, 0.0]
        x[start["last_velocity"]] = [cruise, 0.0]
        sonars = outputs.port("sonars").shape[0]
        u = outputs.pack({
            "nu": nu, "unknown": np.tile([0.0, 0.0, 100.0], (outputs.port("unknown").shape[0], 1)), "placed": 1.0,
            "echoed": 1.0, "sonars": np.tile([2.0, 0.01, 1.0, 0.0, 1.0, 0.0], (sonars, 1)),
        })  # fmt: skip
        xs, us = ca.SX.sym("x", len(x)), ca.SX.sym("u", len(u))
        tau, x_next, *_ = closed(xs, us, ca.DM(p))
        chosen = np.array([k for n in names for k in np.arange(len(x))[start[n]]], dtype=int)
        seen = np.concatenate([np.arange(len(u))[outputs.slice(n)] for n in ("eta", "nu")])
        both = ca.Function("both", [xs, us], [x_next[chosen.tolist()], tau])
        step = ca.Function("f", [xs, us], [x_next])
        for _ in range(600):  # to the steady cruise of the law: the target's distance, the memories
            after = np.array(step(x, u)).ravel()
            after[start["progress"]] = x[start["progress"]]
            keep = x.copy()
            for n in names:
                keep[start[n]] = after[start[n]]
            x = keep
        by_x = _slope(lambda v: both(v, u), x, chosen) if len(chosen) else np.zeros((4, 0))
        return by_x, _slope(lambda v: both(x, v), u, seen)

    def radius(self, factor: complex, delay: int, axes: tuple[int, ...]) -> float:
        """Return the largest eigenvalue of a period, with the commands of these axes times a factor, and later."""
        (Ap, Bp), (by_x, by_u), n, m = self.plant, self.decide, self.filter[0][0].shape[1], self.decide[0].shape[1]
        _, b, c, d = np.cumsum([12, 3 * self.late, n, 4])
        q = d + m  # plant, old positions, filter, last thrust, law; then each axis's queue of commands
        places = [1 + delay * (axis in axes) for axis in range(4)]
        size = q + sum(places)
        total = np.eye(size, dtype=complex)
        scale = np.ones(4, dtype=complex)
        scale[list(axes)] = factor
        for by_z, by_fix, by_turn, by_tau in self.filter:
            M = np.zeros((size, size), dtype=complex)
            oldest = slice(b - 3, b) if self.late else slice(0, 3)
            seen = np.zeros((n + 8, size), dtype=complex)
            seen[:, b:c], seen[:, c:d] = by_z, by_tau
            seen[:, oldest] += by_fix
            seen[:, [3, 7]] += by_turn
            law = by_u @ seen[n:]
            law[:, d:q] += by_x
            M[b:c], M[d:q], M[c:d] = seen[:n], law[:m], law[m:]
            M[:12, :12] = Ap
            M[12:15, :3] = np.eye(3)
            M[15:b, 12 : b - 3] = np.eye(3 * (self.late - 1))
            for axis, end in enumerate(np.cumsum(places)):
                first, last = q + end - places[axis], q + end - 1
                M[:12, last] += Bp[:, axis] * scale[axis]
                M[first] = law[m + axis]
                for k in range(first, last):
                    M[k + 1, k] = 1
            total = M @ total
        values = np.linalg.eigvals(total)
        return float(np.abs(values[np.abs(values - 1) > SHIFT]).max())

    def disk(self, axes: tuple[int, ...], angles: int) -> float:
        """Return the radius of the symmetric disk of factors (1 + δ/2)/(1 − δ/2), |δ| < α, that leave it stable."""

        def most(angle: float, limit: float) -> float:
            low, high = 0.0, limit
            while high - low > 2e-3:
                middle = 0.5 * (low + high)
                delta = 0.5 * middle * np.exp(1j * angle)
                low, high = (middle, high) if self.radius((1 + delta) / (1 - delta), 0, axes) < 1 else (low, middle)
            return low

        least = 1.99
        for angle in np.linspace(0, np.pi, angles):
            delta = 0.5 * least * np.exp(1j * angle)
            if self.radius((1 + delta) / (1 - delta), 0, axes) >= 1:
                least = most(float(angle), least)
        return least

    def delay(self, axes: tuple[int, ...]) -> float:
        """Return the largest whole number of periods of extra delay that leave the loop stable, in s."""
        for k in range(1, LONGEST):
            if self.radius(1.0, k, axes) >= 1:
                return (k - 1) * self.dt
        return LONGEST * self.dt


def _slope(function: Callable[[Array], tuple[ca.DM, ...]], at: Array, chosen: Array) -> Array:
    # central differences, since the law has square roots of 0 in a cruise
    columns = []
    for k in chosen:
        step = np.zeros(len(at))
        step[k] = 1e-6
        ahead, behind = (np.concatenate([np.array(each).ravel() for each in function(at + s * step)]) for s in (1, -1))
        columns.append((ahead - behind) / 2e-6)
    return np.array(columns).T


def _shape(shape: tuple[int, ...]) -> tuple[int, ...]:
    return shape if len(shape) == 2 else (int(np.prod(shape)), 1)


def main(words: list[str]) -> int:
    """Print the margins of both laws for two vehicles."""
    parser = argparse.ArgumentParser(prog="margins.py", description="Margins of the linear loop with sonars.")
    parser.add_argument("--quick", action="store_true", help="law calm, one vehicle and filter, few angles")
    quick = parser.parse_args(words).quick
    print("| law | vehicle | band | filter | disk: surge | sway | heave | delay: surge [s] | sway | heave |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for vessel, cruise in (("sur540-flooded", 0.2), ("sur400", 0.15))[: 1 if quick else 2]:
        for name, band, gains in LAWS[1 if quick else 0 :]:
            filters = (("cruise", 0.0), ("full thrust", 5.0 / load_vehicle(vessel)["m11"]))
            for filtered, push in filters[: 1 if quick else 2]:
                loop = Loop(name, vessel, cruise, gains, push)
                if loop.radius(1.0, 0, (0,)) >= 1:
                    print(
                        f"| `{name}` | `{vessel}` | {band} | {filtered} | unstable, {loop.radius(1.0, 0, (0,)):.5f} |"
                    )
                    continue
                angles = 4 if quick else 19
                which = ((0,), (1,), (2,))
                disks = " | ".join(f"{loop.disk(axes, angles):.2f}" for axes in which)
                delays = " | ".join(f"{loop.delay(axes):.2f}" for axes in which)
                print(f"| `{name}` | `{vessel}` | {band} | {filtered} | {disks} | {delays} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

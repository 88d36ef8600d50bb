"""Approaches and the sonar echoes on them: many runs at once, true ranges and samples as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.marine.sensing import SonarArray
from surctl.marine.sensing.sonar.echo import beam_of, echo_range
from surctl.marine.sensing.sonar.solids import SolidBox, SolidWalls

Array = NDArray[np.float64]
Kind = Literal["wall", "obstacle", "wall, turning", "obstacle, turning", "tank, turning"]
KINDS: tuple[Kind, ...] = ("wall", "obstacle", "wall, turning", "obstacle, turning", "tank, turning")

DT = 0.05  # s, control step
EVERY = 2  # steps from one firing of a sensor to its next
START = 4.3  # m, from the apex to the wall or obstacle
BRAKING = 0.05  # m/s²
BOX = (0.3, 1.6)  # m, along x and y
FAR = 1e3  # m, walls of open water
# two of the four sensors: one is tested, the other is the source of crosstalk
ARRAY = SonarArray(azimuths=(0.0, pi / 2), order=(0, 1), firing_period=0.05)


@dataclass(frozen=True)
class Approach:
    """Many runs; axes: run, step, and sensor where there is one.

    Attributes:
        time: (steps,) [s].
        truth: (runs, steps, sensors) range [m], at most the sensor's maximum.
        closing: (runs, steps, sensors) measured own speed along the beams [m/s].
        expected: (runs, steps, sensors) [m].
        turn: (runs, steps) [rad/s].
        speed: (runs, steps) true own speed [m/s].
        samples: (runs, firings, sensors, samples) honest [m]; firing k arrives at step k·EVERY.
    """

    time: Array
    truth: Array
    closing: Array
    expected: Array
    turn: Array
    speed: Array
    samples: Array

    @property
    def seen(self) -> Array:
        """Return the quantity that the bound is about: the range, at most the sensor's maximum."""
        return np.minimum(self.truth, ARRAY.maximum)


def approach(
    kind: Kind, runs: int, *, seed: int, duration: float = 60.0, speed: float | None = None, stop: float | None = None
) -> Approach:
    """Runs that close in on a wall or a box from START and hover before it; speeds and stops are drawn.

    Own speed is measured with 1 cm/s noise; the expected range follows from a pose with 1 cm and 0.01 rad noise.

    Args:
        kind: what is approached, whether it is known, and whether the beam turns meanwhile.
        runs: how many.
        seed: of all that is random.
        duration: [s].
        speed: of all runs [m/s], instead of 0.05 to 0.22.
        stop: clearance at which they hover [m], instead of 0.3 to 1.
    """
    rng = np.random.default_rng(seed)
    steps = round(duration / DT)
    turning, known = "turning" in kind, not kind.startswith("obstacle")
    cruise = rng.uniform(0.05, 0.22, runs) if speed is None else np.full(runs, speed)
    final = rng.uniform(0.3, 1.0, runs) if stop is None else np.full(runs, stop)
    x, v = _travelled(cruise, final, steps, rng)
    rate = rng.uniform(0.22, 0.45, runs) * rng.choice((-1.0, 1.0), runs) if turning else np.zeros(runs)
    heading = (rng.uniform(-pi, pi, runs) if turning else np.zeros(runs))[:, None] + rate[:, None] * (
        DT * np.arange(steps)
    )
    y = np.zeros_like(x)
    front = ARRAY.hull_radius + START
    box = np.full((runs, 2), FAR)
    walls = np.tile((-FAR, FAR, -FAR, FAR), (runs, 1)).astype(float)
    if kind.startswith("wall"):
        walls[:, 1] = front
    else:
        box = np.column_stack([np.full(runs, front + 0.5 * BOX[0]), rng.uniform(-0.5, 0.5, runs)])
    if kind.startswith("tank"):
        walls = np.column_stack(
            [-rng.uniform(1, 4, runs), np.zeros(runs), -rng.uniform(1.0, 4.0, runs), np.zeros(runs)]
        )
        walls[:, 1], walls[:, 3] = walls[:, 0] + 10.0, walls[:, 2] + 5.0
    truth = np.minimum(_ranges(x, y, heading, walls, box), 2 * ARRAY.maximum)
    if known:
        measured = (x + rng.normal(0, 0.01, x.shape), y + rng.normal(0, 0.01, x.shape))
        nothing = np.full((runs, 2), FAR)
        expected = _ranges(*measured, heading + rng.normal(0, 0.01, x.shape), walls, nothing)
    else:
        expected = np.full(truth.shape, 2 * ARRAY.maximum)
    if not turning:  # an object moves along beside the robot
        truth[..., 1] = rng.uniform(0.5, 3.0, runs)[:, None]
        expected[..., 1] = 2 * ARRAY.maximum
    along = np.cos(heading[..., None] + np.array(ARRAY.azimuths))
    closing = (v + rng.normal(0, 0.01, v.shape))[..., None] * along
    fired = truth[:, ::EVERY]
    noise = rng.standard_normal((*fired.shape, ARRAY.samples))
    return Approach(
        DT * np.arange(steps),
        truth,
        closing,
        expected,
        np.broadcast_to(rate[:, None], v.shape),
        v,
        heard(fired, noise),
    )


def heard(truth: Array, noise: Array) -> Array:
    """Return samples (..., k) [m] of firings at ranges (...), with the errors of one firing."""
    top, far = ARRAY.top_code, ARRAY.maximum
    raw = np.clip(truth[..., None] + ARRAY.bias + ARRAY.noise_sd * noise, ARRAY.minimum, far)
    codes = np.floor(raw * top / far + 0.5) * far / top
    return np.where(truth[..., None] > far, far, codes)


def _travelled(cruise: Array, final: Array, steps: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return distance [m] and speed [m/s], (runs, steps): accelerate, brake, hover with a sway of 1 cm/s."""
    way, speed = np.zeros((len(cruise), steps)), np.zeros((len(cruise), steps))
    x, v, phase = np.zeros(len(cruise)), np.zeros(len(cruise)), rng.uniform(0, 2 * pi, len(cruise))
    for k in range(steps):
        way[:, k] = x
        left = np.maximum(START - final - x, 0.0)
        v = np.minimum(np.minimum(v + BRAKING * DT, cruise), np.sqrt(2 * BRAKING * left))
        speed[:, k] = v + 0.01 * np.sin(2 * pi * k * DT / 7.0 + phase)
        x = x + DT * speed[:, k]
    return way, speed


def _ranges(x: Array, y: Array, heading: Array, walls: Array, box: Array) -> Array:
    """Return ranges (runs, steps, sensors) [m] by the symbolic echo model of the closed loop; 2·maximum without an
    echo.
    """
    place, psi, w, c = ca.SX.sym("p", 2), ca.SX.sym("psi"), ca.SX.sym("w", 4), ca.SX.sym("c", 2)
    out = []
    for sensor in range(ARRAY.size):
        beam = beam_of(ARRAY, [sensor], 0, position=place, heading=psi)
        out.append(echo_range(ARRAY, beam, [SolidBox(c, ca.SX(ca.DM(BOX))), SolidWalls(w)]))
    function = ca.Function("ranges", [place, psi, w, c], [ca.vertcat(*out)])
    runs, steps = x.shape
    found = np.empty((runs, steps, ARRAY.size))
    mapped = function.map(steps)
    for r in range(runs):
        once = mapped(
            np.vstack([x[r], y[r]]), heading[r], np.tile(walls[r], (steps, 1)).T, np.tile(box[r], (steps, 1)).T
        )
        found[r] = np.asarray(once).T
    return found

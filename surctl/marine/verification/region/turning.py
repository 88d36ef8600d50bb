"""A claim about a turning cruise with different masses in surge and sway."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from surctl.certcheck.fields import written
from surctl.certcheck.turning_claim import EXCLUDES, read_claim
from surctl.certcheck.turning_claim import TurningClaim as Stated
from surctl.errors import InputError, NotApplicable

Pair = tuple[float, float]

_HEAVE: Pair = (0.1, 0.1)
"""Largest heave velocity [m/s] (the law commands no more) and heave acceleration [m/s²] that the claims assume."""

_TURN_RATE = 1.0
"""Largest yaw acceleration [rad/s²] that the claims assume."""


@dataclass(frozen=True)
class TurningClaim:
    """Claim about the cruise of a vehicle under the exported law, for all parameters in given ranges.

    A true parameter is its value in the law's model times a constant factor; SI units.

    Attributes:
        name: name of the claim.
        mass_factor, drag_factor: (least, largest) factor of the masses and of the drag coefficients.
        mass_asymmetry, drag_asymmetry: largest difference of the factors of the two masses, and of the two linear or
            the two quadratic drag coefficients, divided by their mean.
        thrust: least thrust limits (surge, sway) of the plant and of the law [N].
        yaw_limit: largest yaw moment of the thrusters [N m].
        yaw_rate: largest yaw rate |r| [rad/s]; within this limit the heading may change arbitrarily.
        mass, linear, quadratic: (surge, sway) values in the law's model.
        gains: the gains k1, lookahead, k_v, k_i and wait.
        cruise, cap: speed of the target point on the path, and largest commanded speed [m/s].
        rate: decay rate a [1/s] of the Lyapunov function V: V̇ ≤ −a V.
        rest: whether the region must also contain a vehicle at rest.
        jumps: deviations (δx_e, δU_x, δU_y) from the target [m, m/s] for which the search shapes the region; if there
            are none, it shapes the region for starts beside the path.
        digests: SHA-256 of the vehicle's parameters, and SHA-256 of the law's instruction list.
        terms: the vehicle's terms beside equation (3), by name; inertia is off by `mass_factor`, the others by
            `drag_factor`.
        heave, turn_rate: largest heave velocity and acceleration [m/s, m/s²], and largest yaw acceleration [rad/s²].
        curvature: largest curvature of the path [1/m].
        current: largest speed of a constant current [m/s].
        lag: time constant of the thrust lag [s]; 0 for thrust without lag.
        period: control period [s], during which the command is constant; 0 for a loop in continuous time.
        force, place_error, velocity_error: largest horizontal disturbance force [N], and largest errors of the measured
            position [m] and velocity [m/s], varying arbitrarily; only for a loop without lag and in continuous time.
    """

    name: str
    mass_factor: Pair
    drag_factor: Pair
    mass_asymmetry: float
    drag_asymmetry: float
    thrust: Pair
    yaw_limit: float
    yaw_rate: float
    mass: Pair
    linear: Pair
    quadratic: Pair
    gains: Mapping[str, float]
    cruise: float
    cap: float
    rate: float
    rest: bool = False
    jumps: tuple[tuple[float, float, float], ...] = ()
    digests: tuple[str, str] = ("0" * 64, "0" * 64)
    terms: Mapping[str, float] = field(default_factory=dict)
    heave: Pair = _HEAVE
    turn_rate: float = _TURN_RATE
    curvature: float = 0.0
    current: float = 0.0
    lag: float = 0.0
    period: float = 0.0
    force: float = 0.0
    place_error: float = 0.0
    velocity_error: float = 0.0

    def __post_init__(self) -> None:
        """Raise InputError for a number out of bounds, NotApplicable for integral action or a cruise speed ≥ cap."""
        for key in ("cruise", "cap", "rate"):
            if not getattr(self, key) > 0:
                raise InputError("must be greater than 0", key=key, value=getattr(self, key), remedy="correct it")
        if self.gains["k_i"]:
            raise NotApplicable("the claim is about a loop without integral action and k_i is not 0", to="these gains")
        if self.cruise >= self.cap:
            why = f"the cruise speed of {self.cruise:g} m/s is not below the cap of {self.cap:g} m/s"
            raise NotApplicable(why, to="these speeds")
        if self.behind and (self.curvature or self.terms.get("m12")):
            raise NotApplicable("thrust lag and held commands are not covered together with m12 or a curved path")
        for key in ("force", "place_error", "velocity_error"):
            if not getattr(self, key) >= 0:
                raise InputError("must be at least 0", key=key, value=getattr(self, key), remedy="correct it")
            if self.behind and getattr(self, key):
                raise InputError(
                    "is not supported together with thrust lag or held commands", key=key, value=getattr(self, key),
                    remedy="leave out sampled and lagged",
                )  # fmt: skip

    def document(
        self, *, offset: float, rest_offset: float | None, ultimate_bound: Pair, munk_moment: float
    ) -> dict[str, Any]:
        """Return the claim as data of a certificate, with the offsets [m], bound [m] and moment [N m] to be stated."""
        values = {
            **vars(self), **self.gains, "heave": self.heave[0], "heave_rate": self.heave[1],
            "lag": (self.lag, self.lag), "offset": offset, "rest_offset": rest_offset,
            "ultimate_bound": ultimate_bound, "munk_moment": munk_moment,
        }  # fmt: skip
        return {
            "system": "turning-cruise", "excludes": list(EXCLUDES), **written(Stated, values),
            "sha256_vehicle": self.digests[0], "sha256_law": self.digests[1],
        }  # fmt: skip

    @property
    def behind(self) -> bool:
        """Whether the thrust may differ from the present command: by a lag, or because a command is held."""
        return bool(self.lag or self.period)

    @property
    def late_parts(self) -> int:
        """Number of pairs of states that thrust lag and held commands add."""
        return (self.lag > 0) + (self.period > 0)

    @property
    def ideal(self) -> bool:
        """Whether the masses are equal, and there is no lag, held command, current, curve, force or error."""
        more = (self.mass_asymmetry, self.lag, self.period, self.current, self.curvature, self.terms)
        return self.mass[0] == self.mass[1] and not any((*more, self.force, self.place_error, self.velocity_error))

    @cached_property
    def stated(self) -> Stated:
        """Return the claim as the checker reads it, with a region that is not yet known."""
        return read_claim(self.document(offset=1.0, rest_offset=None, ultimate_bound=(1.0, 1.0), munk_moment=0.0))

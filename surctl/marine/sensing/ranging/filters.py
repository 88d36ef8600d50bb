"""The filters of the paper for raw sonar samples: weighted average, gate, and adaptive LMS filter (Algorithm 1).

The gate follows equations (4)–(5) of the paper, and Algorithm 1 follows equations (6)–(7). The filters are CasADi
expressions for the exported law; their state is an explicit input and output. The expressions use only + − × ÷ sqrt
fabs fmin fmax, comparisons, logic and if_else. Every branch of an if_else is finite for finite inputs, because
denominators have lower limits. In windows and histories, the newest value is first. Ranges are in metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal, NamedTuple, TypeAlias, get_args

import casadi as ca

from surctl.errors import check_known
from surctl.ir import Port
from surctl.marine.sensing.sonar.array import SonarArray

StepRule: TypeAlias = Literal["corrected", "printed"]
"""Rule for the step size μ of Algorithm 1: `corrected` (at most the line-search optimum) or `printed` (erratum E5)."""

POWER_FLOOR = 1e-6  # m², far below any XᵀX of real ranges
ERROR_FLOOR = 1e-9  # m
FILTER_GAINS = ("lambda1", "relaxation", "beta_max")


def weighted_average(samples: ca.SX) -> ca.SX:
    """Return the weighted mean of one firing's `samples` (k,) [m], oldest first.

    The paper says "weighted average" but does not give the weights. The weights 1, 2, …, k are a design choice; they
    rise linearly to the newest sample.
    """
    k = samples.numel()
    weights = ca.DM(range(1, k + 1))
    return ca.dot(weights, samples) / (k * (k + 1) / 2)


def gate(window: ca.SX, value: ca.SX, *, lambda1: ca.SX, resolution: float) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the gated value [m], equations (4)–(5) of the paper; 1 if `value` was accepted; and the next window.

    The gate accepts `value` if it lies within λ1·S of the previous raw value; otherwise it returns the running mean. S
    is the standard deviation of the values in the window (n,), newest first, but at least one conversion step: a
    constant signal has S = 0, and the gate would then refuse every value. With λ1 = 0 the gate accepts no value. The
    window also stores refused raw values, so after a true jump of the range the gate refuses one value and accepts the
    next: it follows a jump one firing late, and cannot refuse for ever.
    """
    n = window.numel()
    mean = ca.sum1(window) / n
    variance = ca.dot(window, window) / n - mean * mean
    spread = ca.fmax(ca.sqrt(ca.fmax(variance, 0.0)), resolution)
    accepted = ca.fabs(value - window[0]) < lambda1 * spread
    return ca.if_else(accepted, value, mean), accepted, _pushed(window, value)


class LmsStep(NamedTuple):
    """Result of one step of Algorithm 1, as CasADi SX expressions."""

    theta: ca.SX
    """(m,) next weights θ_{n+1}, dimensionless."""
    errors: ca.SX
    """(N,) last absolute residuals |ℜ| [m], newest first."""
    mean_error: ca.SX
    """Exponential mean ē of the corrected error [m]."""
    residual: ca.SX
    """Residual ℜ_n = x_n − θ_nᵀX_n of the prediction [m]."""
    corrected_error: ca.SX
    """Corrected error e_n of equation (7) of the paper [m]."""


def lms_step(
    theta: ca.SX,
    theta_prev: ca.SX,
    *,
    X: ca.SX,
    x_n: ca.SX,
    errors: ca.SX,
    mean_error: ca.SX,
    relaxation: ca.SX,
    beta_max: ca.SX,
    step: StepRule = "corrected",
) -> LmsStep:
    """Return the result of a step of Algorithm 1 of the paper, with errata E5, E6 and E19 corrected.

    The algorithm predicts the value x_n as θ_nᵀX, where X holds the m values *before* x_n (erratum E19), and ℜ = x_n −
    θ_nᵀX is the residual. The corrected error of equation (7) is e_n = (1/N) Σ w_i |ℜ_i| over the last N residuals,
    where the weight w_i falls linearly from 1 (newest) to 1/N (erratum E6). The exponential mean of e_n is ē, with a
    time constant of N firings (design choice). The variance that equation (7) also defines is not used in any formula.

    If e_n ≥ ē, the weights change by equation (6) to θ_{n+1} = θ_n + 2μℜX + β(θ_n − θ_{n−1}) with the momentum β =
    β_max·min(1, e_n/ē); otherwise the weights do not change ("smaller … does not need to be corrected"). With `step`
    "corrected", 2μ = ρ/XᵀX with the relaxation 0 < ρ ≤ 1; ρ = 1 is the line-search optimum with residual 0. With `step`
    "printed", 2μ = 2/XᵀX for every ρ; the residual after the step is −ℜ, so the magnitude of the residual never
    decreases (erratum E5).

    Args:
        theta: weights θ_n (m,).
        theta_prev: previous weights θ_{n−1} (m,).
        X: (m,) the m values before x_n [m], newest first.
        x_n: the value to be predicted [m].
        errors: (N,) last absolute residuals |ℜ| before this step [m], newest first.
        mean_error: exponential mean ē of the corrected error before this step [m].
        relaxation: relaxation ρ, limited to [0, 1].
        beta_max: largest momentum β_max, limited to [0, 0.5].
        step: rule for the step size μ, "corrected" or "printed".
    """
    check_known(step, get_args(StepRule), "unknown LMS step", key="step")
    n = errors.numel()
    residual = x_n - ca.dot(theta, X)
    history = _pushed(errors, ca.fabs(residual))
    weights = ca.DM([(n - i) / n for i in range(n)])
    corrected = ca.dot(weights, history) / n
    rho = 2.0 if step == "printed" else ca.fmax(0.0, ca.fmin(relaxation, 1.0))
    beta = ca.fmax(0.0, ca.fmin(beta_max, 0.5)) * ca.fmin(1.0, corrected / ca.fmax(mean_error, ERROR_FLOOR))
    power = ca.fmax(ca.dot(X, X), POWER_FLOOR)
    moved = theta + rho * residual / power * X + beta * (theta - theta_prev)
    return LmsStep(
        theta=ca.if_else(corrected >= mean_error, moved, theta),
        errors=history,
        mean_error=mean_error + (corrected - mean_error) / n,
        residual=residual,
        corrected_error=corrected,
    )


class FilterUpdate(NamedTuple):
    """Result of `SensorFilter.update`, as CasADi SX expressions."""

    state: dict[str, ca.SX]
    """Next state: value of each entry, by name."""
    range_hat: ca.SX
    """(n,) filtered range from each apex [m]."""
    healthy: ca.SX
    """(n,) 1 if the range is reliable, else 0."""


@dataclass(frozen=True, kw_only=True)
class SensorFilter:
    """The filters of the paper for every sensor of an array: weighted average, gate and LMS filter.

    Attributes:
        array: the sonar array.
        step: rule for the step size μ, `corrected` or `printed`, see `lms_step`.
        window: number n of values in the window of the gate.
        taps: number m of values that Algorithm 1 uses for a prediction.
        memory: number N of residuals in the corrected error of equation (7) of the paper.
        refusals: number of consecutive refused values after which a sensor counts as unhealthy.
        jump: accepted change [m] between two firings that indicates another object (design choice; a closing speed of
            0.5 m/s gives 0.05 m). The LMS filter then restarts, so that it predicts no ranges between the two objects.
    """

    array: SonarArray = field(default_factory=SonarArray)
    step: StepRule = "corrected"
    window: ClassVar[int] = 8
    taps: ClassVar[int] = 4
    memory: ClassVar[int] = 8
    refusals: ClassVar[int] = 3
    jump: ClassVar[float] = 0.3

    def __post_init__(self) -> None:
        check_known(self.step, get_args(StepRule), "unknown LMS step", key="filter.step")

    def ports(self, prefix: str = "") -> tuple[Port, ...]:
        """Return the entries (name, shape, initial value) of the state, with one row per sensor.

        Initially, no echo is stored and no sensor is healthy.
        """
        n, far = self.array.size, self.array.maximum
        return (
            Port(f"{prefix}window", (n, self.window), "m", "averaged raw ranges, newest first", far),
            Port(f"{prefix}history", (n, self.taps), "m", "gated ranges, newest first", far),
            Port(f"{prefix}theta", (n, self.taps), "1", "LMS weights", 1.0 / self.taps),
            Port(f"{prefix}theta_prev", (n, self.taps), "1", "LMS weights one firing ago", 1.0 / self.taps),
            Port(f"{prefix}errors", (n, self.memory), "m", "absolute prediction errors, newest first"),
            Port(f"{prefix}mean_error", (n,), "m", "running mean of the corrected error"),
            Port(f"{prefix}refused", (n,), "1", "number of consecutive refused values", float(self.refusals)),
        )

    def gain_ports(self, prefix: str = "") -> tuple[Port, ...]:
        """Return the entries (name, shape, default) of the gains; the defaults are a design choice."""
        return (
            Port(f"{prefix}lambda1", (1,), "1", "half-width of the gate (5) in standard deviations, >= 0", 3.0),
            Port(f"{prefix}relaxation", (1,), "1", "LMS step as a fraction of the optimum, 0 to 1", 0.5),
            Port(f"{prefix}beta_max", (1,), "1", "largest LMS momentum, 0 to 0.5", 0.2),
        )

    def update(
        self, state: Mapping[str, ca.SX], samples: ca.SX, *, fresh: ca.SX, gains: Mapping[str, ca.SX], prefix: str = ""
    ) -> FilterUpdate:
        """Return the ranges after one control step; the filters of the sensors that fired process new samples.

        The range must be valid until the sensor fires again. So the range is the smaller of two values: the newest
        output of the gate, and the prediction of the next value. The range is limited to [lowest, maximum]. A sensor is
        healthy while fewer than `refusals` consecutive values are refused; before its first accepted value it is
        unhealthy. With λ1 = 0 no value counts as refused.

        Args:
            samples: (n, samples) raw samples [m], oldest first; the samples of sensors that did not fire are ignored,
                but must be finite.
            fresh: (n,) 1 for a sensor that fired since the last step, else 0.
        """
        names = [port.name.removeprefix(prefix) for port in self.ports(prefix)]
        rows = []
        for i in range(self.array.size):
            old = {name: state[prefix + name][i, :].T for name in names}
            new = self._fired(old, samples[i, :].T, gains={k: gains[prefix + k] for k in FILTER_GAINS})
            rows.append({name: ca.if_else(fresh[i] > 0.5, new[name], old[name]) for name in names})
        after = {name: ca.vertcat(*(row[name].T for row in rows)) for name in names}
        gated = after["history"][:, 0]
        predicted = ca.sum2(after["theta"] * after["history"])
        range_hat = ca.fmax(self.array.lowest, ca.fmin(self.array.maximum, ca.fmin(gated, predicted)))
        healthy = after["refused"] < self.refusals
        return FilterUpdate({prefix + name: after[name] for name in names}, range_hat, healthy)

    def _fired(self, old: Mapping[str, ca.SX], samples: ca.SX, *, gains: Mapping[str, ca.SX]) -> dict[str, ca.SX]:
        # by port name without prefix
        value = weighted_average(samples)
        lambda1 = gains["lambda1"]
        gated, accepted, window = gate(old["window"], value, lambda1=lambda1, resolution=self.array.resolution)
        lms = lms_step(
            old["theta"],
            old["theta_prev"],
            X=old["history"],
            x_n=gated,
            errors=old["errors"],
            mean_error=old["mean_error"],
            relaxation=gains["relaxation"],
            beta_max=gains["beta_max"],
            step=self.step,
        )
        fine = ca.logic_or(accepted, ca.logic_not(lambda1 > 0))
        anew = ca.logic_and(accepted, ca.fabs(gated - old["history"][0]) > self.jump)
        mean_of_taps = ca.DM.ones(self.taps) / self.taps
        return {
            "window": window,
            "history": ca.if_else(anew, gated * ca.DM.ones(self.taps), _pushed(old["history"], gated)),
            "theta": ca.if_else(anew, mean_of_taps, lms.theta),
            "theta_prev": ca.if_else(anew, mean_of_taps, old["theta"]),
            "errors": ca.if_else(anew, old["errors"], lms.errors),
            "mean_error": ca.if_else(anew, old["mean_error"], lms.mean_error),
            "refused": ca.if_else(fine, 0.0, ca.fmin(old["refused"] + 1.0, float(self.refusals))),
        }


def _pushed(window: ca.SX, value: ca.SX) -> ca.SX:
    return ca.vertcat(value, window[:-1, :])

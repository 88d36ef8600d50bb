"""Convert gain sets to trials of optuna's journal, and back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from surctl.marine.tuning.evaluation import Evaluation
from surctl.marine.tuning.pool import CAP, Pool, Request
from surctl.tuning.journal import quiet_optuna

if TYPE_CHECKING:
    from optuna.trial import FrozenTrial

__all__ = ["distributions", "frozen", "objectives", "remembered", "user_attributes"]

_TABLES = ("normalised", "figure", "speed", "excess")  # fields of `Evaluation`, in its order


def objectives(pool: Pool, start: NDArray[np.float64]) -> list[list[float]]:
    """Return the two objectives, score and thrust, of every gain set; both are limited to finite values."""
    effort = pool.evaluation.effort
    usual = max(float(np.fmin.reduce(effort, initial=np.inf)), 1e-9)
    bounded = np.where(np.isfinite(effort), effort, CAP * usual if np.isfinite(usual) else CAP)
    return [[float(s), float(t)] for s, t in zip(pool.score(start), bounded, strict=True)]


def user_attributes(pool: Pool, k: int) -> dict[str, Any]:
    """Return the results of the k-th gain set as trial attributes, from which `remembered` rebuilds the pool."""
    e = pool.evaluation
    tables = {name: getattr(e, name)[k].tolist() for name in _TABLES}
    return {**tables, "effort": float(e.effort[k]), "claims": pool.claims[k].tolist()}


def remembered(request: Request, trials: Sequence[FrozenTrial]) -> Pool:
    """Rebuild the pool of gain sets from a batch of trials of the journal."""

    def table(name: str) -> NDArray[np.float64]:
        return np.array([t.user_attrs[name] for t in trials], dtype=float)

    sets = {s.name: np.array([t.params[s.name] for t in trials]) for s in request.space}
    normalised, figure, speed, excess = (table(name) for name in _TABLES)
    whole = Evaluation(request.goals, normalised, figure, speed, excess, table("effort"))
    claims = table("claims").reshape(len(trials), len(request.claims))
    return Pool(sets, whole, claims)


def frozen(request: Request, pool: Pool, start: NDArray[np.float64]) -> list[FrozenTrial]:
    """Return gain sets as finished trials."""
    optuna, space = quiet_optuna(), distributions(request)
    return [
        optuna.trial.create_trial(
            params=pool.gains(k), distributions=space, values=values, user_attrs=user_attributes(pool, k)
        )
        for k, values in enumerate(objectives(pool, start))
    ]


def distributions(request: Request) -> dict[str, Any]:
    """Return the search space as distributions of optuna."""
    optuna = quiet_optuna()
    return {s.name: optuna.distributions.FloatDistribution(s.low, s.high, log=s.log) for s in request.space}

"""`surctl tune FILE.py:FUNCTION`: search the gains that minimise the first cost of a system of the user's own."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from surctl.cli.activity import doing, progress
from surctl.cli.output import finish, same_command, saving, stoppable
from surctl.cli.system_option import OwnSystem, command_line, listed_values, load_system
from surctl.cli.system_simulate import cost_data

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["gain_ranges_of", "tune_own_system"]

_SO_FAR = "best-so-far.csv"


def tune_own_system(
    words: Sequence[str],
    ranges: Mapping[str, tuple[float, float] | None],
    *,
    seconds: float | None,
    trials: int,
    seed: int,
    workers: int,
    out: Path,
    goals: str | None,
    as_json: bool,
) -> None:
    """Search gains, write them, print each figure before and after; the exit status is 1 if a bound is violated."""
    from surctl.assessment import ClosedLoop, Comparison, assess
    from surctl.errors import InputError
    from surctl.files import prepare_folder
    from surctl.recorded_write import write_csv
    from surctl.tuning.representative import not_representative, step_goals
    from surctl.tuning.system_goals import load_system_goals
    from surctl.tuning.systems import check_tuning, tune_system

    own = load_system(words)
    about_loop, points, about_runs = ((), {}, ()) if goals is None else load_system_goals(goals, own.system)
    duration = own.seconds(seconds) if own.system.costs or seconds is not None else 0.0
    cases, space = _cases(own), gain_ranges_of(own, ranges)
    check_tuning(own.system, space, cases, goals=(*about_loop, *about_runs))
    prepare_folder(out)
    progress(f"up to {trials} gain sets")
    file = out / _SO_FAR

    def note(tried: int, best: Mapping[str, float]) -> None:
        doing(f"{tried} of {trials} gain sets")
        write_csv(file, {name: [value] for name, value in best.items()})

    try:
        message = f"the best gains so far are in {file}, without a check of their disk margin; to continue: "
        with stoppable(message + same_command()):
            note(0, {name: value for name, value in _nominal(own).items() if name in space})
            result = tune_system(
                own.system, duration, space,
                cases=cases, trials=trials, seed=seed, threads=workers, out=out, goals=about_loop, points=points,
                run_goals=about_runs, progress=note,
            )  # fmt: skip
    except InputError as error:
        raise (error.inside(goals) if (error.key or "").startswith(("goals.", "point ")) else error) from None
    table: Path | None = None
    with saving("gains"):
        table = write_csv(out / "gains.csv", {name: [value] for name, value in result.gains.items()})
        file.unlink(missing_ok=True)
    first = {name: value[:1] if value.ndim else value for name, value in cases.items()}
    run = duration or None
    comparison = Comparison(*(assess(ClosedLoop(own.system, {**first, **g}, seconds=run)) for g in ({}, result.gains)))
    headline, *figures = comparison.lines()
    doubtful = []
    limited = comparison.after.figures.get("limited_share")
    if limited is not None:
        linear, costs = [goal.name for goal in step_goals(about_loop)], own.system.costs
        late = next((name for name, cost in costs.items() if cost.how == "last_time"), next(iter(costs), None))
        remedy = f'ask it of the run, such as metric = "{late}"' if late else "give the system a cost of its runs"
        limit = f"command {limited.where}"
        doubtful = not_representative(linear, limited.value, limit=limit, run="the run", remedy=remedy)
    earlier = f" ({result.restored} of them before the interruption)" * bool(result.restored)
    runs = f", runs of {duration:g} s" if own.system.costs else ""
    lines = [
        headline,
        *doubtful,
        f"{own.title}: {result.trials} gain sets{earlier}{runs}",
        *(f"  {line}" for line in result.lines(own.system)),
        *([f"gains {table}"] if table else []),
        "",
        "of the first case:",
        *figures,
    ]
    data = {
        **own.names,
        "seconds": duration,
        "objective": result.objective,
        "best": {"gains": dict(result.gains), "costs": cost_data(own.system, result.costs)},
        "before": dict(result.before),
        "assessment": comparison.to_dict(),
        "least_disk_margin": result.least_disk_margin,
        "goals": [] if result.goals is None else [score.to_dict() for score in result.goals.scores],
        "run_goals": [asdict(goal) for goal in result.run_goals],
        "not_representative": doubtful,
        "unmet": list(result.unmet),
        "trials": result.trials,
        "restored": result.restored,
        "gains": None if table is None else str(table),
    }
    numbers = [f"{name}={value!r}" for name, value in result.gains.items()]
    then = [
        command_line("verify", own, *numbers),
        command_line("export", own, *numbers, "--seconds", f"{duration or 100 * own.system.dt:g}"),
    ]
    fine = all(map(math.isfinite, result.costs.values()))
    finish(data, lines, as_json=as_json, passed=fine and not result.unmet, then=then if fine else ())


def gain_ranges_of(own: OwnSystem, ranges: Mapping[str, tuple[float, float] | None]) -> dict[str, tuple[float, float]]:
    """Return the search ranges of the named gains, or of all gains; default: a quarter to 4 times the nominal value."""
    from surctl.errors import InputError, nearest
    from surctl.tuning.axes import default_range

    nominal, result = _nominal(own), {}
    for name, ends in (ranges or dict.fromkeys(nominal)).items():
        if name not in nominal:
            raise InputError("is not a gain of the system", key="--gain", value=name, remedy=nearest(name, nominal))
        if ends is None and nominal[name] == 0:
            raise InputError("is 0 and so has no default range", key=f"--gain {name}", remedy=f"write {name}=LOW..HIGH")
        result[name] = default_range(nominal[name]) if ends is None else ends
    return result


def _nominal(own: OwnSystem) -> dict[str, float]:
    from surctl.system import entry_labels

    gains = own.system.controller.gains
    return dict(zip(entry_labels(gains), gains.pack().tolist(), strict=True))


def _cases(own: OwnSystem) -> dict[str, NDArray[np.float64]]:
    """Return the values of each name in all cases from words NAME=V1,V2,…; a single value is for all cases."""
    import numpy as np

    from surctl.system.values import check_scalar

    values = listed_values(own.settings)
    for name in values:
        if len(values[name]) > 1:
            check_scalar(own.system, name)
    return {name: np.array(v[0] if len(v) == 1 else v) for name, v in values.items()}

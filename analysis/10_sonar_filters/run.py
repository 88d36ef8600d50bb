"""Study 10: which filter measures a clearance best, and does the bound of the robust one hold for every fault?

    python analysis/10_sonar_filters/run.py [--quick] [--out DIR]

Prints Markdown; with --out it saves pictures there. The exit status is 0 if every limit holds, and 1 otherwise.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from echoes import ARRAY, DT, EVERY, KINDS, Approach, Kind, approach, heard
from filters import FILTERS, Tracked, each, robust
from numpy.typing import NDArray
from pictures import FilterErrors, LmsTrace, RangeTrace, plot_filter_errors, plot_lms_trace, plot_range_trace
from streams import FAULTS, FIRST, Stream, faulty, honest, shows

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.errors import InputError
from surctl.files import Strict, load_model, prepare_folder
from surctl.marine.reproduction.range_test import table_ii
from surctl.marine.sensing.ranging.filters import StepRule
from tests.oracles.range_filters import plain_lms_step

Array = NDArray[np.float64]
CONFIG = Path(__file__).with_name("config.toml")
WARM = 5.0  # s before errors are counted
OFF = 0.1  # m, from which a faulty reading shows; the widest gate
WITHIN = round(0.3 / DT)  # steps
STILL = 0.02  # m/s
JUMP = 0.15  # m per step: an object entered or left the beam
DRAWN = 11  # seed of the faults in the pictures: they begin during the approach
RULES: tuple[StepRule, ...] = ("printed", "corrected")
DRAWN_FAULTS: tuple[str, ...] = ("dropout", "stuck", "second echo", "crosstalk", "delay")
QUICK_KINDS: tuple[Kind, ...] = ("obstacle",)
# without a known object in the beam, an object that enters or leaves it looks like a fault
UNKNOWN: tuple[Kind, ...] = ("obstacle, turning", "tank, turning")


class Bars(Strict):
    """Limits; lengths in m, shares of all steps."""

    rms_still: float
    rms_closing: float
    lag: float
    detected: float
    detected_turning: float
    kept: float
    bound_still: float
    bound_moving: float
    false_alarms: float
    kept_knowable: float


class Config(Strict):
    """The contents of config.toml."""

    seed: int
    runs: int
    quick_runs: int
    error_runs: int
    quick_error_runs: int
    bars: Bars


@dataclass(frozen=True)
class Errors:
    """Errors of a filter: rms at rest, while closing, on Table II [m]; lag [s]."""

    still: float
    closing: float
    table: float
    lag: float


def main(arguments: list[str]) -> int:
    """Run the study, print the results, and return the exit status."""
    parser = argparse.ArgumentParser(prog="run.py", description="Compare filters of the sonar, and try every fault.")
    parser.add_argument("--quick", action="store_true", help="few runs")
    parser.add_argument("--out", type=Path, help="folder of the pictures; default: none are drawn")
    options = parser.parse_args(arguments)
    try:
        config = load_model(CONFIG, Config)
        out = prepare_folder(options.out) if options.out else None
        return study(config, quick=options.quick, out=out)
    except InputError as error:
        print(error, file=sys.stderr)
        return error.exit_status


def study(config: Config, *, quick: bool, out: Path | None) -> int:
    """Print all tables; return 0 if every limit holds."""
    runs = config.quick_error_runs if quick else config.error_runs
    errors = {name: filter_errors(name, runs, config.seed) for name in FILTERS}
    good = print_errors(errors, config.bars)
    if not quick:
        print_fault_errors(runs, config.seed)
    traces = lms_traces(config.seed)
    good &= print_lms(traces)
    for kind in QUICK_KINDS if quick else KINDS:
        holds, clean = print_kind(kind, config.quick_runs if quick else config.runs, config)
        good &= holds
    if out is not None:
        draw(errors, traces, config, out, clean if quick else None)
    return 0 if good else 1


def steady(runs: int, seed: int, *, speed: float) -> Stream:
    """Return runs before an unknown static object at a constant speed [m/s]; at speed 0 from 0.5 to 4 m."""
    rng = np.random.default_rng(seed)
    time = DT * np.arange(round(16.0 / DT))
    start = rng.uniform(4.0, 4.3, runs) if speed else rng.uniform(0.5, 4.0, runs)
    truth = np.repeat((start[:, None] - speed * time)[..., None], ARRAY.size, axis=2)
    truth[..., 1] = 3.0 * ARRAY.maximum  # the other sensor gets no echo
    closing = np.zeros_like(truth)
    closing[..., 0] = speed + rng.normal(0, 0.01, truth.shape[:2])
    fired = truth[:, ::EVERY]
    samples = heard(fired, rng.standard_normal((*fired.shape, ARRAY.samples)))
    zero = np.zeros(truth.shape[:2])
    return honest(Approach(time, truth, closing, np.full(truth.shape, 2 * ARRAY.maximum), zero, zero + speed, samples))


def table_two(runs: int, seed: int) -> Stream:
    """Return runs at a static target with sample errors drawn with replacement from the water column of Table II."""
    rng = np.random.default_rng(seed)
    still = steady(runs, seed, speed=0.0)
    samples = still.run.samples.copy()
    drawn = rng.choice(table_ii().errors("water"), samples[:, :, 0].shape)
    samples[:, :, 0] = still.run.truth[:, ::EVERY, 0, None] + drawn
    return replace(still, run=replace(still.run, samples=samples))


def filter_errors(name: str, runs: int, seed: int) -> Errors:
    """Return the errors of a filter without a fault; lag is the increase of the mean error while closing, divided by
    the speed.
    """
    late = slice(round(WARM / DT), None)
    streams = {
        "still": steady(runs, seed, speed=0.0),
        "closing": steady(runs, seed + 1, speed=0.22),
        "table": table_two(runs, seed + 2),
    }
    offs = {}
    for (what, stream), found in zip(streams.items(), each(FILTERS[name], list(streams.values())), strict=True):
        offs[what] = (found.range - stream.run.seen[..., 0])[:, late]
    rms = {what: float(np.sqrt(np.mean(off**2))) for what, off in offs.items()}
    lag = (float(offs["closing"].mean()) - float(offs["still"].mean())) / 0.22
    return Errors(rms["still"], rms["closing"], rms["table"], lag)


def print_errors(errors: dict[str, Errors], bars: Bars) -> bool:
    """Print one row per filter; the limits apply to the robust one."""
    print("| filter | rms still [cm] | rms at 0.22 m/s [cm] | lag [s] | rms on Table II [cm] | within the bars |")
    print("|---|---|---|---|---|---|")
    for name, e in errors.items():
        cells = (f"{100 * e.still:.2f}", f"{100 * e.closing:.2f}", f"{e.lag:+.3f}", f"{100 * e.table:.2f}")
        print(f"| {name} | {' | '.join(cells)} | {'yes' if within(e, bars) else 'no'} |")
    limits = f"{100 * bars.rms_still:g} cm still, {100 * bars.rms_closing:g} cm closing, lag {bars.lag:g} s"
    return bar(f"robust filter: at most {limits}", within(errors["robust"], bars))


def within(e: Errors, bars: Bars) -> bool:
    """Return whether a filter meets the limits of accuracy."""
    return e.still <= bars.rms_still and e.closing <= bars.rms_closing and abs(e.lag) <= bars.lag


def print_fault_errors(runs: int, seed: int) -> None:
    """Print rms errors during a fault, in steps in which the filter calls the sensor healthy; there is no limit."""
    print("\nRms error [cm] from a fault's beginning to its end, before an unknown obstacle, over the steps in which")
    print("the filter calls the sensor healthy (their share in brackets).\n")
    print(f"| filter | {' | '.join(FAULTS)} |\n|{'---|' * (len(FAULTS) + 1)}")
    base = approach("obstacle", runs, seed=seed + 3)
    streams = [faulty(base, fault, seed=seed + 4) for fault in FAULTS]
    for name, filter_ in FILTERS.items():
        cells = []
        for stream, found in zip(streams, each(filter_, streams), strict=True):
            step = np.arange(base.truth.shape[1])
            during = (step >= EVERY * stream.begin[:, None]) & (step < EVERY * stream.end[:, None])
            counted = during & (found.healthy > 0.5)
            off = (found.range - base.seen[..., 0])[counted]
            rms = f"{100 * np.sqrt(np.mean(off**2)):.3g}" if off.size else "–"
            cells.append(f"{rms} ({100 * counted.sum() / during.sum():.0f} %)")
        print(f"| {name} | {' | '.join(cells)} |")


def lms_traces(seed: int) -> dict[str, LmsTrace]:
    """Prediction errors of both step rules: a constant range with wrong weights, and honest echoes of a still target.

    The whole step is taken, as Algorithm 1 prints it: relaxation 1, no momentum.
    """
    rng = np.random.default_rng(seed)
    constant = np.full(60, 1.0)
    echoes = heard(np.full(300, 1.5), rng.standard_normal((300, ARRAY.samples))).mean(axis=-1)
    found = {}
    for key, values, title in (
        ("constant", constant, "A constant range of 1 m, weights wrong at first"),
        ("echoes", echoes, "Echoes of a thing that stands still at 1.5 m"),
    ):
        found[key] = LmsTrace(title=title, errors={rule: prediction_errors(values, rule) for rule in RULES})
    return found


def prediction_errors(values: Array, rule: StepRule) -> Array:
    """Return |ℜ| at each value after the first four."""
    theta = np.array([1.0, 0.5, -0.2, 0.4])
    errors, mean_error, out = np.zeros(1), np.zeros(()), []
    for k in range(4, len(values)):
        step = plain_lms_step(
            theta,
            theta,
            X=values[k - 4 : k][::-1],
            x_n=values[k],
            errors=errors,
            mean_error=mean_error,
            relaxation=0.5,
            beta_max=0.0,
            step=rule,
        )
        theta = step.theta
        out.append(abs(float(step.residual)))
    return np.array(out)


def print_lms(traces: dict[str, LmsTrace]) -> bool:
    """Print first and last errors of both rules; the printed one must oscillate, the corrected one converge (E5)."""
    print("\n| signal | step | first error [m] | rms of the last 20 [m] |\n|---|---|---|---|")
    last = {}
    for key, trace in traces.items():
        for rule, values in trace.errors.items():
            last[key, rule] = float(np.sqrt(np.mean(values[-20:] ** 2)))
            print(f"| {trace.title} | {rule} | {values[0]:.3g} | {last[key, rule]:.3g} |")
    first = traces["constant"].errors["printed"][0]
    rings = abs(last["constant", "printed"] / first - 1.0) < 1e-6
    good = bar("printed step, constant range: the error rings for ever at its first size", rings)
    good &= bar("corrected step, constant range: the error goes below 1e-9 m", last["constant", "corrected"] < 1e-9)
    worse = last["echoes", "printed"] > 3.0 * last["echoes", "corrected"]
    return good & bar("printed step, echoes: the error stays more than 3 times the corrected one's", worse)


def print_kind(kind: Kind, runs: int, config: Config) -> tuple[bool, tuple[Stream, Tracked]]:
    """Print every fault on one kind of approach; return whether its limits hold, and the runs without a fault."""
    bars = config.bars
    base = approach(kind, runs, seed=config.seed + 10)
    print(f"\n### {kind}: {runs} runs of {base.time[-1] + DT:.0f} s a fault\n")
    print("| fault | shows in | found in 0.3 s | kept | too near | kept, knowable | worst miss [m] | not healthy |")
    print("|---|---|---|---|---|---|---|---|")
    told, short = list[str](), False
    wanted = bars.detected_turning if "turning" in kind else bars.detected
    streams = [honest(base)] + [faulty(base, fault, seed=config.seed + 100 + k) for k, fault in enumerate(FAULTS)]
    for fault, stream, found in zip(("none", *FAULTS), streams, each(robust, streams), strict=True):
        share = judged(stream, found)
        showing, seen = detected(kind, stream, found, base.samples)
        cells = [
            fault,
            "" if fault == "none" else f"{showing}",
            f"{100 * seen / showing:.1f} %" if showing else "",
            *(f"{100 * share[name]:.3f} %" for name in ("kept", "near", "knowable")),
            f"{share['worst']:.2f}",
            f"{100 * share['ill']:.2f} %",
        ]
        print("| " + " | ".join(cells) + " |")
        if kind in UNKNOWN:
            short |= share["kept"] < bars.kept
            told += [fault] if share["knowable"] < bars.kept_knowable else []
        elif share["kept"] < bars.kept:
            told.append(fault)
        if kind not in UNKNOWN and seen < wanted * showing:
            told.append(f"{fault} (found late)")
        if fault == "none":
            clean = stream, found
    if kind in UNKNOWN:
        text = (
            f"{kind}: bound kept in {100 * bars.kept_knowable:g} % of the steps in which a reading has the information"
        )
        if short:
            print(f"\n{kind}: kept in less than {100 * bars.kept:g} % of all steps (see the README)")
    else:
        text = f"{kind}: found in 0.3 s in {100 * wanted:g} %, bound kept in {100 * bars.kept:g} % of the steps"
    holds = bar(text + (f", not with {', '.join(told)}" if told else ""), not told)
    return usefulness(kind, base, clean[1], bars) & holds, clean


def judged(stream: Stream, found: Tracked) -> dict[str, float]:
    """Shares of the steps: bound kept, true range below it (too near), kept where it could be known, not healthy.

    Not to be known is what happens in the beam between two firings (JUMP), and all that enters it or leaves it while
    a fault lasts.
    """
    truth = stream.run.seen[..., 0]
    low, high = found.range - found.bound - 1e-9, found.range + found.bound + 1e-9
    missed = (truth < low) | (truth > high)
    hidden = unknowable(stream)
    return {
        "kept": 1.0 - float(missed.mean()),
        "near": float((truth < low).mean()),
        "knowable": 1.0 - float((missed & ~hidden).sum()) / float((~hidden).sum()),
        "worst": float(np.where(missed, np.abs(found.range - truth) - found.bound, 0.0).max()),
        "ill": float((found.healthy[:, EVERY * FIRST :] < 0.5).mean()),
    }


def unknowable(stream: Stream) -> NDArray[np.bool_]:
    """Return the steps (runs, steps) whose events no reading can show in time."""
    truth = stream.run.seen[..., 0]
    jumps = np.abs(np.diff(truth, axis=1, prepend=truth[:, :1])) > JUMP
    steps = np.arange(truth.shape[1])
    arrived = (steps % EVERY == 0) & (np.repeat(stream.fresh[:, :, 0], EVERY, axis=1) > 0.5)
    count = np.cumsum(jumps, axis=1)
    at_arrival = np.maximum.accumulate(np.where(arrived, count, 0), axis=1)
    since_arrival = count > at_arrival
    begun = steps >= EVERY * stream.begin[:, None]
    before = np.take_along_axis(count, np.minimum(EVERY * stream.begin, truth.shape[1] - 1)[:, None] - 1, axis=1)
    return since_arrival | (begun & (count > before))


def detected(kind: Kind, stream: Stream, found: Tracked, samples: Array) -> tuple[int, int]:
    """Runs in which the fault shows, and of these the ones in which it is found within 0.3 s.

    Found is: not healthy, or a faulty firing not accepted. What lies within the bound that is promised does not show;
    where things unknown pass through the beam, nor does what begins to show with them.
    """
    first = shows(stream, samples, off=np.maximum(OFF, found.bound[:, ::EVERY]))
    firings, last = stream.fresh.shape[1], found.range.shape[1] - 1
    row = np.arange(len(first))
    showing = first < firings
    if kind in UNKNOWN:
        showing &= ~unknowable(stream)[row, np.minimum(EVERY * first, last)]
    seen = np.zeros(len(first), dtype=bool)
    for after in range(WITHIN + 1):
        step = np.minimum(EVERY * first + after, last)
        arrived = (step % EVERY == 0) & (stream.fresh[row, np.minimum(step // EVERY, firings - 1), 0] > 0.5)
        seen |= (found.healthy[row, step] < 0.5) | (arrived & (found.accepted[row, step] < 0.5))
    return int(showing.sum()), int((seen & showing).sum())


def usefulness(kind: Kind, base: Approach, found: Tracked, bars: Bars) -> bool:
    """Print the mean bound while healthy and the false alarms without a fault; limits apply if the beam does not
    turn.
    """
    counted = np.arange(base.truth.shape[1]) >= EVERY * FIRST
    healthy = (found.healthy > 0.5) & counted
    still = np.abs(base.speed) < STILL
    off = np.abs(found.range - base.seen[..., 0])
    at_rest, moving = (float(found.bound[healthy & mask].mean()) for mask in (still, ~still))
    alarms = 1.0 - float(healthy[:, counted].mean())
    rms = float(np.sqrt(np.mean(off[healthy] ** 2)))
    figures = f"{100 * at_rest:.1f} cm still and {100 * moving:.1f} cm moving, false alarms {100 * alarms:.2f} %"
    holds = at_rest <= bars.bound_still and moving <= bars.bound_moving and alarms < bars.false_alarms
    text = f"{kind}: no fault: mean bound {figures}, rms {100 * rms:.2f} cm"
    if "turning" in kind:
        print(f"\n{text} (no bar while the beam turns)")
        return True
    return bar(text, holds)


def draw(
    errors: dict[str, Errors],
    traces: dict[str, LmsTrace],
    config: Config,
    out: Path,
    clean: tuple[Stream, Tracked] | None,
) -> None:
    """Save pictures: errors of the filters, both LMS steps, one run with each of some faults, or that of `clean`."""
    names = tuple(errors)
    data = FilterErrors(
        names=names,
        still=tuple(errors[n].still for n in names),
        closing=tuple(errors[n].closing for n in names),
        still_limit=config.bars.rms_still,
        closing_limit=config.bars.rms_closing,
    )
    save(plot_filter_errors(data), out / "errors.png")
    for key, trace in traces.items():
        save(plot_lms_trace(trace), out / f"lms_{key}.png")
    if clean:
        save(plot_range_trace(trace_of("An unknown obstacle, fault: none", *clean)), out / "none.png")
        return
    base = approach("obstacle", 1, seed=config.seed + 20, speed=0.2, stop=0.5)
    drawn = {"none": ("An unknown obstacle, fault: none", honest(base))}
    for fault in DRAWN_FAULTS:
        drawn[fault] = (f"An unknown obstacle, fault: {fault}", faulty(base, fault, seed=DRAWN))
    tank = honest(approach("tank, turning", 1, seed=config.seed + 21))
    drawn["tank"] = ("A tank with a box, the beam turns", tank)
    streams = [stream for _, stream in drawn.values()]
    for (name, (title, stream)), found in zip(drawn.items(), each(robust, streams), strict=True):
        save(plot_range_trace(trace_of(title, stream, found)), out / f"{name}.png")


def trace_of(title: str, stream: Stream, found: Tracked) -> RangeTrace:
    """Return the data of the first run for the picture."""
    arrived = np.flatnonzero(stream.fresh[0, :, 0] > 0.5)
    return RangeTrace(
        title=title,
        time=stream.run.time,
        range=found.range[0],
        bound=found.bound[0],
        healthy=found.healthy[0],
        reading_time=stream.run.time[EVERY * arrived],
        reading=found.reading[0, EVERY * arrived],
        truth=stream.run.seen[0, :, 0],
    )


def save(ax: object, path: Path) -> None:
    """Save a picture."""
    name = path.with_name(path.name.replace(" ", "_"))
    ax.figure.figure.savefig(name)  # type: ignore[attr-defined]


def bar(text: str, holds: bool) -> bool:
    """Print a limit; return whether it holds."""
    print(f"\n- {text}: {'holds' if holds else '**does not hold**'}")
    return holds


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

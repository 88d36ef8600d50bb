"""Study 34: can gains in memory or a broken flow of time make the exported C harmful?

    python analysis/34_firmware/run.py            # 100,000 gain sets, 100,000 events of time, every mutant
    python analysis/34_firmware/run.py --quick    # a hundredth of them, some of the mutants

Prints Markdown; --write writes the README from it. Status 1 if a thrust exceeds the vehicle's limits, an age is smaller
than the true one, or a mutant is not detected.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from clock import DT, LONGEST, REFUSED, clock_bundle, run_clock
from numpy.typing import NDArray

from surctl.errors import SurctlError
from surctl.export import Bundle, Envelope, Records, build_controller
from surctl.export.supplement import RESTART, longest_gap
from surctl.marine.control import build_law, load_gains
from surctl.marine.export import build_bundle, operating_envelope
from surctl.marine.simulation import law_numbers, load_scenario
from surctl.marine.vehicle import load_vehicle

Vector = NDArray[np.float64]
ABOUT = Path(__file__).with_name("about.md")
MISSION = "pool-ahead"
LATE = 8  # periods by which one late number may make an age too large


def flown() -> tuple[Bundle, Envelope, Vector]:
    """Return the bundle of the law `closed_form` with gains as inputs, its envelope, and the tuned gains."""
    mission, law = load_scenario(MISSION), build_law("closed_form")
    vehicle = load_vehicle(mission.vehicle)
    p = law_numbers(mission, load_gains("default"), vehicle)
    within = operating_envelope(law, mission, vehicle, law.gains, tuned=p)
    return build_bundle(law, law.gains.unpack(p), envelope=within), within, p


def hostile(p: Vector, within: Envelope, count: int, rng: np.random.Generator) -> Vector:
    """Return gain sets (count, np): patterns in memory, flipped bits, one wrong gain, corners of the ranges."""
    P = np.tile(p, (count, 1))
    kind = np.arange(count) % 5
    raw = P.view(np.uint64).reshape(P.shape)
    byte = rng.integers(0, 256, count).astype(np.uint64) * np.uint64(0x0101010101010101)
    raw[kind == 0] = byte[kind == 0, None]
    raw[kind == 1] = rng.integers(0, 2**64, raw[kind == 1].shape, dtype=np.uint64)
    one = np.flatnonzero((kind == 2) | (kind == 3))
    at = (one // 5) % p.size
    flips = np.uint64(1) << rng.integers(0, 64, len(one)).astype(np.uint64)
    raw[one, at] ^= np.where(kind[one] == 2, flips, np.uint64(0))
    size = 10.0 ** rng.uniform(-12, 300, len(one)) * rng.choice([-1.0, 1.0], len(one))
    edge = within.gains[at, rng.integers(0, 2, len(one))]
    just = np.nextafter(edge, np.where(edge == within.gains[at, 0], -np.inf, np.inf))
    wrong = np.where(rng.random(len(one)) < 0.5, size, just)
    P[one, at] = np.where(kind[one] == 3, wrong, P[one, at])
    low, high = within.gains.T
    share = rng.choice([0.0, 1.0, 0.5], P[kind == 4].shape)
    P[kind == 4] = np.clip(low + share * (high - low), low, high)
    obeying = np.flatnonzero(kind == 4)[::2]  # half of the corners also obey the orders between gains
    for pair in within.orders:
        P[np.ix_(obeying, pair)] = np.sort(P[np.ix_(obeying, pair)], axis=1)
    return P


def gain_failures(
    bundle: Bundle, within: Envelope, P: Vector, folder: Path, rng: np.random.Generator
) -> dict[str, int]:
    """Return how many steps thrust beyond the limits, and how many have another status than the ranges demand."""
    law = build_law("closed_form")
    boxes = [np.clip(box, -1e3, 1e3) for box in (within.state, within.inputs)]
    X, U = (box[:, 0] + rng.random((len(P), len(box))) * (box[:, 1] - box[:, 0]) for box in boxes)
    records = Records(X, U, P)
    assert bundle.envelope is not None
    rows = build_controller(law, bundle, folder).run(records, load=np.ones(len(P), dtype=bool))
    asked = bundle.envelope.refusals(records)
    assert within.commands is not None
    low, high = within.commands.T
    beyond = ~((rows.tau >= low) & (rows.tau <= high)).all(axis=1)
    thrusting = (rows.status < 0) & (rows.tau != 0.0).any(axis=1)
    other = (asked < 0) & (rows.status != asked)
    return {
        "refused": int((rows.status < 0).sum()),
        "limited": int(((rows.status >= 0) & (np.isclose(np.abs(rows.tau), high)).any(axis=1)).sum()),
        "beyond": int(beyond.sum() + thrusting.sum()),
        "status": int(other.sum()),
    }


def events(count: int, rng: np.random.Generator) -> tuple[Vector, Vector, Vector, Vector]:
    """Return rows (T, 2) of sample number and message, true ages (T,) [s], the true gap (T,).

    The last array is the excess [s] that an age may have, without bound where the counter lied.
    The true age is that of the last message in an accepted step, at most `LONGEST`; NaN where the step must be refused.
    """
    rows: list[tuple[float, float]] = []
    truth: list[float] = []
    gaps: list[float] = []
    allowed: list[float] = []
    excess = 0.0  # [s] by which the next age may be too large: without bound where the counter lied
    last: int | None = None
    now, offset, message, accepted, older, rising = 1, 0, -(10**9), 0, 0, 0

    def call(value: float) -> None:
        nonlocal message, accepted, last, older, rising, excess
        allowed.append(excess)
        number = (now + offset) % 2**32
        rise, older = (number - older) % 2**32, number
        rows.append((float(number), value))
        since = now - accepted
        if last is not None and (number - last) % 2**32 >= 2**31 and rise:
            rising = rising + 1 if rise < 2**31 else 0
        if value == REFUSED or (last is not None and not 0 < (number - last) % 2**32 < 2**31):
            fine = False
            if value != REFUSED:
                fine = rising >= RESTART and number != last
        else:
            fine = True
        if not fine:
            truth.append(np.nan)
            gaps.append(np.nan)
            return
        message = now if value > 0.5 else message
        truth.append(min((now - message) * DT, LONGEST))
        gaps.append(float(since))
        accepted, last, older, rising, excess = now, number, number, 0, 0.0

    for _ in range(count):
        kind, length = rng.integers(0, 8), int(np.ceil(10 ** rng.uniform(0, 3)))
        if kind <= 1:  # steps as they should be
            for _ in range(min(length, 20)):
                call(float(rng.random() < 0.2))
                now += 1
        elif kind == 2:  # an input is no number
            for _ in range(min(length, 300)):
                call(REFUSED)
                now += 1
        elif kind == 3:  # no step for a while; the board goes on counting
            now += length
            call(0.0)
            now += 1
        elif kind == 4:  # the board stands still; the steps go on with the old number
            for _ in range(min(length, 300)):
                offset -= 1
                call(0.0)
                now += 1
        elif kind == 5:  # the board starts again, at 0 or later; the steps go on
            offset, excess = int(rng.integers(0, 50)) - now, np.inf
            for _ in range(RESTART + 5):
                call(0.0)
                now += 1
        elif kind == 7:  # one number comes late, between two that rise
            offset, excess = offset - 3, max(excess, LATE * DT)
            call(0.0)
            offset, now = offset + 3, now + 1
            call(0.0)
            now += 1
        else:  # the numbers pass 2^32
            if rng.random() < 0.2:
                offset, excess = int(2**32 - rng.integers(0, 30)) - now, np.inf
            for _ in range(RESTART + 5):
                call(0.0)
                now += 1
    return np.array(rows), np.array(truth), np.array(gaps), np.array(allowed)


def _until_message(rows: Vector, began: NDArray[np.bool_]) -> NDArray[np.bool_]:
    # (T,): no message came since the last step at which the age was set too large on purpose
    out, on = np.zeros(len(rows), dtype=bool), False
    for k in range(len(rows)):
        on = began[k] or (on and not rows[k, 1] > 0.5)
        out[k] = on
    return out


def time_failures(bundle: Bundle, tried: tuple[Vector, Vector, Vector, Vector], folder: Path) -> dict[str, int]:
    """Return how many ages are smaller than the true age, refusals differ, and memories outlive a long gap."""
    rows, truth, gaps, allowed = tried
    out = run_clock(bundle, folder, rows)
    accepted = out[:, 0] >= 0
    must = ~np.isnan(truth)
    both = accepted & must
    restarted = both & (out[:, 0].astype(int) >= 16384)
    small = both & (out[:, 1] < truth - 1e-6)
    inexact = both & (restarted | (allowed > 0.0))
    since = _until_message(rows, inexact)
    first = inexact & ~np.append(False, since[:-1]) & ~restarted  # an age before it was exact
    above = out[:, 1] > truth + np.where(first, allowed, 0.0) + 1e-6
    large = both & above & (first | ~since)
    return {
        "accepted": int(accepted.sum()),
        "restarts": int(restarted.sum()),
        "small": int(small.sum()),
        "large": int(large.sum()),
        "refusals": int((accepted != must).sum()),
        "memories": int((both & (gaps > longest_gap(DT)) & (out[:, 2] > 1.5)).sum()),
    }


GAIN_MUTANTS = (
    (r"    if \(!\(.*gains->.*return .*;.*\n", ""),
    (r"    limited \|= limit\(.*\n|    limited \|= \w+_limit\(.*\n", ""),
    (r"&& \w+_gains_check\(gains\) == 0|return \w+_gains_check\(gains\) == 0;", "return 1;"),
    (r"\(asked > most\) \? most :", "(asked > most) ? asked :"),
    (r"\(asked < least\) \? least :", "(asked < least) ? asked :"),
)
TIME_MUTANTS = (
    (r"    \w+_count\(state, input->sample\);\n", ""),
    (r"\? rise : 1U", "? 1U : 1U"),
    (r"\? rise : 1U", "? rise : 0U"),
    (r"\(rise <= 0x7fffffffU\) && \(rise > 1U\)", "(rise > 1U)"),
    (r"\(sample - state->sample\) > 0x7fffffffU", "(sample - state->sample) > 0xffffffffU"),
    (r"if \(rise != 0U\) \{", "if (rise == 0U) {"),
    (r"\? state->rising \+ 1U : 0U", "? state->rising + 1U : state->rising + 1U"),
    (r"state->since \+ more : 0x7fffffffU", "state->since + 1U : 0x7fffffffU"),
    (r"    state->seen = sample;\n", ""),
    (r"uint32_t since = state->since;", "uint32_t since = gap;"),
    (r"\(state->rising >= \d+U\)\) \? 0x7fffffffU : 0U", "(state->rising >= 10U)) ? 0U : 0U"),
    (r"\(state->rising >= \d+U\)\) \? 0x7fffffffU : 0U", "(state->rising >= 10U)) ? 1U : 0U"),
    (r"\(state->rising >= \d+U\)\) \? 0x7fffffffU : 0U", "(state->rising >= 9U)) ? 0x7fffffffU : 0U"),
    (r"\(gap == 0U\) \|\| \(gap > 0x7fffffffU\)", "(gap == 0U)"),
    (r"\(gap == 0U\) \|\| \(gap > 0x7fffffffU\)", "(gap > 0x7fffffffU)"),
    (r"const double age = state->x\[k\] \+ more;", "const double age = state->x[k];"),
    (r"since - 1U - state->aged : 0U", "since - 2U - state->aged : 0U"),
    (r"\(double\)missed \* \w+_DT", "(double)missed * 0.5 * CLOCK_LAW_DT"),
    (r"&& \(since > \d+U\)", "&& (since > 4U)"),
    (r"    \w+_elapse\(state, gap\);\n", ""),
    (r"    state->sample = input->sample;\n", ""),
    (r"    state->counted = 1U;\n", ""),
    (r"    state->since = 0U;\n(?=    state->rising = 0U;\n    state->aged)", ""),
    (r"    state->aged = 0U;\n(?=    \w+_store_output|    return code)", ""),
)


def mutants(bundle: Bundle, rules: tuple[tuple[str, str], ...]) -> Iterator[tuple[str, Bundle]]:
    """Yield each place at which a rule changes the controller's main file."""
    file = f"{bundle.name}.c"
    text = bundle.files[file]
    for pattern, new in rules:
        for match in re.finditer(pattern, text):
            changed = text[: match.start()] + new + text[match.end() :]
            label = f"`{' '.join(match.group(0).split())[:60]}` → `{' '.join(new.split())[:40] or 'removed'}`"
            yield label, replace(bundle, files=MappingProxyType({**bundle.files, file: changed}))


def main() -> int:
    """Run the study."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--quick", action="store_true", help="a hundredth of the cases, every 36th mutant")
    options.add_argument("--write", action="store_true", help="write the README")
    chosen = options.parse_args()
    count = 1_000 if chosen.quick else 100_000
    tried, every = (1_000, 36) if chosen.quick else (3_000, 1)
    lines, bad = [], 0
    bundle, within, p = flown()
    loose = replace(within, gains=np.tile([-1e308, 1e308], (p.size, 1)), orders=())
    unchecked = build_bundle(build_law("closed_form"), build_law("closed_form").gains.unpack(p), envelope=loose)
    P = hostile(p, within, count, np.random.default_rng(0))
    head = (
        "guard",
        "gain sets",
        "refused",
        "at the limit of an axis",
        "beyond a limit",
        "other status than the ranges demand",
    )
    lines += [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    with tempfile.TemporaryDirectory() as scratch:
        for word, one in (("as exported", bundle), ("without ranges of gains", unchecked)):
            found = gain_failures(one, within, P, Path(scratch, word.split()[0]), np.random.default_rng(1))
            lines.append(f"| {word} | {count} | {' | '.join(str(v) for v in found.values())} |")
            bad += found["beyond"] + found["status"]
        clock = clock_bundle()
        flow = events(count, np.random.default_rng(2))
        found = time_failures(clock, flow, Path(scratch, "clock"))
        bad += sum(found[name] for name in ("small", "large", "refusals", "memories"))
        columns: tuple[str, ...] = (
            "events",
            "steps",
            "accepted",
            "counters that start again",
            "ages too small",
            "too large",
        )
        columns += ("other refusals", "memories after a long gap")
        lines += ["", f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
        lines.append(f"| {count} | {len(flow[0])} | {' | '.join(str(v) for v in found.values())} |")
        caught, missed = 0, []
        short = events(tried, np.random.default_rng(3))
        few = hostile(p, within, tried, np.random.default_rng(4))
        sides = [("gains", m) for m in mutants(bundle, GAIN_MUTANTS)] + [
            ("time", m) for m in mutants(clock, TIME_MUTANTS)
        ]
        for k, (side, (label, mutant)) in enumerate(sides[::every]):
            folder = Path(scratch, f"m{k}")
            folder.mkdir()
            try:
                if side == "time":
                    result = time_failures(mutant, short, folder)
                    wrong = sum(result[name] for name in ("small", "large", "refusals", "memories"))
                else:
                    open_too = replace(mutant, envelope=within)
                    result = gain_failures(open_too, within, few, folder, np.random.default_rng(5))
                    wrong = result["beyond"] + result["status"]
                    if not wrong:
                        at = next(m for label_, m in mutants(unchecked, GAIN_MUTANTS) if label_ == label)
                        wrong = gain_failures(at, within, few, folder / "u", np.random.default_rng(5))["beyond"]
            except (SurctlError, StopIteration, OSError):
                wrong = 1  # it does not compile, or it crashes
            caught += wrong > 0
            missed += [] if wrong else [f"{side}: {label}"]
        lines += [
            "",
            f"Mutants of guard and ages: {caught} of {len(sides[::every])} detected.",
            *(f"- missed: {m}" for m in missed),
        ]
        bad += len(missed)
    text = "\n".join(lines) + "\n"
    print(text)
    if chosen.write:
        Path(__file__).with_name("README.md").write_text(ABOUT.read_text() + "\n" + text)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())

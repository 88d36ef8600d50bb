"""Cycles of a Cortex-M4F for the law with sonars: instructions measured in an emulator, cycles bounded by ARM's table.

    python analysis/18_export_benchmark/cycles.py [--quick]

QEMU counts each executed instruction, by part of the program. Each costs at most what the Technical Reference Manual of
the Cortex-M4 (ARM DDI 0439) states, and the program memory adds at most the wait states of an STM32F4 without cache.
--quick only counts a program of known length.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from whole import made

from surctl.export import TARGETS, Bundle, Controller, Exportable, Target, write_bundle
from surctl.export.envelope import as_records
from surctl.export.process import compile_controller
from surctl.ir.cache import compile_program
from surctl.marine.control import build_law
from surctl.marine.export import build_bundle

CLOCK, SHARE = 168e6, 0.40  # Hz; share of a period that perception may take
WAIT = 5  # wait states of an STM32F4's flash at 168 MHz (ST RM0090), which delivers 16 bytes at once
REFILL = 3  # cycles that refill the pipeline after a branch, at most (DDI 0439, table 3-1: 1 to 3)
SCENARIOS, LEVELS = ("tank-static", "pool-static"), ("-Os", "-O2")
PARTS = ("perception", "law", "guard", "else")
LIBRARY = 255

_CONDITION = r"(?:eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)?"
_COSTS: tuple[tuple[str, str, int], ...] = (
    # class, mnemonics, cycles; + 1 where the next instruction may wait for the result
    ("division, root", "vdiv|vsqrt", 14 + 1),
    ("multiply and add", "vn?ml[as]", 3 + 1),
    ("other arithmetic of floats", "vn?mul|vadd|vsub|vabs|vneg|vcvt|vcmpe?", 1 + 1),
    ("moves of floats", "vmov|vmrs", 1 + 1),
    ("load or store of one number", "ldr[bh]?|ldrs[bh]|str[bh]?|vldr|vstr", 2),
    ("integer division", "[su]div", 12),
    ("integers", "movs?|mov[wt]|mvns?|adds?|addw|adcs?|subs?|subw|sbcs?|rsbs?|cmp|cmn|tst|teq|ands?|orrs?", 1),
    ("integers", "orns?|eors?|bics?|ls[lr]s?|asrs?|rors?|muls?", 1),
    ("integers", "[su]xt[bh]|[us]bfx|bf[ic]|clz|rev|rbit|it[te]*|nop|uadd8|sel|pld", 1),
    ("integers", "ml[as]|[su]mull|[su]mlal", 2),
)  # fmt: skip


def cost_of(mnemonic: str, operands: str) -> tuple[str, int]:
    """Return class and most cycles of an instruction as objdump writes it; "unknown" if it is not in the table."""
    word = mnemonic.split(".")[0]
    listed = re.search(r"\{(.*)\}", operands)
    if listed:  # 1 + N registers; loading the program counter is a branch as well
        count = 0
        for item in listed.group(1).replace(" ", "").split(","):
            ends = [int(n) for n in re.findall(r"\d+", item)]
            count += 1 + ends[1] - ends[0] if len(ends) == 2 else 1
        double = 2 if re.search(r"\bd\d", listed.group(1)) else 1
        return "loads or stores of several", 1 + count * double + (REFILL if "pc" in listed.group(1) else 0)
    if re.fullmatch(f"(?:ldrd|strd){_CONDITION}", word) or (word[:4] in ("vldr", "vstr") and operands[0] == "d"):
        return "loads or stores of several", 3
    if re.fullmatch(f"(?:bl?x?{_CONDITION}|cbn?z)", word) or re.match(r"pc\b", operands):
        return "branches", (2 if word.startswith("ldr") else 1) + REFILL
    if re.fullmatch("tb[bh]", word):
        return "branches", 2 + REFILL
    for name, pattern, cycles in _COSTS:
        if re.fullmatch(f"(?:{pattern}){_CONDITION}", word):
            two = cycles + 1 if word.startswith("vmov") and re.match(r"[rs]\w+, [rs]\w+, r", operands) else cycles
            return name, two
    return "unknown", 0


@dataclass(frozen=True)
class Counted:
    """What the emulator counted.

    Attributes:
        steps: for each step and part (T, 4, 5): instructions, most cycles, lines of program memory, jumps, constants
            read from that memory.
        mix: instructions of each class that were executed, in all steps and parts.
        output: what the program wrote.
    """

    steps: NDArray[np.int64]
    mix: Mapping[str, int]
    output: bytes

    def cycles(self, wait: int) -> NDArray[np.int64]:
        """Return the most cycles (T, 4) with `wait` wait states and no cache.

        A jump may wait for a line that was asked for in vain; a constant may displace the line of the program.
        """
        _, core, lines, jumps, constants = np.moveaxis(self.steps, 2, 0)
        bound: NDArray[np.int64] = core + wait * (lines + jumps + 2 * constants)
        return bound


def counted(program: Path, step: str, parts: Mapping[str, int], target: Target, stream: bytes) -> Counted:
    """Run a program on the emulated processor, and count from the function `step` to the function `stepped`.

    Args:
        program: the linked program.
        step: name of the function that does one step.
        parts: part of each function by name; the others are the library, except `main`.
        target: emulated processor.
        stream: standard input of the program.
    """
    folder = program.parent
    functions = _symbols(program)
    symbols = _run("arm-none-eabi-nm", str(program))
    data = next(line.split()[0] for line in symbols.splitlines() if line.endswith(" target_data"))
    rom = 2 * -(-max(at + size for at, size in functions.values()) // 2)
    table = np.zeros((rom // 2, 3), dtype=np.uint8)
    for name, (at, size) in functions.items():
        table[at // 2 : (at + size) // 2, 1] = parts.get(name, PARTS.index("else") if name == "main" else LIBRARY)
    listing = _run("arm-none-eabi-objdump", "-d", "--no-show-raw-insn", str(program))
    order: list[tuple[int, str]] = []
    for line in listing.splitlines():
        found = re.match(r"\s*([0-9a-f]+):\t(\S+)\s*(.*)", line)
        if found and int(found.group(1), 16) < rom:
            at = int(found.group(1), 16)
            name, cycles = cost_of(found.group(2), found.group(3))
            table[at // 2, 0] = cycles
            table[at // 2, 2] = REFILL if name == "branches" else 0
            order.append((at, f"unknown: {found.group(2)} {found.group(3)}" if name == "unknown" else name))
    (folder / "table").write_bytes(table.tobytes())
    library = compile_program(
        [Path(__file__).with_name("count_cycles.c")], folder / "count.so", flags=("-shared", "-fPIC", "-Wno-pedantic")
    )
    files = [f"{name}={folder / name}" for name in ("table", "steps", "blocks")]
    options = [f"from={functions[step][0]}", f"to={functions['stepped'][0]}", f"rom={rom}", f"data=0x{data}", *files]
    board = [*target.board(str(program)), "-plugin", ",".join([str(library), *options])]
    done = subprocess.run(board, input=stream, stdout=subprocess.PIPE, check=True)
    places = {at: k for k, (at, _) in enumerate(order)}
    mix: Counter[str] = Counter()
    for first, count, executions in np.loadtxt(folder / "blocks", dtype=np.int64, ndmin=2):
        for _, name in order[places[first] : places[first] + count] if executions else ():
            mix[name] += int(executions)
    unknown = [name for name in mix if name.startswith("unknown")]
    if unknown:
        raise SystemExit(f"no cycles are known for {', '.join(unknown)}")
    steps = np.loadtxt(folder / "steps", dtype=np.int64, ndmin=2).reshape(-1, len(PARTS), 5)
    assert steps[:, :, 0].sum() == sum(mix.values())
    return Counted(steps, mix, done.stdout)


def _symbols(program: Path) -> dict[str, tuple[int, int]]:
    """Address and size of each function; of functions without a size, up to the next one."""
    rows = []
    for line in _run("arm-none-eabi-readelf", "-sW", str(program)).splitlines():
        words = line.split()
        if len(words) == 8 and words[3] == "FUNC" and words[6] != "UND":
            rows.append((int(words[1], 16) & ~1, int(words[2], 0), words[7]))
    ends = [*sorted({at for at, _, _ in rows}), max(at + size for at, size, _ in rows)]
    return {name: (at, size or next(e for e in ends if e > at) - at) for at, size, name in rows}


def _run(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


KNOWN = r"""
extern void probe(int count, const float *from);
extern void stepped(void);
__asm__(".syntax unified\n.thumb\n.text\n.type probe, %function\nprobe:\nmov r2, r0\n"
    "1: vldr s0, [r1]\nvdiv.f32 s1, s0, s0\nvmul.f32 s2, s1, s1\nstr r0, [sp, #-4]\nsubs r2, #1\nbne 1b\nbx lr\n"
    ".size probe, . - probe\n");
int main(void)
{
    static const float one = 1.0f;
    static float two = 2.0f;
    for (int k = 1; k <= 3; ++k) { probe(1000 * k, (k == 2) ? &one : &two); stepped(); }
    return 0;
}
"""


def known(target: Target, bundle: Bundle, folder: Path) -> bool:
    """Count a loop of 1000, 2000 and 3000 turns of six instructions; return whether all numbers are exact."""
    write_bundle(bundle, folder)
    (folder / "known.c").write_text(KNOWN)
    program = compile_program(
        [folder / "target_start.c", folder / "known.c"],
        folder / "known",
        flags=target.bare(folder),
        compiler=target.compiler,
    )
    got = counted(program, "probe", {"probe": 0}, target, b"").steps[:, 0]
    turns = np.array([1000, 2000, 3000])
    each = 2 + 15 + 2 + 2 + 1 + 1 + REFILL  # vldr, vdiv, vmul, str, subs, bne
    # mov before the loop, bx after it; the last turn's branch is not taken
    exact = (got[:, 0] == turns * 6 + 2) & (got[:, 1] == turns * each + 2) & (got[:, 4] == [0, 2000, 0])
    return bool(exact.all())


def flown(scenario: str, level: str, folder: Path) -> tuple[Counted, Exportable]:
    """Count the recorded flight of a scenario."""
    flight, law, bundle = made(True, "float32", steps=None, scenario=scenario)
    target = replace(TARGETS["cortex-m4f"], flags=(level, *TARGETS["cortex-m4f"].flags[1:]))
    write_bundle(bundle, folder)
    code = compile_controller(bundle, folder, flags=target.flags, compiler=target.compiler)
    flags = (*target.bare(folder), "-DSURCTL_COUNTED")
    main = [folder / "target_start.c", folder / "sil_main.c"]
    program = compile_program([*main, *code], folder / "sil", flags=flags, compiler=target.compiler)
    parts = {}
    for source, file in zip(bundle.sources, code, strict=False):
        ending = source.removeprefix(bundle.name).removesuffix(".c")
        part = {"_sensing": 0, "_map": 0, "_law": 1}.get(ending, 2)
        parts |= dict.fromkeys(_symbols(file), part)
    load = np.zeros(len(flight), dtype=bool)
    load[0] = True
    host = Controller(law, bundle, (), None)
    counts = counted(program, f"{bundle.name}_step", parts, target, host.stream(as_records(law, flight), load=load))
    assert (host.parsed(counts.output, len(flight)).status >= 0).all()  # a refused step would be short
    return counts, law


def measured(*, quick: bool) -> tuple[list[str], list[tuple[str, bool]]]:
    """(lines, bars and whether they hold)."""
    with tempfile.TemporaryDirectory() as scratch:
        bundle = build_bundle(build_law("closed_form"), {}, real="float32")
        exact = known(TARGETS["cortex-m4f"], bundle, Path(scratch, "b"))
    held = [("a loop of known length is counted to the last instruction", exact)]
    if quick:
        return [], held
    out = [
        "| flight by sonar, steps | M4F | part | instructions, mean / max | cycles at most, mean / max | of a period "
        f"| {WAIT} wait states, no cache | of a period |",
        "|---|---|---|---|---|---|---|---|",
    ]
    shares: list[float] = []
    mixes = []
    for scenario, level in product(SCENARIOS, LEVELS):
        with tempfile.TemporaryDirectory() as scratch:
            counts, law = flown(scenario, level, Path(scratch, "b"))
        period = CLOCK * law.dt
        mixes.append(f"- Instructions of `{scenario}`, {level}: {mixed(counts.mix)}.")
        for name, parts in (("perception", [0]), ("the rest", [1, 2]), ("of that: guard", [2]), ("all", [0, 1, 2])):
            cells = [_pair(counts.steps[:, parts, 0].sum(axis=1))]
            for wait in (0, WAIT):
                cycles = counts.cycles(wait)[:, parts].sum(axis=1)
                cells += [_pair(cycles), f"{cycles.mean() / period:.1%} / {cycles.max() / period:.1%}"]
                shares += [cycles.max() / period] if parts == [0] else []
            out.append(f"| `{scenario}`, {len(counts.steps)} | {level} | {name} | {' | '.join(cells)} |")
            print(out[-1], file=sys.stderr, flush=True)
    out += ["", *mixes]
    held += [
        (f"perception at most {SHARE:.0%} without wait states, in any step", max(shares[::2]) <= SHARE),
        (f"and with {WAIT} wait states and no cache", max(shares[1::2]) <= SHARE),
    ]
    return out, held


def mixed(mix: Mapping[str, int]) -> str:
    """Return the share of each class of instructions, the largest first."""
    ordered = sorted(mix.items(), key=lambda item: -item[1])
    return ", ".join(f"{kind} {count / sum(mix.values()):.1%}" for kind, count in ordered)


def _pair(values: NDArray[np.int64]) -> str:
    return f"{values.mean():.0f} / {values.max()}"


if __name__ == "__main__":
    lines, bars = measured(quick="--quick" in sys.argv[1:])
    print("\n".join([*lines, "", *(f"- {what}: {'holds' if holds else '**does not hold**'}" for what, holds in bars)]))
    sys.exit(0 if all(holds for _, holds in bars) else 1)

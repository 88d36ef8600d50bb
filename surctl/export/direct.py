"""C text of a law without loops, which reads and writes the caller's structs directly, without copies."""

from __future__ import annotations

from surctl.export.contract import Exportable, commands, telemetry_ports
from surctl.export.fields import entries
from surctl.ir import C_TYPE, Parts, Program, Real
from surctl.ir.c99_folded import folded_lines, inline_helpers, own_helpers

__all__ = ["changing", "direct_law", "results"]

_TRUTHS = frozenset({"lt", "le", "eq", "ne", "and", "or", "not"})


def direct_law(law: Exportable, block: Program, name: str, real: Real) -> Parts:
    """Return the C text of the function `<name>_law(state, gains, input, next, status, output)`.

    The function reads state->x, *gains and *input. It writes next, *status and *output, and never reads their old
    values.
    """
    members = [
        [f"state->x[{k}]" for k in range(law.state.size)],
        [f"input->{member}" for member, _ in entries(law.inputs)],
        [f"gains->{member}" for member, _ in entries(law.gains)],
    ]
    left = [
        [f"output->{member}" for member, _ in entries(commands(law))],
        [f"next[{k}]" for k in range(law.state.size)],
        ["*status"],
        [f"output->{member}" for member, _ in entries(telemetry_ports(law))],
    ]
    stays = {f"next[{k}]" for k in range(law.state.size)} - {f"next[{k}]" for k in changing(block)}
    stores = [
        (to, ref)
        for place, refs in zip(left, block.output_refs, strict=True)
        for to, ref in zip(place, refs, strict=True)
        if to not in stays
    ]
    kind = C_TYPE[real]
    body = folded_lines(block.instructions, stores, address=lambda which, at: members[which][at], real=real, apart=True)
    # searched in the text, because the instruction list also reads state entries that do not change
    used = "\n".join(body)
    head = [
        f"void {name}_law(const {name}_state_t *state, const {name}_gains_t *gains,",
        f"    const {name}_input_t *input, {kind} *next, {kind} *status, {name}_output_t *output)",
    ]
    lines = [
        f"/* {block.operations} operations */",
        *head,
        "{",
        *(f"    (void){word};" for word in ("state", "input", "gains") if f"{word}->" not in used),
        *([] if changing(block) else ["    (void)next;"]),
        *body,
        "}",
    ]
    text = "\n".join([*own_helpers([block], real), *lines]) + "\n"
    return Parts({"": text}, (*inline_helpers([block], real), "\n".join(head) + ";"))


def changing(block: Program) -> list[int]:
    """Return the indices of the state entries that a step may change."""
    refs = block.output_refs[1]
    moved = [(k, block.instructions[ref]) for k, ref in enumerate(refs)]
    return [k for k, i in moved if i.op != "input" or i.args != (0, k)]


def results(law: Exportable, block: Program) -> list[str]:
    """Return the C names of results that may be NaN or infinite; constants, copied inputs and truth values cannot."""
    left = [
        [f"output->{member}" for member, _ in entries(commands(law))],
        [f"state->next[{k}]" for k in range(law.state.size)],
        [],
        [f"output->{member}" for member, _ in entries(telemetry_ports(law))],
    ]
    visited, checked = set[int](), list[str]()
    for place, refs in zip(left, block.output_refs, strict=True):
        for to, ref in zip(place, refs, strict=False):
            if (
                ref not in visited
                and block.instructions[ref].op not in ("const", "input")
                and block.instructions[ref].op not in _TRUTHS
            ):
                visited.add(ref)
                checked.append(to)
    return checked

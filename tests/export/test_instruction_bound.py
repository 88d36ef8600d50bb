"""Longest path through disassembled code: branches, loops, calls, jumps that only a run knows."""

from __future__ import annotations

from surctl.export.instruction_bound import InstructionBound, instruction_bound


def listed(name: str, start: int, *code: str) -> str:
    lines = [f"{start:08x} <{name}>:"]
    lines += [f"    {start + 2 * k:x}:\t4770 \t{each.replace(' ', chr(9), 1)}" for k, each in enumerate(code)]
    return "\n".join([*lines, "", ""])


HELPER = listed("helper", 0x100, "adds r0, #1", "bx lr")
LOOPING = listed("helper", 0x100, "subs r0, #1", "bne.n 100 <helper>", "bx lr")
STEP = ("cmp r0, #0", "beq.n 8 <my_step+0x8>", "bl 100 <helper>", "adds r0, #1", "bx lr")


def bound(text: str, turns: int = 3) -> InstructionBound:
    return instruction_bound(text, "my_step", turns=turns, own="my_")


def test_the_longer_of_two_branches_and_every_call_count() -> None:
    assert bound(listed("my_step", 0, *STEP) + HELPER).most == 5 + 2


def test_a_loop_of_the_exported_code_counts_as_often_as_it_can_turn_and_one_of_the_library_has_no_bound() -> None:
    loop = listed("my_step", 0, "movs r0, #3", "subs r0, #1", "bne.n 2 <my_step+0x2>", "bx lr")
    assert bound(loop).most == 1 + 4 * 2 + 1
    shared = ("subs r1, #1", "bne.n 0 <my_step>", "subs r0, #1", "bne.n 0 <my_step>", "bx lr")
    assert (bound(listed("my_step", 0, *shared), turns=2).most or 0) >= 2 * (2 * 2) + 2 * 2 + 1  # two turns of each
    assert bound(listed("my_step", 0, *STEP) + LOOPING) == InstructionBound(None, "helper has a loop")


def test_what_the_listing_does_not_state_gives_no_bound() -> None:
    assert bound(HELPER).reason == "my_step is not in the program"
    assert bound(listed("my_step", 0, "blx r3", "bx lr")).reason == "my_step jumps to a place that only its run knows"
    assert bound(listed("my_step", 0, "bl 0 <my_step>", "bx lr")).reason == "my_step is recursive"
    assert bound(listed("my_step", 0, "adds r0, #1")).reason == "my_step runs on beyond its end"

"""Storage of an assembled law as bytes, so that another process can load the law instead of assembling it again.

The first line is JSON that describes the law and gives the length of each routine's text. The texts of the routines
follow. The cache checks a digest of all bytes, and each text contains a digest of its routine, so an altered file is
not loaded.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from surctl.ir import Block, Call, Layout, Port, Routine, read_block, write_block
from surctl.marine.control.law import Law, Stages
from surctl.marine.control.perception import PERCEPTION, PerceptionStage
from surctl.marine.control.ports import PARAMETERS

__all__ = ["law_bytes", "law_from"]

_WORDS = ("name", "ref", "avoidance", "mode", "dt", "guidance", "barrier", "movers", "fallback")
_STAGES = ("closed", "pre", "post")


def law_bytes(law: Law) -> bytes:
    """Return the law, and those of its stages that are built, as bytes that `law_from` can read."""
    stages = [name for name in _STAGES if name in law.stages.__dict__]
    blocks = [write_block(block) for block in (law.block, *(getattr(law.stages, name) for name in stages))]
    head: dict[str, Any] = {word: getattr(law, word) for word in _WORDS}
    own = [port for port in law.gains if port.name not in PARAMETERS]
    head |= {"gains": _listed(own), "state": _listed(law.state)}
    head |= {"inputs": _listed(law.inputs), "outputs": _listed(law.outputs)}
    head |= {"levels": law.levels, "rows": law.rows, "stages": stages, "lengths": [len(text) for text in blocks]}
    if law.perception is not None:
        head["perception"] = {name: _listed(getattr(law.perception, name)) for name in ("state", "inputs", "outputs")}
    return "\n".join([json.dumps(head), "".join(blocks)]).encode()


def law_from(stored: bytes, other: Callable[[str], Block]) -> Law:
    """Load a law from the bytes of `law_bytes`; each part of the law is parsed when it is first used.

    Args:
        stored: the bytes.
        other: function from the name of a stage that the bytes do not contain to this stage; called when it is needed.
    """
    first, _, rest = stored.decode().partition("\n")
    head = json.loads(first)
    texts = []
    for length in head["lengths"]:
        texts.append(rest[:length])
        rest = rest[length:]
    block = read_block(texts[0])
    stages: dict[str, Callable[[], Block]] = {name: partial(other, name) for name in _STAGES}
    stages |= {name: partial(read_block, text) for name, text in zip(head["stages"], texts[1:], strict=True)}
    return Law(
        **{word: head[word] for word in _WORDS},
        state=_layout(head["state"]),
        inputs=_layout(head["inputs"]),
        outputs=_layout(head["outputs"]),
        gains=Layout((*PARAMETERS, *_layout(head["gains"]))),
        block=block,
        stages=Stages(**stages),
        levels=tuple((name, count, unit) for name, count, unit in head["levels"]),
        rows=tuple(head["rows"]),
        perception=_perception(head["perception"], block) if "perception" in head else None,
    )


def _perception(head: dict[str, list[list[Any]]], whole: Block) -> PerceptionStage:
    assert isinstance(whole, Routine)
    (block,) = (step.block for step in whole.steps if isinstance(step, Call) and step.block.name == PERCEPTION)
    return PerceptionStage(_layout(head["state"]), _layout(head["inputs"]), _layout(head["outputs"]), block)


def _listed(layout: Iterable[Port]) -> list[list[Any]]:
    return [[port.name, port.shape, port.unit, port.meaning, port.default, port.gap] for port in layout]


def _layout(listed: list[list[Any]]) -> Layout:
    return Layout(
        tuple(Port(name, tuple(shape), unit, text, default, gap) for name, shape, unit, text, default, gap in listed)
    )

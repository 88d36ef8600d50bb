"""Export of a marine law with its vehicle, its evidence and its closed form."""

from surctl.marine.export.compiled_law import CompiledLaw, LinkedLaw, LinkFaults, closed_form
from surctl.marine.export.operating_envelope import operating_envelope
from surctl.marine.export.robot_bundle import build_bundle

__all__ = [
    "CompiledLaw", "LinkFaults", "LinkedLaw", "build_bundle", "closed_form", "operating_envelope",
]  # fmt: skip

"""All findings of the diagnosis of one task stack over one region, as data and as text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from surctl.priority.diagnosis.findings import Equality, LevelReport, Pair, Singularity
from surctl.priority.diagnosis.sentences import say_equality, say_level, say_pair, say_singularity

__all__ = ["Diagnosis"]


@dataclass(frozen=True)
class Diagnosis:
    """All findings on a task stack over a region of poses; `explain` (or `str`) returns the findings as sentences.

    Attributes:
        tasks: names of the tasks, highest priority first.
        region: (lower, upper) bounds of every variable by name [m, m, m, rad, then the unit of each parameter].
        samples: number of samples.
        seed: seed of the samples.
        threshold: number below which a pose counts as singular; see `diagnose`.
        equality, pairs, singularities, levels: the findings of each kind.
    """

    tasks: tuple[str, ...]
    region: Mapping[str, tuple[float, float]]
    samples: int
    seed: int
    threshold: float
    equality: Equality
    pairs: tuple[Pair, ...]
    singularities: tuple[Singularity, ...]
    levels: tuple[LevelReport, ...]

    def explain(self) -> str:
        """Return all findings as text, one sentence per line, and a last line on how the numbers were computed."""
        lines = [say_equality(self.equality, levels=len(self.tasks), samples=self.samples)]
        lines += [say_pair(pair) for pair in self.pairs]
        lines += [say_singularity(singularity) for singularity in self.singularities]
        lines += [say_level(level) for level in self.levels]
        lines.append(
            f"These results rest on {self.samples} samples (seed {self.seed}) and local searches from the worst "
            "samples, so the diagnosis can miss poses."
        )
        return "\n".join(lines)

    def __str__(self) -> str:
        """Return the text of `explain`."""
        return self.explain()

    def to_dict(self) -> dict[str, Any]:
        """Return the diagnosis as dictionaries and lists for JSON; every number is finite."""
        return {name: _plain(value) for name, value in asdict(self).items()}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    return [_plain(entry) for entry in value] if isinstance(value, tuple) else value

"""The gains that a command uses: those of `--gains`, else the set chosen for the vehicle, else derived gains."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from surctl.marine.control import Gains, GainSpec
    from surctl.marine.simulation import SafetyClaim
    from surctl.marine.vehicle import Vehicle
    from surctl.verification import Inapplicable

__all__ = ["GAINS_HELP", "GainsChoice", "choose_gains", "choose_shared", "derive_words", "margin_short"]

GAINS_HELP = "Gain set: name or file (default: the vehicle's)."
"""Help of the option `--gains`. The default is the set `default` for the SUR vehicles, and derived gains for others."""


class GainsChoice(NamedTuple):
    """The gains, lines that say how they were derived (empty for a named set), and the same as data (or None)."""

    gains: Gains
    lines: list[str]
    data: dict[str, Any] | None

    @property
    def derived(self) -> bool:
        """Whether the gains were derived from the vehicle."""
        return self.data is not None


def choose_gains(
    word: str | None, vehicle: Vehicle, *, cruise: float, own: Mapping[str, GainSpec] | None = None
) -> GainsChoice:
    """Return the gains of the option `--gains`, or the default gains of the vehicle at a cruise speed [m/s]."""
    from surctl.marine.tuning import gains_for

    gains, derivation = gains_for(word, vehicle, cruise=cruise, own=own)
    beyond = _beyond([(vehicle, cruise)])
    if derivation is None:
        return GainsChoice(gains, beyond, None)
    return GainsChoice(gains, [*derivation.lines(), *beyond], derivation.to_dict())


def _beyond(pairs: Sequence[tuple[Vehicle, float]]) -> list[str]:
    # one line for each vehicle whose cruise speed needs more thrust than laws give
    from surctl.marine.vehicle.linearise import WITHIN_LAW, beyond_law

    said = [(f"{cruise:g} m/s {vehicle.name}", beyond_law(vehicle, cruise)) for vehicle, cruise in pairs]
    return list(dict.fromkeys(f"  warning: at {who} {beyond}; {WITHIN_LAW}" for who, beyond in said if beyond))


def choose_shared(
    word: str | None, pairs: Sequence[tuple[Vehicle, float]], *, own: Mapping[str, GainSpec] | None = None
) -> GainsChoice:
    """Return one gain set for several vehicles, each with its cruise speed [m/s]; see `tuning.shared_gains`."""
    from surctl.marine.tuning import has_tuned, shared_gains

    gains, derivation = shared_gains(word, pairs, own=own)
    if derivation is not None:
        return GainsChoice(gains, [*derivation.lines(), *_beyond(pairs)], derivation.to_dict())
    others = dict.fromkeys(one.name for one, _ in pairs if word is None and not has_tuned(one))
    why = "different vehicles share one set; for gains of one vehicle: surctl gains derive"
    return GainsChoice(gains, [f"gains default, not derived from {', '.join(others)}: {why}"] if others else [], None)


def derive_words(vehicle: str, cruise: float, file: str, *, margin: float = math.nan) -> str:
    """Return the command that writes the derived gains of a vehicle to a file, if finite with this gain `margin`."""
    words = ["surctl", "gains", "derive", vehicle, "--cruise", f"{cruise:g}"]
    words += ["--margin", f"{margin:g}"] if math.isfinite(margin) else []
    return shlex.join([*words, "--out", file])


def margin_short(contact: SafetyClaim | Inapplicable | None) -> float:
    """Return the gain `margin` [m] that a no-contact claim needs if it has too little; else a value not finite."""
    from surctl.verification import Inapplicable

    if contact is None or isinstance(contact, Inapplicable) or contact["margin needed"] <= contact["margin"]:
        return math.nan
    return contact.least_margin

"""Registry of all control laws by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Literal, TypeAlias

from surctl.control.baselines import Situation, apf_law, cbf_law, dwa_law, vo_law
from surctl.control.closed_form import closed_form_law
from surctl.control.decision import Decision
from surctl.control.guarded import guarded_law
from surctl.control.paper import paper_law
from surctl.control.stopping import BARRIERS

__all__ = ["LAWS", "LAW_NAMES", "LawBuilder", "LawName"]

LawName = Literal["guarded", "paper", "closed_form", "apf", "dwa", "vo", "cbf"]
LawBuilder: TypeAlias = Callable[[Situation], Decision]


def _guarded(s: Situation) -> Decision:
    stop = BARRIERS[s.barrier](s.p, s.dt)
    moving = s.moving and s.movers == "predict"
    return guarded_law(s.desired, s.perceived, s.x, s.eta, s.nu, s.p, stop=stop, scan=s.scan, moving=moving)


def _paper(s: Situation) -> Decision:
    return paper_law(s.form, s.desired, s.perceived, s.x, s.eta, s.p, dt=s.dt)


def _closed_form(s: Situation) -> Decision:
    return closed_form_law(s.desired, s.perceived, s.x, s.eta, s.p)


LAWS: Mapping[LawName, LawBuilder] = MappingProxyType(
    {
        "guarded": _guarded,
        "paper": _paper,
        "closed_form": _closed_form,
        "apf": apf_law,
        "dwa": dwa_law,
        "vo": vo_law,
        "cbf": cbf_law,
    }
)
"""The function that builds the decision of each law, by name."""

LAW_NAMES: tuple[LawName, ...] = tuple(LAWS)

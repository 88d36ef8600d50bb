"""Textbook laws to compare with: the same wish, contacts and velocity loop, another way around what is there.

Their parameters are the module constants, tuned as analysis/13_baselines says. With sonars they turn as the guarded
law does and take the marks of its map as contacts, but know no caution before what is unknown.
"""

from surctl.control.baselines.apf import apf_law
from surctl.control.baselines.cbf import cbf_law
from surctl.control.baselines.dwa import dwa_law
from surctl.control.baselines.situation import Situation
from surctl.control.baselines.vo import vo_law

__all__ = ["Situation", "apf_law", "cbf_law", "dwa_law", "vo_law"]

"""Textbook laws for comparison with the guarded law; they use other methods of obstacle avoidance.

They share the desired velocity, the contacts and the velocity loop with the guarded law. The parameters of the textbook
laws are the module constants; analysis/13_baselines describes how they were tuned. With sonars, these laws turn like
the guarded law and use the marks of its map as contacts, but they do not slow down before unknown space.
"""

from surctl.control.baselines.apf import apf_law
from surctl.control.baselines.cbf import cbf_law
from surctl.control.baselines.dwa import dwa_law
from surctl.control.baselines.situation import Situation
from surctl.control.baselines.vo import vo_law

__all__ = ["Situation", "apf_law", "cbf_law", "dwa_law", "vo_law"]

"""Textbook laws for comparison with the guarded law; each uses another method of obstacle avoidance.

The textbook laws use the same desired velocity, obstacle points and velocity loop as the guarded law. Their parameters
are constants of their modules; analysis/13_baselines describes how they were tuned. With sonars, the robot turns about
its vertical axis as under the guarded law, and the obstacle points are the occupied cells of the sonar map. However,
the textbook laws do not slow down before unknown space.
"""

from surctl.marine.control.baselines.apf import apf_law
from surctl.marine.control.baselines.cbf import cbf_law
from surctl.marine.control.baselines.dwa import dwa_law
from surctl.marine.control.baselines.situation import Situation
from surctl.marine.control.baselines.vo import vo_law

__all__ = ["Situation", "apf_law", "cbf_law", "dwa_law", "vo_law"]

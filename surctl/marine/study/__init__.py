"""A study: it computes gains, verdicts, runs, exported C and a report from a vehicle file or a study file."""

from surctl.marine.study.conduct import Study
from surctl.marine.study.plan import LIBRARY, Leg, Plan, load_plan, scaled_missions

__all__ = ["LIBRARY", "Leg", "Plan", "Study", "load_plan", "scaled_missions"]

"""Randomness has a seed: Hypothesis draws the same examples in every run, and no deadline on noisy machines."""

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

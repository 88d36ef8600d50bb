"""Settings of the suite: Hypothesis draws the same examples in every run, and warnings are errors."""

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

"""Settings of the suite: Hypothesis draws the same examples in every run; commands print all their lines."""

import os

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")
os.environ["SURCTL_VERBOSE"] = "1"

"""The own least-distance solver: one dual active-set iteration as expressions, in bounded loops, with its ladder."""

from __future__ import annotations

"""This package's own least-distance solver: a dual active-set iteration in bounded loops, with fallback stages."""

from __future__ import annotations

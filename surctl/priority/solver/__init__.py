"""This package's own least-distance solver: a dual active-set method with fallback stages."""

from __future__ import annotations

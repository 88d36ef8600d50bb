"""Solver for the velocity nearest to a target within limits, with fallbacks that give a velocity for any limits."""

from __future__ import annotations

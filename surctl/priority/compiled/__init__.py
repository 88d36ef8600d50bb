"""The four priority modes compiled with bounded loops, for the exported controller and for fast runs in Python."""

from __future__ import annotations

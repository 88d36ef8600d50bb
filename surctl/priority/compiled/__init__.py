"""The four modes as routines with bounded loops: what a controller runs, and the fast path from Python."""

from __future__ import annotations

"""The four priority laws as compiled code with bounded loops, for the exported controller and fast runs in Python."""

from __future__ import annotations

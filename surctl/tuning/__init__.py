"""Gains chosen by measurement: sweeps and their store."""

from surctl.tuning.sweep import COLUMNS, DELAY_FLOOR, DISK_FLOOR, Axis, Flight, Sweep, sweep

__all__ = ["COLUMNS", "DELAY_FLOOR", "DISK_FLOOR", "Axis", "Flight", "Sweep", "sweep"]

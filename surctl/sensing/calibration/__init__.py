"""Calibration of a range sensor from a range test, which is a file or Table II of the paper."""

"""Calibration of a range sensor from the data of a range test: a file, or Table II of the paper."""

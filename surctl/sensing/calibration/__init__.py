"""Calibration of a range sensor from a range test: from a file, or the one of the paper."""

"""The sonar array: its geometry, its echo model with reflectors, and its faults."""

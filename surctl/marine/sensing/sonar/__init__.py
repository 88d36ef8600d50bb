"""The sonar array: its geometry, its echo model, and its faults, computed with NumPy and in CasADi symbols."""

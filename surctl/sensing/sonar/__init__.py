"""The sonar array: its geometry, echo model and faults, each for NumPy numbers and for CasADi symbols."""

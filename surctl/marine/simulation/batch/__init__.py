"""The closed loop as one compiled function that simulates many runs at once."""

"""Logs of other programs (ArduPilot, ROS, MCAP, PX4, tables) and the map that says what their fields are."""

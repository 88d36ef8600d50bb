"""Replay of recorded sonar readings through the range tracker of the control law."""

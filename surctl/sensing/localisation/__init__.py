"""Localisation of the robot and of moving obstacles from messages of the base station, which may be late or lost."""

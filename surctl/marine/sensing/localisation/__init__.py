"""Localisation of the robot and of moving obstacles from base-station messages, which may be late or lost."""

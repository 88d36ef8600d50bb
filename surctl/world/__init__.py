"""Shapes, distances and cones, planar at the robot's depth; shared by sensing and simulation."""

from surctl.world.echoes import nearest_echo
from surctl.world.shapes import Box, Disc, Shape, Vector2, Wall, site_walls

__all__ = ["Box", "Disc", "Shape", "Vector2", "Wall", "nearest_echo", "site_walls"]

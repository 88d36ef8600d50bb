"""Geometry for sensing and simulation: planar shapes, distances to shapes, nearest points in cones, upright solids."""

from surctl.marine.world.shapes import WHOLE, Box, Disc, Heights, Prism, Shape, Vector2, Wall, site_walls

__all__ = [
    "WHOLE",
    "Box",
    "Disc",
    "Heights",
    "Prism",
    "Shape",
    "Vector2",
    "Wall",
    "site_walls",
]

"""Geometry for sensing and simulation: planar shapes, distances to shapes, nearest points in cones, upright solids."""

from surctl.marine.world.echoes import box_edges, in_view, nearest_echo, nearest_facing
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
    "box_edges",
    "in_view",
    "nearest_echo",
    "nearest_facing",
    "site_walls",
]

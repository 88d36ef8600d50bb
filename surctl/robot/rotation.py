"""Rotations as matrices, quaternions (x, y, z, w) and rotation vectors, in CasADi."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

__all__ = ["about", "quaternion_of", "quaternion_rate", "rotation_of", "rotation_vector"]


def about(axis: NDArray[np.float64], angle: ca.SX) -> ca.SX:
    """Return the matrix (3, 3) of a rotation by `angle` [rad] about the unit vector `axis` (Rodrigues)."""
    x, y, z = (float(entry) for entry in axis)
    cross = ca.sparsify(ca.DM([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]))
    return ca.SX.eye(3) + ca.sin(angle) * cross + (1.0 - ca.cos(angle)) * (cross @ cross)


def rotation_of(quaternion: ca.SX) -> ca.SX:
    """Return the matrix (3, 3) of a quaternion (x, y, z, w) of any length but 0."""
    x, y, z, w = ca.vertsplit(quaternion)
    s = 2.0 / ca.sumsqr(quaternion)
    return ca.vertcat(
        ca.horzcat(1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)),
        ca.horzcat(s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)),
        ca.horzcat(s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)),
    )


def quaternion_rate(quaternion: ca.SX) -> ca.SX:
    """Return the matrix (4, 3) that maps the angular velocity in the turning frame to the rate of its quaternion."""
    x, y, z, w = ca.vertsplit(quaternion)
    return 0.5 * ca.vertcat(ca.horzcat(w, -z, y), ca.horzcat(z, w, -x), ca.horzcat(-y, x, w), ca.horzcat(-x, -y, -z))


def quaternion_of(R: ca.SX) -> ca.SX:
    """Return the unit quaternion (x, y, z, w), w ≥ 0, of a rotation matrix (Shepperd 1978)."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    xy, yz, zx = R[0, 1] + R[1, 0], R[1, 2] + R[2, 1], R[0, 2] + R[2, 0]
    # each is the quaternion times four of its entries, of which the largest is far from 0
    rows = [
        ca.vertcat(1.0 + 2.0 * R[0, 0] - trace, xy, zx, x),
        ca.vertcat(xy, 1.0 + 2.0 * R[1, 1] - trace, yz, y),
        ca.vertcat(zx, yz, 1.0 + 2.0 * R[2, 2] - trace, z),
        ca.vertcat(x, y, z, 1.0 + trace),
    ]
    best, largest = rows[3], rows[3][3]
    for k in range(3):
        better = rows[k][k] > largest
        best, largest = ca.if_else(better, rows[k], best), ca.fmax(largest, rows[k][k])
    best = best / ca.norm_2(best)
    return ca.if_else(best[3] < 0.0, -best, best)


def rotation_vector(R: ca.SX) -> ca.SX:
    """Return angle · axis (3,) [rad] of a rotation matrix, with an angle in [0, π]."""
    quaternion = quaternion_of(R)
    half = ca.norm_2(quaternion[:3])
    small = half < 1e-9
    # both branches are finite; for small angles the quotient is 2 to rounding
    return quaternion[:3] * ca.if_else(small, 2.0, 2.0 * ca.atan2(half, quaternion[3]) / ca.if_else(small, 1.0, half))

"""The kinematics η̇ = J(ψ) ν, equations (1)–(2) of the paper, with ENU world frame {E} and FLU body frame {B}."""

from __future__ import annotations

import casadi as ca

__all__ = ["jacobian", "planar_rotation"]


def planar_rotation(psi: ca.SX) -> ca.SX:
    """Return the 2×2 matrix R(ψ) that rotates horizontal vectors from {B} to {E}; ψ [rad] is counter-clockwise from x.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.vehicle import planar_rotation
        >>> ca.DM(planar_rotation(ca.SX(ca.pi / 2)) @ ca.DM([0.2, 0.0])).full().round(3).ravel().tolist()
        [0.0, 0.2]
    """
    c, s = ca.cos(psi), ca.sin(psi)
    return ca.vertcat(ca.horzcat(c, -s), ca.horzcat(s, c))


def jacobian(psi: ca.SX) -> ca.SX:
    """Return the matrix J(ψ) of equation (2), 4×4, that maps ν = (u, v, w, r) in {B} [m/s, rad/s] to η̇ in {E}.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.vehicle import jacobian
        >>> ca.DM(jacobian(ca.SX(ca.pi / 2)) @ ca.DM([0.2, 0.0, 0.0, 0.1])).full().round(3).ravel().tolist()
        [0.0, 0.2, 0.0, 0.1]
    """
    return ca.diagcat(planar_rotation(psi), ca.SX.eye(2))

"""Kinematics (1)–(2): η̇ = J(ψ) ν, ENU world {E}, FLU body {B}."""

from __future__ import annotations

import casadi as ca

__all__ = ["jacobian", "planar_rotation"]


def planar_rotation(psi: ca.SX) -> ca.SX:
    """R(ψ), 2×2: body-frame horizontal vectors to {E}; ψ [rad] counter-clockwise from x."""
    c, s = ca.cos(psi), ca.sin(psi)
    return ca.vertcat(ca.horzcat(c, -s), ca.horzcat(s, c))


def jacobian(psi: ca.SX) -> ca.SX:
    """J(ψ) of (2), 4×4: ν = (u, v, w, r) in {B} [m/s, rad/s] to η̇ in {E}."""
    return ca.diagcat(planar_rotation(psi), ca.SX.eye(2))

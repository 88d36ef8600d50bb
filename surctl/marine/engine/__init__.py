"""The same closed loop in MuJoCo, a rigid-body engine with contacts, rays and pictures (extra `mujoco`)."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.marine.engine.fluid import Body, EngineOptions
    from surctl.marine.engine.mjcf import mjcf
    from surctl.marine.engine.physics import BatchCase, MujocoPhysics, mujoco_physics
    from surctl.marine.engine.pictures import CAMERAS, Moment, Scene

__all__ = [
    "CAMERAS",
    "BatchCase",
    "Body",
    "EngineOptions",
    "Moment",
    "MujocoPhysics",
    "Scene",
    "mjcf",
    "mujoco_physics",
]

load_at_first_use(__name__)

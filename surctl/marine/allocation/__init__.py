"""Allocation of a force and yaw moment to the thrusters of a vehicle, by strict priorities within their limits."""

from surctl.marine.allocation.allocate import Allocation, allocate, working_flags

__all__ = ["Allocation", "allocate", "working_flags"]

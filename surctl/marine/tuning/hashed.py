"""A vehicle as the key of a cache."""

from __future__ import annotations

from surctl.marine.vehicle import Vehicle

__all__ = ["HashedVehicle"]


class HashedVehicle:
    """A vehicle that compares by name and parameters, as a key of a cache."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle, self.key = vehicle, (vehicle.name, vehicle.digest())

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, HashedVehicle) and self.key == other.key

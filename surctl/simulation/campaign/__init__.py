"""What many drawn flights of a scenario say together."""

from surctl.simulation.campaign.assumptions import assumptions, braking_distance
from surctl.simulation.campaign.share import Share

__all__ = ["Share", "assumptions", "braking_distance"]

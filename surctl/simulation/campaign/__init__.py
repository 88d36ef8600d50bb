"""What many drawn flights of a scenario say together."""

from surctl.simulation.campaign.assumptions import assumptions
from surctl.simulation.campaign.campaign import CHUNK, FASTEST, Campaign, fly_campaign
from surctl.simulation.campaign.draws import MonteCarlo, draw_plant
from surctl.simulation.campaign.flight import Flight, Plan
from surctl.simulation.campaign.folder import CampaignFolder
from surctl.simulation.campaign.replay import Replay, load_replay
from surctl.simulation.campaign.share import Share
from surctl.simulation.campaign.summary import Summary, summarise
from surctl.simulation.campaign.table import RunTable
from surctl.simulation.campaign.worlds import WORLDS_VEHICLE, RandomWorlds, random_world, world_template

__all__ = [
    "CHUNK",
    "FASTEST",
    "WORLDS_VEHICLE",
    "Campaign",
    "CampaignFolder",
    "Flight",
    "MonteCarlo",
    "Plan",
    "RandomWorlds",
    "Replay",
    "RunTable",
    "Share",
    "Summary",
    "assumptions",
    "draw_plant",
    "fly_campaign",
    "load_replay",
    "random_world",
    "summarise",
    "world_template",
]

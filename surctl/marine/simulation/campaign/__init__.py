"""Monte Carlo campaigns: many random runs of a scenario, and their statistics."""

from surctl.marine.simulation.campaign.assumptions import assumptions
from surctl.marine.simulation.campaign.campaign import CHUNK, FASTEST, Campaign, run_campaign
from surctl.marine.simulation.campaign.draws import MonteCarlo, draw_plant
from surctl.marine.simulation.campaign.folder import CampaignFolder
from surctl.marine.simulation.campaign.plan import Plan, SampledRun
from surctl.marine.simulation.campaign.replay import Replay, load_replay
from surctl.marine.simulation.campaign.share import Share
from surctl.marine.simulation.campaign.summary import Summary, summarise
from surctl.marine.simulation.campaign.table import RunTable
from surctl.marine.simulation.campaign.worlds import WORLDS_VEHICLE, RandomWorlds, random_world, world_template

__all__ = [
    "CHUNK",
    "FASTEST",
    "WORLDS_VEHICLE",
    "Campaign",
    "CampaignFolder",
    "MonteCarlo",
    "Plan",
    "RandomWorlds",
    "Replay",
    "RunTable",
    "SampledRun",
    "Share",
    "Summary",
    "assumptions",
    "draw_plant",
    "load_replay",
    "random_world",
    "run_campaign",
    "summarise",
    "world_template",
]

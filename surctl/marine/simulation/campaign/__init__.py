"""Monte Carlo campaigns: many random runs of a scenario, and their statistics."""

from surctl.marine.simulation.campaign.campaign import (
    CHUNK,
    FASTEST,
    Campaign,
    CampaignFolder,
    Replay,
    load_replay,
    run_campaign,
)
from surctl.marine.simulation.campaign.summary import RunTable, Summary, assumptions, summarise
from surctl.marine.simulation.campaign.worlds import (
    WORLDS_VEHICLE,
    MonteCarlo,
    Plan,
    RandomWorlds,
    SampledRun,
    draw_plant,
    random_world,
    world_template,
)

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
    "Summary",
    "assumptions",
    "draw_plant",
    "load_replay",
    "random_world",
    "run_campaign",
    "summarise",
    "world_template",
]

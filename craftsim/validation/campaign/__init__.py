"""Campaigns: many independent trials over worker processes or a Ray cluster, whose results survive every fault."""

from craftsim.validation.campaign.campaign import Engine, run_campaign, run_here
from craftsim.validation.campaign.finished import FinishedCampaign, read_finished
from craftsim.validation.campaign.items import Done, Item, TrialRecord
from craftsim.validation.campaign.store import Header

__all__ = [
    "Done",
    "Engine",
    "FinishedCampaign",
    "Header",
    "Item",
    "TrialRecord",
    "read_finished",
    "run_campaign",
    "run_here",
]

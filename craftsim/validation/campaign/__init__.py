"""Campaigns: many independent trials over worker processes or a Ray cluster, whose results survive every fault."""

from craftsim.validation.campaign.campaign import Engine, run_campaign, run_here
from craftsim.validation.campaign.items import Done, Item, TrialRecord
from craftsim.validation.campaign.store import FinishedCampaign, Header, read_finished

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

"""Campaigns: many independent trials over worker processes or a Ray cluster, whose results survive every fault."""

from craftsim.validation.campaign.campaign import Engine, run_campaign
from craftsim.validation.campaign.finished import Finished, read_finished
from craftsim.validation.campaign.items import Done, Item, TrialRecord
from craftsim.validation.campaign.store import Header

__all__ = [
    "Done",
    "Engine",
    "Finished",
    "Header",
    "Item",
    "TrialRecord",
    "read_finished",
    "run_campaign",
]

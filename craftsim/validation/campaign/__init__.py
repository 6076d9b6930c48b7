"""Campaigns: many independent trials over worker processes or a Ray cluster, whose results survive every fault."""

from craftsim.validation.campaign.campaign import Engine, do_all, run_campaign, run_here
from craftsim.validation.campaign.finished import FinishedCampaign, read_finished
from craftsim.validation.campaign.header import Header
from craftsim.validation.campaign.items import Answer, Done, Failure, Item, TrialRecord
from craftsim.validation.campaign.records import Records, select
from craftsim.validation.campaign.rounds import Rounds, open_rounds
from craftsim.validation.campaign.schema import Form

__all__ = [
    "Answer",
    "Done",
    "Engine",
    "Failure",
    "FinishedCampaign",
    "Form",
    "Header",
    "Item",
    "Records",
    "Rounds",
    "TrialRecord",
    "do_all",
    "open_rounds",
    "read_finished",
    "run_campaign",
    "run_here",
    "select",
]

"""Words that options take, where nothing heavy has to be imported to know them."""

from __future__ import annotations

from typing import Final, Literal

RuleSet = Literal["published", "physical"]
"""CraftEnv's own rules, or those that physics supports."""
Drive = Literal["rollers", "reduced"]
"""How a car's mecanum wheels touch the ground: by ten free rollers each, or by one ball each that stands for them."""
Engine = Literal["local", "ray"]
"""Processes of this machine, or actors of an existing Ray cluster."""
PlanOrder = Literal["sequential", "ticks", "concurrent"]
"""How a plan is carried out: one action after the other; tick after tick, all cars of one at the same time; or each
action as early as those that it depends on have ended."""
Objective = Literal["makespan", "work"]
"""What a plan is to have little of: the time until all is done, or the sum of all actions' durations."""
DEFAULT_ROUNDS: Final = 2000
"""Attempts at a plan, unless given."""
DEFAULT_TIME_S: Final = 10.0
"""After so long no attempt at a plan begins, unless given."""
AlgoName = Literal["ippo", "mappo", "qmix", "vdn", "iql", "coma", "qtran", "pqn"]
Backend = Literal["grid", "physics"]
Execution = Literal["synchronous", "asynchronous"]
"""A step of an environment lasts until the slowest car has ended, or each car decides when its own action has ended."""
PresetName = Literal["paper", "paper_plus"]
"""The training protocol of CraftEnv's paper, and the same after exploration of craftsim's own."""

LEVELS: Final = ("none", "mild", "strong", "lab_floor", "workshop_floor")
"""The ladder of what is unknown, from level 0 to level 4: exact, mild, strong, lab floor, workshop floor."""


def preset_of_level(name: str) -> str:
    """Return the preset that a level's number, or its name, stands for; what is none as it is.

    Example:
        >>> preset_of_level("0"), preset_of_level("4"), preset_of_level("exact"), preset_of_level("mine.yaml")
        ('none', 'workshop_floor', 'none', 'mine.yaml')
    """
    levels = {str(number): preset for number, preset in enumerate(LEVELS)} | {"exact": LEVELS[0]}
    return levels.get(name, name)

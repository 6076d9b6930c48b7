"""Choices of options, without heavy imports."""

from __future__ import annotations

from typing import Final, Literal

RuleSet = Literal["published", "physical"]
"""CraftEnv's own rules, or the corrected ones."""
Drive = Literal["wheels", "rollers"]
"""Model of the mecanum wheels: one tyre each, whose friction acts along its rollers, or ten free rollers each."""
Engine = Literal["local", "ray"]
"""Local processes, or actors of an existing Ray cluster."""
PlanOrder = Literal["sequential", "ticks", "concurrent"]
"""Execution of a plan: one action after the other; tick by tick; or each action as soon as those that it depends on
have ended."""
Objective = Literal["makespan", "work"]
"""What to minimize: the makespan, or the sum of all actions' durations."""
DEFAULT_ROUNDS: Final = 2000
"""Default number of attempts at a plan."""
FIRST_PLAN_S: Final = 60.0
"""Default time in which a first plan must be found."""
BETTER_PLAN_S: Final = 10.0
"""Default time after which a plan is not improved any more."""
AlgoName = Literal["ippo", "mappo", "qmix", "vdn", "iql", "coma", "qtran", "pqn"]
Backend = Literal["grid", "physics"]
Device = Literal["cpu", "cuda"]
"""Where networks learn."""
Execution = Literal["synchronous", "asynchronous"]
"""A step lasts until the slowest car has finished, or each car decides when its own action has finished."""
PresetName = Literal["paper", "paper_plus"]
"""The training protocol of CraftEnv's paper, without and with our own exploration before."""

LEVELS: Final = ("none", "mild", "strong", "lab_floor", "workshop_floor")
"""Randomization presets, levels 0 to 4: exact, mild, strong, lab floor, workshop floor."""


def preset_of_level(name: str) -> str:
    """Return the preset for the number or name of a level; anything else unchanged.

    Example:
        >>> preset_of_level("0"), preset_of_level("4"), preset_of_level("exact"), preset_of_level("mine.yaml")
        ('none', 'workshop_floor', 'none', 'mine.yaml')
    """
    levels = {str(number): preset for number, preset in enumerate(LEVELS)} | {"exact": LEVELS[0]}
    return levels.get(name, name)

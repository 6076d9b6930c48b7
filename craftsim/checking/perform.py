"""Performing one action in physics: the shortest way from a Site to a judgement."""

from __future__ import annotations

from craftsim.checking.attempt import Attempt
from craftsim.checking.recipe import Act
from craftsim.checking.settings import Setup, Thresholds, nominal_gains
from craftsim.checking.world import judge_on
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import RuleSet
from craftsim.errors import InputError
from craftsim.models.sensing import Sensors
from craftsim.models.world import Site
from craftsim.skills.gains import Gains
from craftsim.skills.library import SkillChoice, own_skills


def perform(
    site: Site,
    car: int,
    action: Action | str,
    *,
    rules: RuleSet = "physical",
    gains: Gains | None = None,
    sensors: Sensors | None = None,
    thresholds: Thresholds | None = None,
    skills: SkillChoice | None = None,
) -> Attempt:
    """Let one car perform one action on a Site, and judge it on the poses that it ends with.

    The Site goes on from where it stands, so that calls can follow each other. What the rules forbid is not performed;
    the attempt then says why.

    Args:
        site: the world.
        car: number of the car that acts.
        action: what it does, or its name.
        rules: the rule set that predicts.
        gains: of the skills; the nominal ones unless given.
        sensors: of the cars; exact ones unless given.
        thresholds: limits of the errors; the default ones unless given.
        skills: of your own in place of built-in ones, as :class:`craftsim.Executor` takes them.

    Raises:
        InputError: there is no such car or action, or something stood in something else at the Site's start.

    Example:
        >>> import craftsim
        >>> site = craftsim.Site(craftsim.Grid.empty((3, 1, 1), n_cars=1))
        >>> attempt = craftsim.perform(site, 0, "MOVE_RIGHT")
        >>> attempt.agrees, attempt.read
        (True, '1,0,1 +x')
    """
    if not 0 <= car < len(site.cars):
        raise InputError(f"there is no car {car}: the world has {len(site.cars)}, counted from 0")
    if isinstance(action, str):
        action = Action[Act(car, action).action]
    setup = Setup(
        rules, thresholds or Thresholds(), gains=gains or nominal_gains(), skills=own_skills(skills)
    )
    return judge_on(site, setup, sensors).perform(car, action)

"""What a validation runs: blueprints, and what tells their cars what to do."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from craftsim.checking.recipe import Step
from craftsim.discrete.errors import InputError
from craftsim.discrete.files.plan import read_actions, read_plan, shipped_plan
from craftsim.discrete.tasks import TASK_NAMES
from craftsim.validation.campaign import Item
from craftsim.validation.runs.policies import policy_digest
from craftsim.validation.runs.run import Run, Terms, read_task

PLANNER: Final = "planner"
"""The policy that carries out the shipped plans."""
SHIPPED: Final = "shipped"
"""Stands for the digest of what belongs to a version of craftsim."""


@dataclass(frozen=True)
class Subject:
    """A world to run in."""

    name: str
    place: str
    """Name of a shipped task, or path of a blueprint."""
    digest: str
    n_cars: int


@dataclass(frozen=True)
class Pilot:
    """What tells the cars what to do."""

    name: str
    digest: str
    """Of the files that it is made of, so that a changed one is noticed."""
    plans: Mapping[str, tuple[Step, ...]] = field(default_factory=dict)
    """By subject; a policy has none."""
    policy: str = ""


def subjects_of(blueprints: Sequence[str]) -> list[Subject]:
    """Return the subjects that paths of blueprints or names of tasks stand for.

    Raises InputError for a file that is no blueprint, and for two of one name.
    """
    found: dict[str, Subject] = {}
    for text in blueprints:
        shipped = text in TASK_NAMES
        place = text if shipped else str(Path(text).resolve())
        name = text if shipped else Path(text).stem
        if name in found:
            raise InputError(
                f"two blueprints are called '{name}'; rename one, or run them one after the other"
            )
        n_cars = read_task(place).layout.n_cars
        found[name] = Subject(name, place, SHIPPED if shipped else _digest(Path(text)), n_cars)
    return list(found.values())


def plan_pilot(path: Path, subject: Subject) -> Pilot:
    """Return what carries out a plan file; raise PlanError for one that does not fit."""
    return Pilot(path.stem, _digest(path), {subject.name: _steps(path, subject)})


def actions_pilot(path: Path, subject: Subject) -> Pilot:
    """Return what tries a file's actions one after the other; raise PlanError for one that does not fit."""
    ticks = read_actions(path, subject.n_cars).ticks
    steps = tuple(Step.single(tick, *joint[0]) for tick, joint in enumerate(ticks))
    return Pilot(path.stem, _digest(path), {subject.name: steps})


def policy_pilot(policy: str, subjects: Sequence[Subject]) -> Pilot:
    """Return what does as a policy says; raise InputError where there is no such policy."""
    if policy != PLANNER:
        place = str(Path(policy).resolve()) if Path(policy).exists() else policy
        return Pilot(policy, policy_digest(place), policy=place)
    for subject in subjects:
        if subject.place not in TASK_NAMES:
            raise InputError(f"there is no shipped plan for {subject.place}; give one with --plan")
    return Pilot(PLANNER, SHIPPED, {s.name: _steps(shipped_plan(s.name), s) for s in subjects})


def items_of(
    subjects: Sequence[Subject], pilots: Sequence[Pilot], trials: int, terms: Terms
) -> Iterator[Item]:
    """Yield all runs: every pilot in every subject, so many times."""
    for episode in range(trials):
        for subject in subjects:
            for pilot in pilots:
                key = f"{subject.name}/{pilot.name}/{episode:04d}"
                run = Run(key, subject.place, pilot.plans.get(subject.name), pilot.policy, episode, terms)
                yield Item(key, pilot.name, terms.seed, run, subject.name, episode)


def _steps(path: Path, subject: Subject) -> tuple[Step, ...]:
    ticks = read_plan(path, subject.n_cars).ticks
    return tuple(Step.joint(tick, list(joint)) for tick, joint in enumerate(ticks) if joint)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()

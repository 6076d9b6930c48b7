"""Jobs: a drawing, the plan that builds it, and how to tell that the work is done; run in physics and checked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from craftsim.checking.checked_run import ActionRecord, CheckedRun, CheckedSite, run_plan
from craftsim.discrete.actions import Action
from craftsim.discrete.files.blueprint import Blueprint, read_blueprint
from craftsim.discrete.files.design import Design, read_design
from craftsim.discrete.files.plan import Plan, read_plan, shipped_plan
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import make_task
from craftsim.models.config import SimulationConfig
from craftsim.models.site import Site
from craftsim.skills.executor import Executor, Observer
from craftsim.skills.gains import Gains


@dataclass(frozen=True)
class Job:
    """A drawing with its plan and its goal."""

    name: str
    """Name of the task, or of the file of a drawing that belongs to none."""
    task: str | None
    """The shipped task whose drawing this is, if it is one."""
    drawing: Blueprint
    plan: Plan
    design: Design | None
    """The cells that the finished building fills, where the goal is a building."""
    succeeded: Callable[[Grid], bool] | None
    """Whether a world is what was to be built; None where there is no goal."""

    @property
    def n_actions(self) -> int:
        """Number of actions in the plan."""
        return sum(len(tick) for tick in self.plan.ticks)

    @property
    def goal_cells(self) -> list[Cell]:
        """Cells of the floor to mark for people: the building's plan, or where the flag goes."""
        if self.design is not None:
            cells = [target.cell for target in self.design.targets]
        else:
            cells = [self.drawing.goal] if self.drawing.goal else []
        return [cell for cell in cells if cell[2] == 1]

    def site(self, seed: int, config: SimulationConfig | None = None) -> Site:
        """Return the start in physics; the seed decides what the drawing leaves to chance."""
        return Site(self.drawing.grid(np.random.default_rng(seed)), config, goals=self.goal_cells)


@dataclass(frozen=True)
class JobResult:
    """A job that was run in physics."""

    job: Job
    run: CheckedRun
    reached: bool | None
    """Whether the goal is reached; None where there is none."""
    simulation: SimulationConfig
    gains: Gains

    @property
    def agree(self) -> int:
        """Number of actions that did what the rules predicted."""
        return sum(record.legal and record.verdict.agrees for record in self.run.records)

    @property
    def good(self) -> bool:
        """Whether every action did what the rules predicted and no goal was missed."""
        return self.run.agrees and self.reached is not False


def read_job(
    task: str, blueprint: Path | None = None, plan: Path | None = None, goal: Path | None = None
) -> Job:
    """Return the job of a shipped task, some of its files replaced by one's own.

    A blueprint of one's own has the goal of the file ``goal``, or none. Raises BlueprintError or PlanError with
    file and line for anything that is wrong with a file.
    """
    shipped = make_task(task)
    drawing = read_blueprint(blueprint) if blueprint else shipped.starts[0]
    actions = read_plan(plan or shipped_plan(task), drawing.n_cars)
    design = None if blueprint else shipped.design
    succeeded = None if blueprint else shipped.succeeded
    if goal:
        design = read_design(goal)
        succeeded = design.satisfied
    if design:
        design.check_fits(drawing.size)
    own = blueprint is not None
    return Job(drawing.path.stem, None if own else task, drawing, actions, design, succeeded)


def run_job(
    job: Job,
    site: Site,
    observer: Observer | None = None,
    begin: Callable[[int, int, Action], None] = lambda tick, car, action: None,
    done: Callable[[ActionRecord], None] = lambda record: None,
) -> JobResult:
    """Run a job's plan on its start, every action checked against the physical rules.

    Args:
        job: what to do.
        site: ``job.site(...)``, where nothing has happened yet.
        observer: called at the start and after every control period.
        begin: called with tick, car and action before each action.
        done: called with the record after each action.
    """
    executor = Executor(site, observer=observer)
    if observer is not None:
        observer(site)
    run = run_plan(CheckedSite(site, Rules("physical"), executor), job.plan, begin, done)
    reached = job.succeeded(run.final.grid) if job.succeeded else None
    return JobResult(job, run, reached, site.config, executor.gains)

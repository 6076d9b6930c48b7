"""Which task a policy was trained for: identified by what its worlds are made of, and not by its name alone."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Any

from craftsim.discrete.rules import RuleSet
from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.starts import Starts
from craftsim.training.starts import HalfShown


@dataclass(frozen=True)
class TaskIdentity:
    """What a task is, in digests (SHA-256, hexadecimal) that can be stored and compared."""

    name: str
    world: str
    """Of the start files' contents and of whether observations show the flag."""
    design: str
    """Of the cells to be built; empty for a task without a design."""
    rules: RuleSet

    @classmethod
    def of(cls, task: Task, rules: RuleSet = "physical") -> TaskIdentity:
        """Return the identity of a task under a rule set; rewards, lengths and stored starts are no part of it."""
        world = _digest([task.shows_flag, *(start.content for start in task.starts)])
        design = "" if task.design is None else _digest(task.design.content)
        return cls(task.name, world, design, rules)

    @property
    def digest(self) -> str:
        """One digest of all but the name."""
        return _digest([self.world, self.design, self.rules])

    def difference(self, task: Task, rules: RuleSet | None = None) -> str:
        """Return in words in what another task differs, or nothing where it is the same.

        Designs are compared where both have one, rule sets where one is given.
        """
        other = TaskIdentity.of(task, rules or self.rules)
        if self.world != other.world:
            return "its worlds start otherwise"
        if self.design and other.design and self.design != other.design:
            return "its design is another"
        return self.rules_difference(rules)

    def rules_difference(self, rules: RuleSet | None) -> str:
        """Return in words that a rule set is another, or nothing where it is the same or none is given."""
        return f"its rule set is {rules}, not {self.rules}" if rules and rules != self.rules else ""

    def as_dict(self) -> dict[str, str]:
        """Return the fields by name."""
        return asdict(self)


def starts_digest(task: Task) -> str:
    """Return a digest of the stored worlds that a task's episodes start with; empty where it has none."""
    starts = task.sampler.others if isinstance(task.sampler, HalfShown) else task.sampler
    if not isinstance(starts, Starts):
        return ""
    digest = hashlib.sha256()
    for array in (starts.grids.cells, starts.grids.cars, starts.designs):
        digest.update(f"{array.dtype} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()

"""The failures of a campaign in their smallest worlds: the first one of each kind, as sentences and files."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from craftsim.discrete.files.blueprint import write_blueprint
from craftsim.experiments.bundle import Bundle, read_bundle
from craftsim.experiments.experiment import Answer, Done, Failure, Item, TrialRecord
from craftsim.experiments.session import Session
from craftsim.storage.folders import directory_within
from craftsim.storage.writing import write_whole
from craftsim.validation.audit.verdicts import kind_of
from craftsim.validation.shrinking.shrink import DependsError, OnTrial, Smallest, failing_actions, shrink
from craftsim.validation.shrinking.words import sentence

FOLDER: Final = "smallest"
"""Of the files, within that of a campaign."""
BLUEPRINT: Final = "smallest.yaml"
ACTIONS: Final = "smallest.actions"
SHRINK_S: Final = 3600.0
"""After which the search for a smallest world is given up."""


@dataclass(frozen=True)
class Shrunk:
    """A failure in its smallest world."""

    key: str
    """Name of the trial."""
    sentence: str
    """When it fails, or why it could not be shrunk."""
    rules: str
    """The rule set that allows the action."""
    minimal: bool
    """Whether nothing can be taken away any more without the failure going away, too."""
    trials: int
    cells: tuple[int, int, int] | None
    """Size of the smallest world; None where there is none."""
    folder: str | None
    """With its blueprint and its actions, relative to the campaign's."""


ShrinkProgress = Callable[[int], AbstractContextManager[Callable[[Shrunk], None]]]
"""Given the number of kinds, opens what is called with each one's result."""


def shrink_bundle(bundle: Bundle, out: Path, name: str, on_trial: OnTrial = lambda fails: None) -> Shrunk:
    """Shrink the failure that a replay bundle shows, and write its smallest world.

    Args:
        bundle: the failure.
        out: folder of results.
        name: of the folder in it for the files.
        on_trial: shows what is done.

    Raises InputError where no legal action fails, and for a folder that cannot be written.
    """
    rules, why = bundle.recipe.setup.rules, ""
    for failing in failing_actions(bundle.recipe, bundle.attempts, bundle.most_s):
        try:
            found = shrink(failing, on_trial)
        except DependsError as error:
            why = why or f"car {failing.car} {failing.action.name}: {error}"
            continue
        write_smallest(found, directory_within(out, name))
        text, cells = sentence(found), found.grid.size
        return Shrunk(bundle.key, text, rules, found.minimal, found.trials, cells, name)
    return Shrunk(bundle.key, why, rules, minimal=False, trials=0, cells=None, folder=None)


def write_smallest(found: Smallest, folder: Path) -> None:
    """Write a smallest world and its action into a folder, for ``craftsim validate``."""
    write_blueprint(found.grid, folder / BLUEPRINT)
    write_whole(folder / ACTIONS, f"0 {found.action.name}\n")


def shrink_failures(
    session: Session, records: Iterable[TrialRecord], progress: ShrinkProgress
) -> tuple[Shrunk, ...]:
    """Shrink the first failure of each kind that has a replay bundle, and write the smallest worlds.

    Args:
        session: the run; the worlds go into ``smallest/`` in its folder.
        records: its records, with their bundles.
        progress: shows what is done.
    """
    bundles = list(first_of_each_kind(records).values())
    if not bundles or session.out is None:
        return ()
    out = session.out.resolve()
    items = [
        Item(bundle, FOLDER, 0, (out, bundle, f"{FOLDER}/{number:02d}"))
        for number, bundle in enumerate(bundles)
    ]
    with progress(len(items)) as on_each:
        answers = session.map(
            *(FOLDER, items, _shrink, "looking for the smallest worlds"),
            timeout_s=SHRINK_S,
            on_answer=lambda number, answer: on_each(_shrunk(bundles[number], answer)),
        )
    return tuple(_shrunk(bundle, answer) for bundle, answer in zip(bundles, answers, strict=True))


def first_of_each_kind(records: Iterable[TrialRecord]) -> dict[str, str]:
    """Return the bundle of the first failure of each kind of a legal action, by the kind."""
    found: dict[str, str] = {}
    for record in records:
        wrong = next((a for a in record["attempts"] if a["legal"] and a["performed"] and a["reason"]), None)
        if wrong is not None and record["bundle"]:
            found.setdefault(f"{wrong['verb']}: {kind_of(wrong['reason'])}", record["bundle"])
    return found


def _shrink(job: tuple[Path, str, str]) -> Done:
    out, bundle, name = job
    return Done(
        agrees=True, extra=asdict(shrink_bundle(read_bundle(out / bundle, of_own_run=True).bundle, out, name))
    )


def _shrunk(bundle: str, answer: Answer) -> Shrunk:
    """Return what became of a failure; one that could not be shrunk says why."""
    if isinstance(answer, Failure):
        return Shrunk(bundle, answer.text, "", minimal=False, trials=0, cells=None, folder=None)
    cells = answer.extra["cells"]
    return Shrunk(**{**answer.extra, "cells": None if cells is None else tuple(cells)})

"""Replay bundles: a folder with all that it takes to see again what went wrong, and to check that it is the same.

A bundle holds the recipe, the attempts of its last step, the drawn physics, the full state before and after, the
contacts, and the scene as MJCF for people. Nothing in it is code: text, and NumPy arrays that are read without pickles.
"""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from craftsim.checking.attempt import Attempt
from craftsim.checking.checked_site import CheckedSite
from craftsim.checking.recipe import Recipe, do, run_up
from craftsim.errors import InputError
from craftsim.models.randomization import Nominal
from craftsim.models.scene import write_scene
from craftsim.models.site import Site
from craftsim.report import output_directory, versions

SCHEMA_VERSION: Final = 3
"""Raised whenever something in a bundle changes its meaning or goes away."""

TEXT: Final = "bundle.json"
PHYSICS: Final = "physics.npz"
BEFORE: Final = "before.npz"
AFTER: Final = "after.npz"
CONTACTS: Final = "contacts.csv"
SCENE: Final = "scene"
FILM: Final = "film.mp4"

Arrays = dict[str, NDArray[np.generic]]


@dataclass(frozen=True)
class Bundle:
    """What a bundle says in words and numbers, as it stands in ``bundle.json``."""

    schema_version: int
    key: str
    """Name of the trial that it is from."""
    versions: dict[str, str]
    recipe: Recipe
    attempts: tuple[Attempt, ...]
    """Of the last step, for each of its actions."""
    start_s: float
    """Simulated time at which the last step began."""
    end_s: float


@dataclass(frozen=True)
class Recorded:
    """A bundle with its arrays, as read from a folder."""

    folder: Path
    bundle: Bundle
    physics: Arrays
    before: Arrays
    after: Arrays


_BUNDLE: Final = TypeAdapter(Bundle)


def state_of(site: Site) -> Arrays:
    """Return copies of all that decides how a Site goes on, that MuJoCo's state vector leaves out included."""
    names = ("time", "qpos", "qvel", "act", "ctrl", "qacc_warmstart", "tree_asleep")
    state = {name: np.array(getattr(site.data, name)) for name in names}
    return state | {"sleep_policy": site.model.tree_sleep_policy.copy()}


def physics_of(site: Site) -> Arrays:
    """Return copies of the figures of a Site that randomised physics draws."""
    nominal = Nominal.of(site.model)
    return {field.name: getattr(nominal, field.name) for field in fields(Nominal)}


def write_bundle(
    folder: Path, key: str, recipe: Recipe, attempts: tuple[Attempt, ...] | None = None
) -> Bundle:
    """Perform a recipe and write the bundle of its last step; return what it says.

    Args:
        folder: is made; files of an older bundle in it are replaced.
        key: name of the trial.
        recipe: what led to the disagreement.
        attempts: of the last step when it was first done. That they come out the same again is then
            checked, for a bundle that shows something else is worse than none.

    Raises:
        InputError: the folder cannot be written.
        ReplayError: the last step came out otherwise.
    """
    checked = run_up(recipe)
    before, start_s = state_of(checked.site), checked.site.time_s
    again = do(checked, recipe.steps[-1])
    if attempts is not None and attempts != again:
        raise ReplayError(f"{key} came out otherwise when it was re-run: {again} for {attempts}")
    bundle = Bundle(
        schema_version=SCHEMA_VERSION,
        key=key,
        versions=versions(),
        recipe=recipe,
        attempts=again,
        start_s=start_s,
        end_s=checked.site.time_s,
    )
    output_directory(folder)
    try:
        _write(folder, bundle, checked, before)
    except OSError as error:
        raise InputError(f"cannot write the replay bundle {folder}: {error.strerror}") from error
    return bundle


class ReplayError(RuntimeError):
    """Something came out otherwise when it was re-run, on the same machine and version."""


def _write(folder: Path, bundle: Bundle, checked: CheckedSite, before: Arrays) -> None:
    for name in (TEXT, FILM):
        (folder / name).unlink(missing_ok=True)
    for name, arrays in (
        (PHYSICS, physics_of(checked.site)),
        (BEFORE, before),
        (AFTER, state_of(checked.site)),
    ):
        np.savez_compressed(folder / name, allow_pickle=False, **arrays)
    assert checked.log is not None
    checked.log.write(folder / CONTACTS)
    recipe = bundle.recipe
    write_scene(folder / SCENE, recipe.grid, recipe.setup.simulation, recipe.goals, recipe.setup.machines)
    # Written last, so that a folder with this file is a whole bundle.
    (folder / TEXT).write_bytes(_BUNDLE.dump_json(bundle, indent=1) + b"\n")


def read_bundle(folder: Path) -> Recorded:
    """Read and check a bundle. Raises InputError, naming the file, for one that is missing or damaged."""
    path = folder / TEXT
    try:
        text = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); give the folder of a replay bundle"
        ) from error
    try:
        bundle = _BUNDLE.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise InputError(
            f"{path}: {where}: {first['msg']}" if where else f"{path}: {first['msg']}"
        ) from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    if bundle.schema_version != SCHEMA_VERSION:
        raise InputError(
            f"{path}: schema_version is {bundle.schema_version}; this craftsim reads version {SCHEMA_VERSION}"
        )
    if not bundle.recipe.steps:
        raise InputError(f"{path}: recipe.steps is empty; a bundle shows its last step")
    arrays = [_read_arrays(folder / name) for name in (PHYSICS, BEFORE, AFTER)]
    return Recorded(folder, bundle, *arrays)


def _read_arrays(path: Path) -> Arrays:
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"{path}: damaged or no archive of arrays: {error}") from error

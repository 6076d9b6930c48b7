"""The files that come with the package: blueprints, goal files and plans, each found by its name."""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path
from typing import Final, Literal

from craftsim.errors import BlueprintError, suggestion
from craftsim.storage.paths import exists, is_file

Shelf = Literal["blueprints", "goals", "plans"]

_PLACES: Final[dict[Shelf, tuple[str, str]]] = {
    "blueprints": ("blueprints", ".yaml"),
    "goals": ("blueprints", ".yaml"),
    "plans": ("plans", ".plan"),
}
"""Folder and suffix of each kind of file."""


def shipped_blueprint(name: str) -> Path:
    """Return the path of a shipped start or goal file, e.g. ``strip`` or ``strip_goal``."""
    return _path(name, "blueprints")


def shipped_plan(name: str) -> Path:
    """Return the path of a shipped plan, named as the task that it builds."""
    return _path(name, "plans")


def shipped_names(shelf: Shelf) -> list[str]:
    """Return the names of what is shipped, sorted; those of goal files end in ``_goal``."""
    suffix = _PLACES[shelf][1]
    names = sorted(path.stem for path in _path("", shelf).parent.glob(f"*{suffix}"))
    return [name for name in names if name.endswith("_goal") == (shelf == "goals")]


def find(path: str | Path, shelf: Shelf) -> Path:
    """Return the file that a path or the name of a shipped one stands for; a file that exists comes first.

    Raises BlueprintError for what is neither; for a bare name it lists the shipped ones.
    """
    found, names = Path(path), shipped_names(shelf)
    known = str(path) in names
    if exists(found) and (is_file(found) or not known):
        return found
    if known:
        return _path(str(path), shelf)
    if found.name != str(path):
        raise BlueprintError(f"{path}: no such file")
    hint = suggestion(str(path)[:80], names)
    raise BlueprintError(f"{path}: no such file{hint}; shipped {shelf} are {', '.join(names)}")


def _path(name: str, shelf: Shelf) -> Path:
    folder, suffix = _PLACES[shelf]
    with as_file(files("craftsim") / "data" / folder) as path:
        return path / f"{name}{suffix}"

"""The files that come with the package: blueprints, goal files and plans, each found by its name."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal

from craftsim.errors import BlueprintError, suggestion
from craftsim.storage.paths import exists, is_file

Shelf = Literal["blueprints", "goals", "plans"]

_DATA: Final = Path(__file__).parents[2] / "data"


def shipped_blueprint(name: str) -> Path:
    """Return the path of a shipped start or goal file, e.g. ``strip`` or ``strip_goal``."""
    return _DATA / "blueprints" / f"{name}.yaml"


def shipped_plan(name: str) -> Path:
    """Return the path of a shipped plan, named as the task that it builds."""
    return _DATA / "plans" / f"{name}.plan"


def shipped_names(shelf: Shelf) -> list[str]:
    """Return the names of what is shipped, sorted; those of goal files end in ``_goal``."""
    if shelf == "plans":
        pattern = shipped_plan("*")
    else:
        pattern = shipped_blueprint("*")
    names = sorted(path.stem for path in pattern.parent.glob(pattern.name))
    return [name for name in names if name.endswith("_goal") == (shelf == "goals")]


def find_file(path: str | Path, shelf: Shelf) -> Path:
    """Return the file that a path or the name of a shipped one stands for; a file that exists comes first.

    Raises BlueprintError for what is neither; for a bare name it lists the shipped ones.
    """
    file = Path(path)
    names = shipped_names(shelf)
    is_shipped = str(path) in names
    if exists(file) and (is_file(file) or not is_shipped):
        return file
    if is_shipped:
        if shelf == "plans":
            return shipped_plan(str(path))
        return shipped_blueprint(str(path))
    if file.name != str(path):
        raise BlueprintError(f"{path}: no such file")
    hint = suggestion(str(path)[:80], names)
    raise BlueprintError(f"{path}: no such file{hint}; shipped {shelf} are {', '.join(names)}")

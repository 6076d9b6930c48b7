"""Make docs/reference/actions.md and its films: what each action needs and changes, and how long it takes."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

import craftsim
from craftsim import Action, Grid, Kind
from craftsim.checking.recipe import Recipe, Step, perform_step, start
from craftsim.checking.setup import SEED_0, Setup
from craftsim.designs.drawn import random_start
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.schedule import SITUATIONS, nominal_durations
from craftsim.rendering.film import FilmOptions
from craftsim.rendering.render import render
from craftsim.rendering.trajectory import Recorder

REFERENCE: Final = Path(__file__).parents[1] / "docs" / "reference"
LOOK: Final = FilmOptions((480, 270), 10, quality="draft", cards=False, captions=False)
WORLDS: Final = 60
TICKS: Final = 40


@dataclass(frozen=True)
class Entry:
    """An action of the page."""

    title: str
    actions: tuple[Action, ...]
    numbers: str
    needs: tuple[str, ...]
    does: str
    things: dict[tuple[int, int, int], tuple[Kind, int]]
    """What stands in the film's world of 6 x 3 x 2 cells: kind and yaw by cell."""
    car: tuple[int, ...]
    """x, y, z and yaw."""
    before: tuple[Action, ...] = ()
    """What the car does before the film begins."""


_RIGHT: Final = Action.MOVE_RIGHT
_SLOPE: Final = {(2, 1, 1): (Kind.FSLOPE, 0), (3, 1, 1): (Kind.GEAR, 0)}
_RAMP: Final = {(2, 1, 1): (Kind.BODY, 0), (3, 1, 1): (Kind.FOOT, 0), (1, 1, 1): (Kind.BLOCK, 0)}
ENTRIES: Final = (
    Entry(
        "STOP",
        (Action.STOP,),
        "",
        ("Always legal on the floor; on a slope a car can only drive on.",),
        "Nothing. An action that is not legal does nothing either.",
        {},
        (2, 1, 1, 0),
    ),
    Entry(
        "MOVE_LEFT, MOVE_RIGHT, MOVE_BACK, MOVE_FORWARD",
        (Action.MOVE_LEFT, _RIGHT, Action.MOVE_BACK, Action.MOVE_FORWARD),
        "Left and right are -x and +x of the map, back and forward -y and +y, whatever the heading.",
        (
            "The next cell is in the area, has no car and no wall in it, and ground or a block below it.",
            "Under a block or a flag a car drives along its heading alone, forward or back; in and out.",
            "Under a folded slope it drives backwards, from the high side, and out again forward.",
            "A car that carries something enters an empty cell only.",
        ),
        "The car, with its load, is in the next cell. Its heading stays.",
        {(4, 1, 1): (Kind.BLOCK, 0)},
        (1, 1, 1, 0),
    ),
    Entry(
        "A move on a ramp",
        (Action.MOVE_LEFT, _RIGHT, Action.MOVE_BACK, Action.MOVE_FORWARD),
        "The same four actions: onto the foot, over the body, and onto the landing, or down again.",
        (
            "The car drives forward, along the ramp: up from the foot's low end, or down from the landing.",
            "The landing is a block behind the body's high end, with nothing above it and no car on it.",
            "On a slope nothing but the next move along it is legal.",
        ),
        "Three moves up: on the foot, on the body, on the landing one level higher.",
        _RAMP,
        (4, 1, 1, 2),
    ),
    Entry(
        "ROTATE_LEFT, ROTATE_RIGHT",
        (Action.ROTATE_LEFT, Action.ROTATE_RIGHT),
        "",
        (
            "Not under a slope, and not on one.",
            "What the car carries has room to turn: a load sweeps beyond its cell, a slope with its gear further.",
        ),
        "The heading turns by a quarter, with the load.",
        {},
        (2, 1, 1, 0),
    ),
    Entry(
        "LIFT",
        (Action.LIFT,),
        "",
        (
            "The car is under a block, a flag or a folded slope, and carries nothing.",
            "Nothing stands on it. It is drawn into the car's cell: a car drives under objects to lift them.",
        ),
        "The object is the car's load and moves with it.",
        {(3, 1, 1): (Kind.BLOCK, 0)},
        (3, 1, 1, 0),
    ),
    Entry(
        "DROP",
        (Action.DROP,),
        "",
        ("The car carries something, is not on a slope, and is not above the top level.",),
        "The load stands in the car's cell; a block that is put down one level up makes a building of two storeys.",
        {(3, 1, 1): (Kind.BLOCK, 0)},
        (3, 1, 1, 0),
        (Action.LIFT,),
    ),
    Entry(
        "UNFOLD",
        (Action.UNFOLD,),
        "",
        (
            "The car is under the folded slope that it unfolds, plugged into it, and carries nothing.",
            "The cell that the foot goes to, on the gear's side, is empty, with ground or a block below it.",
            "The flap meets nothing on its way, a half circle over both cells.",
        ),
        "The slope and its gear become a ramp of two cells: the body, the car's cell, and the foot.",
        _SLOPE,
        (2, 1, 1, 2),
    ),
    Entry(
        "FOLD",
        (Action.FOLD,),
        "",
        (
            "The car is under the body of the unfolded slope, and carries nothing.",
            "No car and nothing else is on the body or on the foot, and the flap meets nothing on its way.",
        ),
        "The ramp becomes a folded slope and its gear again, which can be lifted and carried elsewhere.",
        _SLOPE,
        (2, 1, 1, 2),
        (Action.UNFOLD,),
    ),
)
FILMED: Final = {
    "STOP": (Action.STOP,) * 20,
    "MOVE_LEFT, MOVE_RIGHT, MOVE_BACK, MOVE_FORWARD": (_RIGHT, _RIGHT, _RIGHT, Action.MOVE_LEFT),
    "A move on a ramp": (Action.MOVE_LEFT,) * 3,
    "ROTATE_LEFT, ROTATE_RIGHT": (Action.ROTATE_LEFT, Action.ROTATE_RIGHT),
}
"""What is done in a film, where that is not the action once."""


def main() -> None:
    """Make the page and its films."""
    folder = REFERENCE / "actions"
    folder.mkdir(exist_ok=True)
    reasons = found_reasons()
    parts = [
        "<!-- Made by scripts/actions_page.py; do not edit. -->\n",
        "# Actions\n",
        "What a car can do: 15 actions, of which the four diagonal moves are never legal. Each film below is contact\n"
        "physics; fold and unfold run four times as fast as the clock. `Rules.explain(grid, car, action)` says why an\n"
        f"action is forbidden; the reasons listed here are those that {WORLDS} random worlds gave most often.\n"
        "[The rules](../rules.md) has all.\n",
    ]
    for entry in ENTRIES:
        film = f"{entry.title.split(',')[0].split()[-1].lower()}.webp"
        make_film(entry, folder / film)
        verb = ACTIONS[entry.actions[0]].verb if entry.title != "A move on a ramp" else "ramp"
        parts.append(section(entry, film, reasons.get(verb, Counter())))
    numbers = ", ".join(f"{int(action)} `{action.name}`" for action in Action)
    parts.append(f"## Numbers\n\nIn all spaces and files: {numbers}.\n")
    (REFERENCE / "actions.md").write_text("\n".join(parts), encoding="utf-8")


def section(entry: Entry, film: str, reasons: Counter[str]) -> str:
    """Return the text about an action."""
    needs = "\n".join(f"- {line}" for line in entry.needs)
    often = "\n".join(f"- {words}" for words, _ in reasons.most_common(5))
    text = [
        f"## {entry.title}\n",
        f"![{entry.title}](actions/{film})\n",
        *([f"{entry.numbers}\n"] if entry.numbers else []),
        f"Needs:\n\n{needs}\n",
        f"Does: {entry.does}\n",
        f"Takes: {durations(entry)}.\n",
        *([f"Forbidden, for example, because\n\n{often}\n"] if often else []),
    ]
    return "\n".join(text)


def durations(entry: Entry) -> str:
    """Return how long an action takes at nominal physics."""
    on_slope = entry.title == "A move on a ramp"
    words = {"flat": "", "flat_loaded": " with a load", "slope": "", "slope_loaded": " with a load"}
    found = [
        f"{seconds:g} s{words[name]}"
        for name, seconds in zip(SITUATIONS, nominal_durations()[entry.actions[0]], strict=True)
        if seconds and name.startswith("slope") == on_slope
    ]
    return ", ".join(dict.fromkeys(found))


def make_film(entry: Entry, path: Path) -> None:
    """Film an action in contact physics, on rollers. Raises RuntimeError where it does not do as predicted."""
    grid = Grid.empty((6, 3, 2), 1)
    for cell, (kind, yaw) in entry.things.items():
        grid.kind[cell], grid.yaw[cell] = kind, yaw
    grid.cars[0, :4] = entry.car
    grid.derive_marks()
    actions = (*entry.before, *FILMED.get(entry.title, entry.actions[:1]))
    steps = [Step.single(number, 0, action) for number, action in enumerate(actions)]
    recipe = Recipe(blueprint_text(grid), tuple(steps), Setup(), SEED_0)
    judge, recorder, attempts = start(recipe), Recorder(), []
    for number, step in enumerate(steps):
        if number == len(entry.before):
            recorder.begin(judge)
            attempts = []
        attempts += perform_step(judge, step)
    if not all(attempt.agrees for attempt in attempts):
        raise RuntimeError(f"{entry.title}: {attempts}")
    look = replace(LOOK, speed=4.0 if entry.title in ("FOLD", "UNFOLD") else 1.0)
    render(recorder.trajectory(entry.title, recipe, attempts), path, look)


def found_reasons() -> dict[str, Counter[str]]:
    """Return why actions are forbidden in random worlds that are played at random, by verb; moves onto ramps apart."""
    rules, rng = craftsim.Rules("physical"), np.random.default_rng(0)
    found: dict[str, Counter[str]] = {}
    for number in range(WORLDS):
        grid = random_start(rng, number / WORLDS).grid
        for _ in range(TICKS):
            car = int(rng.integers(grid.n_cars))
            legal = []
            for action in Action:
                said = rules.explain(grid, car, action)
                if said.legal:
                    legal.append(action)
                elif action.name.count("_") < 2:  # the diagonal ones are never legal
                    words = without_numbers(said.reason)
                    verb = (
                        "ramp"
                        if "ramp" in words or "slope a car" in words
                        else ACTIONS[action].verb
                    )
                    found.setdefault(verb, Counter())[words] += 1
            if legal:
                grid = rules.apply(grid, car, legal[int(rng.integers(len(legal)))])
    return found


def without_numbers(reason: str) -> str:
    """Return a reason without the numbers of cells and cars."""
    words = re.sub(r": (car \d+|a|the|nothing|another).*", "", reason)
    words = re.sub(r"\(-?\d+, -?\d+, -?\d+\)", "a cell", words)
    return re.sub(r"car \d+", "another car", words)


if __name__ == "__main__":
    main()

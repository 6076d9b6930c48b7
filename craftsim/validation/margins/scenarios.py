"""The scenarios whose margins are searched: the car gets to its place by itself, and then does what is judged.

A car that has just driven under a block stands there as well as it knows its place: that decides what it can lift. So
the actions that do not drive come after one that does. Mirror images are left out, for the machines are alike left and
right; diagonal moves are never legal.
"""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Final

import numpy as np

from craftsim.checking.episode import Step
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import CarField
from craftsim.discrete.rules import RuleSet
from craftsim.errors import InputError
from craftsim.validation.audit.scenes import SCENES
from craftsim.validation.contexts.context import Context, action_of, verb_of
from craftsim.validation.contexts.survey import make_world

THEN: Final = " then "
SCENE: Final = "/scene="


@dataclass(frozen=True)
class Scenario:
    """What is done where; the last action is judged."""

    action: str
    """Of the data sheet's row, such as ``lift``."""
    where: str
    """Such as ``a block between blocks``."""
    id: str
    """A context or a scene of the audit, by its name, and the acts that follow."""

    @property
    def name(self) -> str:
        """Both, as people say it."""
        return f"{self.action} {self.where}"

    def begin(self, seed: int, rules: RuleSet) -> tuple[str, tuple[Step, ...]]:
        """Return the world as a blueprint, and the steps; the seed draws the place on the map and the direction.

        Raises CraftsimError for a scenario that no world can show, or that the rules forbid.
        """
        start, *others = self.id.split(THEN)
        if SCENE in start:
            scene = next(scene for scene in SCENES if scene.id == start)
            return blueprint_text(scene.world()), (scene.step(legal=True),)
        context = Context.of(start)
        grid = make_world(context, np.random.default_rng(seed), rules)
        heading = int(grid.cars[0, CarField.YAW])
        acts = [context.action(heading), *(action_of(*verb_of(other), heading) for other in others)]
        return blueprint_text(grid), tuple(Step.single(tick, 0, act) for tick, act in enumerate(acts))


def _go(
    way: str, next_: str = "air", load: str = "none", level: int = 1, tight: bool = False, own: str = "air"
) -> str:
    """Return the name of the context of a move on the flat."""
    room = "tight" if tight else "free"
    return f"MOVE-{way}/level={level}/ground=flat/own={own}/load={load}/next={next_}/room={room}"


def _turn(load: str, level: int = 1, tight: bool = False) -> str:
    room = "tight" if tight else "free"
    return f"ROTATE_LEFT/level={level}/ground=flat/own=air/load={load}/room={room}"


_DOWN: Final = f"{THEN}MOVE-forward{THEN}MOVE-forward"

CHOSEN: Final = tuple(
    Scenario(action, where, id)
    for action, ids in {
        "lift": {
            "a block": _go("forward", "block") + THEN + "LIFT",
            "a block between blocks": _go("forward", "block", tight=True) + THEN + "LIFT",
            "a block on top of blocks": _go("forward", "block", level=2) + THEN + "LIFT",
            "a folded slope": _go("back", "fslope-back") + THEN + "LIFT",
        },
        "drop": {
            "a block": _go("forward", load="block") + THEN + "DROP",
            "a block between blocks": _go("forward", load="block", tight=True) + THEN + "DROP",
            "a block on top of blocks": _go("forward", load="block", level=2) + THEN + "DROP",
            "a folded slope": _go("forward", load="fslope") + THEN + "DROP",
        },
        "fold": {
            "a slope": _go("back", "body-back") + THEN + "FOLD",
            "a slope on top of blocks": _go("back", "body-back", level=2) + THEN + "FOLD",
            "between cars": "FOLD/scene=cars beside",
        },
        "unfold": {
            "a slope": _go("back", "fslope-back") + THEN + "UNFOLD",
            "a slope on top of blocks": "UNFOLD/level=2/ground=flat/own=fslope-back/load=none/room=free",
            "between loads": "UNFOLD/scene=loads beside",
        },
        "turn": {
            "unloaded": _turn("none"),
            "a block between blocks": _turn("block", tight=True),
            "a folded slope on top of blocks": _turn("fslope", level=2),
            "a block among cars": "ROTATE_LEFT/scene=cars at all corners, block turns",
        },
        "move": {
            "unloaded": _go("forward"),
            "a block": _go("forward", load="block"),
            "a block between blocks": _go("forward", load="block", tight=True),
            "a block sideways between blocks": _go("left", load="block", tight=True),
            "a block back": _go("back", load="block"),
            "a folded slope": _go("forward", load="fslope"),
            "a block on top of blocks": _go("forward", load="block", level=2),
            "from block to block below them": _go("forward", "block", own="block"),
            "out from below a slope": _go("forward", own="body-back"),
        },
        "climb": {
            "unloaded": _go("forward", "foot-back") + _DOWN,
            "with a block": _go("forward", "foot-back", load="block") + _DOWN,
            "with a block between blocks": _go("forward", "foot-back", load="block", tight=True) + _DOWN,
            "with a folded slope": _go("forward", "foot-back", load="fslope") + _DOWN,
        },
        "descend": {
            "unloaded": _go("forward", "above-body-forward", level=2) + _DOWN,
            "with a block": _go("forward", "above-body-forward", load="block", level=2) + _DOWN,
            "with a folded slope": _go("forward", "above-body-forward", load="fslope", level=2) + _DOWN,
        },
        "stay": {"with a block": "STOP/level=1/ground=flat/own=air/load=block/room=free"},
        "two cars": {
            "side by side": "MOVE+MOVE/scene=side by side/order=concurrent",
            "one sets down beside one that passes": "DROP+MOVE/scene=set down beside one that passes/order=concurrent",
        },
    }.items()
    for where, id in ids.items()
)
"""Each action in free room, loaded, between neighbours, on top of blocks and on slopes, as far as it has these."""


def scenarios(pattern: str = "*", quick: bool = False) -> tuple[Scenario, ...]:
    """Return the scenarios whose names match a pattern as of file names; quick: the first one of each action.

    Raises InputError where none does.
    """
    first = {one.action: one for one in reversed(CHOSEN)}
    found = tuple(
        one for one in CHOSEN if fnmatchcase(one.name, pattern) and (not quick or one is first[one.action])
    )
    if not found:
        names = ", ".join(one.name for one in CHOSEN)
        raise InputError(f"no scenario matches '{pattern}'; there are {names}")
    return found

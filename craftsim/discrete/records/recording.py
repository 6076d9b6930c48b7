"""Recording an episode in one readable file, and playing it again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, get_args

import numpy as np

from craftsim.discrete.actions import Action
from craftsim.discrete.files.blueprint import parse_blueprint
from craftsim.discrete.files.documents import Scalar, Source, parse_keys, read_text
from craftsim.discrete.files.documents import Sequence as ListNode
from craftsim.discrete.files.saving import blueprint_text
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.planning.planner import Planner, empty_queue
from craftsim.discrete.rules.sets import Rules, RuleSet

Joint = tuple[tuple[int, Action], ...]
"""(car, action) pairs of one tick in acting order."""

MAX_DEPTH: Final = 1000
MAX_SEED: Final = 999_999_999
_KEYS: Final = ["rules", "helper_depth", "seed", "blueprint", "ticks"]
_NAMES: Final = [action.name for action in Action]


@dataclass
class Recording:
    """What is needed to play an episode again: its start, its rules and what the cars were told, in which order."""

    start: Grid
    rule_set: RuleSet
    helper_depth: int | None = None
    seed: int | None = None
    """What the start was drawn with; for the reader, since the start itself is recorded."""
    goal: Cell | None = None
    ticks: list[Joint] = field(default_factory=list)

    def add(self, actions: Sequence[int], order: Sequence[int]) -> None:
        """Record a tick: the action of each car, and the cars in the order in which they acted."""
        self.ticks.append(tuple((int(car), Action(actions[car])) for car in order))

    def text(self) -> str:
        """Return the recording as text."""
        blueprint = "".join(f"  {line}\n" for line in blueprint_text(self.start, self.goal).splitlines())
        ticks = "".join(
            f"  - {', '.join(f'{car} {action.name}' for car, action in tick)}\n" for tick in self.ticks
        )
        depth = "none" if self.helper_depth is None else self.helper_depth
        seed = "none" if self.seed is None else self.seed
        return (
            "# An episode: its start, and for each tick what each car was told, in the order in which they acted.\n"
            f"rules: {self.rule_set}\nhelper_depth: {depth}\nseed: {seed}\n"
            f"blueprint: |\n{blueprint}ticks:\n{ticks}"
        )

    def save(self, path: str | Path) -> None:
        """Write the recording into a file."""
        Path(path).write_text(self.text(), encoding="utf-8")

    def replay(self) -> Iterator[Grid]:
        """Yield the world after each tick."""
        rules, grid = Rules(self.rule_set), self.start
        if self.helper_depth is None:
            for tick in self.ticks:
                grid, _ = rules.tick(grid, tick)
                yield grid
            return
        planner, queue = Planner(rules, self.helper_depth), empty_queue(grid.n_cars, self.helper_depth)
        for tick in self.ticks:
            grid, queue, _ = planner.tick(grid, queue, tick)
            yield grid


def read_recording(path: str | Path) -> Recording:
    """Read a recorded episode; raise BlueprintError with file and line if it is wrong."""
    path = Path(path)
    source, keys = parse_keys(path, read_text(path), _KEYS)
    for key in _KEYS:
        if key not in keys.items:
            source.fail(None, f"key '{key}' is missing; required: {', '.join(_KEYS)}")
    rule_set: RuleSet = source.word(keys.items["rules"], "rules", list(get_args(RuleSet)))  # type: ignore[assignment]
    text = keys.items["blueprint"]
    if not isinstance(text, Scalar):
        source.fail(text.line, "key 'blueprint': must be the text of a blueprint")
    drawing = parse_blueprint(text.text, f"{path} (blueprint)")
    if not drawing.is_fixed:
        source.fail(
            text.line, "key 'blueprint': leaves something to chance; a recorded start lists everything"
        )

    def optional(key: str, high: int) -> int | None:
        node = keys.items[key]
        if isinstance(node, Scalar) and node.text == "none":
            return None
        return source.integer(node, key, 0, high)

    return Recording(
        start=drawing.grid(np.random.default_rng(0)),
        rule_set=rule_set,
        helper_depth=optional("helper_depth", MAX_DEPTH),
        seed=optional("seed", MAX_SEED),
        goal=drawing.goal,
        ticks=_ticks(source, keys.items["ticks"], drawing.n_cars),
    )


def _ticks(source: Source, node: object, n_cars: int) -> list[Joint]:
    if isinstance(node, Scalar) and node.text == "":
        return []
    if not isinstance(node, ListNode):
        source.fail(None, "key 'ticks': must be a list with one line a tick")
    ticks = []
    for item in node.items:
        if not isinstance(item, Scalar):
            source.fail(item.line, "key 'ticks': a tick is a line such as: 0 LIFT, 1 STOP")
        tick: list[tuple[int, Action]] = []
        for part in item.text.split(","):
            words = part.split()
            if len(words) != 2 or not words[0].isdecimal() or len(words[0]) > 6:
                source.fail(item.line, f"'{part.strip()[:40]}': must be a car's number and an action")
            if words[1] not in _NAMES:
                source.fail_unknown(item.line, words[1], _NAMES, "action")
            if int(words[0]) >= n_cars:
                source.fail(item.line, f"no car {int(words[0])}; there are cars 0 to {n_cars - 1}")
            tick.append((int(words[0]), Action[words[1]]))
        if len({car for car, _ in tick}) != len(tick):
            source.fail(item.line, "a car acts twice in one tick; allowed: once")
        ticks.append(tuple(tick))
    return ticks


def read_published_actions(path: str | Path, n_cars: int) -> list[Joint]:
    """Read the actions that CraftEnv's record mode writes: one row a tick, the n actions by car, then the order.

    Raises BlueprintError with file and line if it is wrong.
    """
    source = Source(Path(path))
    ticks = []
    for line, content in enumerate(read_text(Path(path)).splitlines(), start=1):
        words = content.split()
        if not words:
            continue
        numbers = [int(word) for word in words if word.isdecimal() and len(word) <= 6]
        if len(words) != 2 * n_cars or len(numbers) != len(words):
            source.fail(
                line, f"must be {2 * n_cars} whole numbers: an action for each car, then the cars in order"
            )
        actions, order = numbers[:n_cars], numbers[n_cars:]
        if max(actions, default=0) >= len(Action):
            source.fail(line, f"action {max(actions)} is unknown; allowed: 0 to {len(Action) - 1}")
        if sorted(order) != list(range(n_cars)):
            source.fail(line, f"the order must name each of the cars 0 to {n_cars - 1} once")
        ticks.append(tuple((car, Action(actions[car])) for car in order))
    return ticks

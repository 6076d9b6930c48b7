"""Learned rule sets: data that adds preconditions to another rule set, each a pattern of what is around a car.

``craftsim audit --learn`` writes them; docs/reference/learned-rules.md has the format. A pattern forbids its action
where the car is as it says, and each of the cells that it names has at least one of the things that it lists there.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple, get_args

import numpy as np
import pydantic_core
from pydantic import BeforeValidator, Field, ValidationInfo

from craftsim.compiled.jit import plain
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import Cell, Grid, cell_of
from craftsim.discrete.kernel import patterns as bits
from craftsim.discrete.kernel.state import NO_PATTERNS, CarState, Patterns
from craftsim.discrete.kinds import Correction, RuleSetName
from craftsim.errors import InputError, suggestion
from craftsim.storage.records import from_json, record, unknown_words
from craftsim.storage.yaml import quoted, read_document

Verb = Literal["MOVE", "LIFT", "DROP", "FOLD", "UNFOLD", "ROTATE_LEFT", "ROTATE_RIGHT"]
"""Actions of patterns: moves in all directions have patterns in common."""
MOST_RULES: Final = 512
_OWN_CELL: Final = (0, 0, 0, bits.THING_BITS)
"""The cell of a pattern that names none: there is always something in the own one, be it air."""
_frame_of: Final = plain(bits.frame_of)
_verb_of: Final = plain(bits.verb_of)
_MOST_CELLS: Final = 24
_DIRECTIONS: Final = ("ahead", "left", "back", "right")


def _words() -> dict[str, int]:
    """Return the bits of a cell by word; words without a direction stand for all four."""
    words = {"air": 1, "outside": 2, "ground": 4, "wall": 8}
    words["block"] = 1 << bits.BLOCK_BIT
    words["flag"] = 1 << bits.FLAG_BIT
    for noun, first in (
        ("fslope", bits.FSLOPE_BIT),
        ("body", bits.BODY_BIT),
        ("foot", bits.FOOT_BIT),
        ("gear", bits.GEAR_BIT),
        ("leaning-load", bits.LEAN_BIT),
    ):
        words[noun] = 15 << first
        for number, direction in enumerate(_DIRECTIONS):
            words[f"{noun}-{direction}"] = 1 << (first + number)
    for number, noun in enumerate(("car", "car+block", "car+fslope")):
        words[noun] = 1 << (bits.CAR_BIT + 2 * number)
        words[f"{noun}-on-ramp"] = 2 << (bits.CAR_BIT + 2 * number)
    return words


CELL_WORDS: Final = _words()
"""What a cell may have, in the words of files: bits of :mod:`craftsim.discrete.kernel.patterns`."""


CAR_PROPERTIES: Final[dict[str, tuple[str, ...]]] = {
    "load": ("none", "block", "flag", "fslope"),
    "stance": ("flat", "foot-up", "foot-down", "body-up", "body-down"),
    "level": ("floor", "above"),
    "heading": _DIRECTIONS,
}
"""Properties of the car, with their values in the order of its states: its load; flat or on a foot or above a body,
heading up or down; its level; and its heading, seen from the direction of a move."""


def _states() -> tuple[dict[str, str], ...]:
    """Return the properties of a car by the number of its state."""
    states = []
    for heading in CAR_PROPERTIES["heading"]:
        for level in CAR_PROPERTIES["level"]:
            for stance in CAR_PROPERTIES["stance"]:
                for load in CAR_PROPERTIES["load"]:
                    states.append(
                        {"load": load, "stance": stance, "level": level, "heading": heading}
                    )
    return tuple(states)


CAR_STATES: Final = _states()


def cell_words(cell: int) -> tuple[str, ...]:
    """Return the words for the bits of a cell, as few as there are."""
    words = []
    remaining = cell
    for word, bit in CELL_WORDS.items():
        if remaining & bit and bit & ~cell == 0:
            words.append(word)
            remaining &= ~bit
    return tuple(words)


@record()
class PatternCell:
    """A cell of a pattern, and what it has at least one of."""

    at: tuple[
        Annotated[int, Field(ge=-bits.REACH_CELLS, le=bits.REACH_CELLS)],
        Annotated[int, Field(ge=-bits.REACH_CELLS, le=bits.REACH_CELLS)],
        Annotated[int, Field(ge=bits.LOWEST, le=bits.HIGHEST)],
    ]
    """Cells ahead, to the left and up from the car."""
    has: Annotated[tuple[str, ...], Field(min_length=1, max_length=len(CELL_WORDS))]
    """Of CELL_WORDS."""

    def __post_init__(self) -> None:
        for word in self.has:
            if word not in CELL_WORDS:
                raise ValueError(unknown_words(word, CELL_WORDS, "thing"))

    @property
    def allowed(self) -> int:
        """The bits of these words."""
        allowed = 0
        for word in self.has:
            allowed |= CELL_WORDS[word]
        return allowed

    def __str__(self) -> str:
        return f"{' or '.join(self.has)} at {','.join(map(str, self.at))}"


@record()
class LearnedRule:
    """A pattern that forbids an action, and the trials that ask for it."""

    name: Annotated[str, Field(pattern="^[a-z0-9][a-z0-9_.-]{0,39}$")]
    action: Verb
    cells: Annotated[tuple[PatternCell, ...], Field(max_length=_MOST_CELLS)] = ()
    car: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Values that the pattern needs, by the names of CAR_PROPERTIES; what is not named may be anything."""
    sides: Literal["both", "one"] = "both"
    """Both where it holds for its mirror image, too."""
    trials: Annotated[int, Field(ge=0)] = 0
    """Trials in physics of actions that it forbids."""
    failures: Annotated[int, Field(ge=0)] = 0
    """Those that did not go as predicted."""
    like: str = ""
    """The correction of ``physical`` that forbids, or changes, most of these; empty for none."""

    def __post_init__(self) -> None:
        for name, values in self.car.items():
            if name not in CAR_PROPERTIES:
                raise ValueError(unknown_words(name, CAR_PROPERTIES, "property of a car"))
            allowed = CAR_PROPERTIES[name]
            for value in values:
                if value not in allowed:
                    raise ValueError(unknown_words(value, allowed, name))
            if not values:
                raise ValueError(f"'{name}' has no value; allowed: {', '.join(allowed)}")
        if self.failures > self.trials:
            raise ValueError(
                f"the pattern '{self.name}' has {self.failures} failures of {self.trials} trials; allowed: at most all"
            )
        if not self.cells and not self.car:
            raise ValueError(
                f"the pattern '{self.name}' names neither a cell nor the car: it would forbid every {self.action}"
            )

    @property
    def states(self) -> frozenset[int]:
        """The numbers of the car's states that the pattern matches."""
        numbers = set()
        for number, state in enumerate(CAR_STATES):
            if all(state[name] in values for name, values in self.car.items()):
                numbers.add(number)
        return frozenset(numbers)

    def __str__(self) -> str:
        """Return it in one line, such as ``MOVE, load block: leaning-load at 1,0,0``."""
        parts: list[str] = [self.action]
        for name, values in self.car.items():
            parts.append(f"{name} {' or '.join(values)}")
        text = ", ".join(parts)
        if not self.cells:
            return text
        return f"{text}: {'; '.join(map(str, self.cells))}"

    def __hash__(self) -> int:
        return hash((self.name, self.action, self.cells))


@record()
class RulesOrigin:
    """What a learned rule set was made with."""

    machines: str = ""
    """SHA-256 of the machines' parameters."""
    seed: Annotated[int, Field(ge=0)] = 0
    versions: dict[str, str] = field(default_factory=dict)
    actions: Annotated[int, Field(ge=0)] = 0
    """Actions tried in physics."""
    cpu_s: Annotated[float, Field(ge=0)] = 0.0


@record()
class LearnedRules:
    """A rule set with learned preconditions. Raises InputError for what is none.

    Example:
        >>> import craftsim
        >>> from craftsim.discrete.learned import LearnedRule, LearnedRules
        >>> no_turns = LearnedRule("no-loaded-turns", "ROTATE_LEFT", car={"load": ("block", "flag", "fslope")})
        >>> rules = craftsim.Rules(LearnedRules("my car", rules=(no_turns,)))
    """

    name: Annotated[str, Field(min_length=1, max_length=80)]
    base: RuleSetName = "published"
    """The rule set whose preconditions and effects hold, too."""
    corrections: tuple[str, ...] = ()
    """Corrections that hold beyond those of the base."""
    origin: RulesOrigin = RulesOrigin()
    rules: Annotated[tuple[LearnedRule, ...], Field(max_length=MOST_RULES)] = ()

    def __post_init__(self) -> None:
        for name in self.corrections:
            if name not in Correction.__members__:
                raise ValueError(unknown_words(name, Correction.__members__, "correction"))
        names = [rule.name for rule in self.rules]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two rules are called '{name}'; allowed: one")

    @cached_property
    def digest(self) -> str:
        """SHA-256 of what decides on legality, in hexadecimal."""
        parts = (self.base, sorted(self.corrections), [rule_content(rule) for rule in self.rules])
        return hashlib.sha256(repr(parts).encode()).hexdigest()

    def __hash__(self) -> int:
        return hash((self.name, self.digest))

    def __str__(self) -> str:
        return f"{self.name} ({len(self.rules)} learned on {self.base}, {self.digest[:8]})"

    @property
    def patterns(self) -> Patterns:
        """The patterns for compiled code."""
        return _compiled(self)


def rule_content(rule: LearnedRule) -> tuple[Any, ...]:
    """Return what of a rule decides on legality."""
    cells = sorted((cell.at, cell.allowed) for cell in rule.cells)
    return rule.action, sorted(rule.states), cells, rule.sides


class Variant(NamedTuple):
    """A pattern, or its mirror image, as numbers."""

    verb: int
    states: frozenset[int]
    """Numbers of the states that the car may have."""
    cells: tuple[tuple[int, int, int, int], ...]
    """Of each cell how far it is ahead, left and up, and the bits of which it has at least one."""
    number: int
    """Of the rule."""

    @property
    def mirror_image(self) -> Variant:
        """The same with left and right exchanged."""
        verb = _MIRROR_VERBS.get(self.verb, self.verb)
        cells = []
        for forward, aside, up, allowed in self.cells:
            cells.append((forward, -aside, up, mirror_of_cell(allowed)))
        states = frozenset(mirror_of_state(state) for state in self.states)
        return Variant(verb, states, tuple(sorted(cells, key=_rarest_first)), self.number)


_MIRROR_VERBS: Final = {5: 6, 6: 5}


def _rarest_first(cell: tuple[int, int, int, int]) -> tuple[bool, int, int, int]:
    """Return a sort key: cells that show other cars first, then those nearby."""
    forward, aside, up, allowed = cell
    return allowed & bits.THING_BITS != 0, abs(forward) + abs(aside) + abs(up), forward, aside


def variants(rule: LearnedRule, number: int = 0) -> tuple[Variant, ...]:
    """Return a rule as numbers: its pattern and, if that holds for it and is another one, its mirror image."""
    cells = [(*cell.at, cell.allowed) for cell in rule.cells]
    verb = bits.VERBS.index(rule.action)
    variant = Variant(verb, rule.states, tuple(sorted(cells, key=_rarest_first)), number)
    image = variant.mirror_image
    if rule.sides == "one" or image == variant:
        return (variant,)
    return variant, image


@lru_cache(maxsize=64)
def _compiled(rules: LearnedRules) -> Patterns:
    """Return the patterns as :mod:`craftsim.discrete.kernel.patterns` lays them out."""
    if not rules.rules:
        return NO_PATTERNS
    chosen: list[Variant] = []
    for number, rule in enumerate(rules.rules):
        chosen += variants(rule, number)
    n_lists = len(bits.VERBS) * bits.N_OWN
    table: list[int] = []
    rows: list[int] = []
    places: dict[tuple[int, ...], tuple[int, int]] = {}
    for verb in range(len(bits.VERBS)):
        for state in range(bits.N_OWN):
            listed = []
            for place, variant in enumerate(chosen):
                if variant.verb == verb and state in variant.states:
                    listed.append(place)
            key = tuple(listed)
            if key not in places:
                begin = 2 * n_lists + len(rows)
                rows += _entries([chosen[place] for place in listed])
                places[key] = begin, 2 * n_lists + len(rows)
            table += places[key]
    return np.array(table + rows, np.int64)


def _entries(listed: Sequence[Variant]) -> list[int]:
    """Return the numbers of a list of patterns, grouped by their first cells."""
    groups: dict[tuple[int, int, int], list[Variant]] = {}
    for variant in listed:
        first = _OWN_CELL
        if variant.cells:
            first = variant.cells[0]
        groups.setdefault(first[:3], []).append(variant)
    entries: list[int] = []
    for at, grouped in groups.items():
        looked_for = 0
        rows: list[int] = []
        for variant in grouped:
            first, *others = variant.cells or (_OWN_CELL,)
            looked_for |= first[3]
            rows += [variant.number, first[3], len(others)]
            for cell in others:
                rows += cell
        entries += [*at, looked_for, bits.GROUP_HEAD + len(rows), *rows]
    return entries


def mirror_of_cell(word: int) -> int:
    """Return the bits of a cell's mirror image: left and right exchanged."""
    for first in (
        bits.FSLOPE_BIT,
        bits.BODY_BIT,
        bits.FOOT_BIT,
        bits.GEAR_BIT,
        bits.LEAN_BIT,
    ):
        on_left = word >> (first + 1) & 1
        on_right = word >> (first + 3) & 1
        word &= ~(5 << (first + 1))
        word |= on_right << (first + 1) | on_left << (first + 3)
    return word


def mirror_of_state(state: int) -> int:
    """Return the number of the mirror image of a car's state."""
    per_heading = bits.N_OWN // 4
    heading = state // per_heading
    return -heading % 4 * per_heading + state % per_heading


def pattern_cells(grid: Grid, rule: LearnedRule, car: int, action: int) -> tuple[Cell, ...]:
    """Return the cells of a world that a rule which forbids an action of a car looks at."""
    state = CarState(*grid.cars[car].tolist())
    world = grid.world()
    frame = _frame_of(state, int(action))
    dx, dy = DIRECTIONS[frame].tolist()
    for variant in variants(rule):
        matches = variant.verb == _verb_of(int(action))
        cells = [cell_of(grid, car)]
        for forward, aside, up, allowed in variant.cells:
            x = state.x + forward * dx - aside * dy
            y = state.y + forward * dy + aside * dx
            place = (x, y, state.z + up)
            cells.append(place)
            matches = matches and bits.cell_bits(world, car, *place, frame) & allowed != 0
        if matches:
            return tuple(dict.fromkeys(cells))
    return (cell_of(grid, car),)


def read_rules(path: Path) -> LearnedRules:
    """Return the learned rule set in a YAML file. Raises InputError, with file, line and key, for one that is none."""
    return read_document(path).to(LearnedRules)


def rules_text(rules: LearnedRules) -> str:
    """Return a learned rule set as a YAML file has it."""
    lines = [f"name: {quoted(rules.name)}", f"base: {rules.base}"]
    if rules.corrections:
        lines.append(f"corrections: [{', '.join(rules.corrections)}]")
    lines.append("origin:")
    for key, value in asdict(rules.origin).items():
        if isinstance(value, Mapping):
            if value:
                words = ", ".join(f"{quoted(name)}: {quoted(text)}" for name, text in value.items())
                lines.append(f"  {key}: {{{words}}}")
        elif isinstance(value, str):
            lines.append(f"  {key}: {quoted(value)}")
        else:
            lines.append(f"  {key}: {value}")
    if not rules.rules:
        lines.append("rules: []")
    else:
        lines.append("rules:")
    for rule in rules.rules:
        lines += _rule_lines(rule)
    return "\n".join(lines) + "\n"


def _rule_lines(rule: LearnedRule) -> list[str]:
    lines = [f"  - name: {quoted(rule.name)}", f"    action: {rule.action}"]
    if rule.car:
        values = ", ".join(f"{name}: [{', '.join(words)}]" for name, words in rule.car.items())
        lines.append(f"    car: {{{values}}}")
    if rule.cells:
        lines.append("    cells:")
        for cell in rule.cells:
            at = ", ".join(map(str, cell.at))
            lines.append(f"      - {{at: [{at}], has: [{', '.join(cell.has)}]}}")
    if rule.sides != "both":
        lines.append(f"    sides: {rule.sides}")
    lines.append(f"    trials: {rule.trials}")
    lines.append(f"    failures: {rule.failures}")
    if rule.like:
        lines.append(f"    like: {quoted(rule.like)}")
    return lines


def as_rule_set(rules: Any) -> Any:
    """Return a rule set that is given by its name, by a YAML file or by itself.

    Raises InputError for a name that is none, and for an invalid file.
    """
    if isinstance(rules, Path):
        return read_rules(rules)
    if isinstance(rules, dict):
        # As JSON, where a list stands for a tuple.
        try:
            content = pydantic_core.to_json(rules)
        except ValueError as error:
            raise InputError(
                f"learned rules: {error}; allowed: texts, numbers, lists and mappings, as in a file of rules"
            ) from None
        return from_json(LearnedRules, content, "learned rules")
    if not isinstance(rules, str) or rules in get_args(RuleSetName):
        return rules
    if Path(rules).suffix in (".yaml", ".yml"):
        return read_rules(Path(rules))
    names = get_args(RuleSetName)
    raise InputError(
        f"unknown rule set '{rules}'; there are {', '.join(names)}{suggestion(rules, names)}, "
        "or give a YAML file of learned rules"
    )


def _of_record(rules: Any, info: ValidationInfo) -> Any:
    """Return the same for a field of a record; ValueError, to which a record adds the field's name.

    A record that is read from a file holds learned rules whole, and opens no file that it names.
    """
    names = get_args(RuleSetName)
    if info.mode == "json" and isinstance(rules, str) and rules not in names:
        raise ValueError(
            f"unknown rule set '{rules}'; there are {', '.join(names)}, or learned rules"
        )
    try:
        return as_rule_set(rules)
    except InputError as error:
        raise ValueError(str(error)) from error


RuleSet = Annotated[RuleSetName | LearnedRules, BeforeValidator(_of_record)]
"""CraftEnv's own rules, the corrected ones, or learned ones; files name them by a path."""

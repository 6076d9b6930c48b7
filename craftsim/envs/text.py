"""The text form: a task for a language model, or anyone who reads the world and answers in words."""

from __future__ import annotations

import re
import string
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import compress
from typing import Any, Final, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from craftsim.discrete.actions import ACTIONS, action_names
from craftsim.discrete.drawing import ARROWS, LEGEND, world_text
from craftsim.discrete.grid import SECOND_PART, CarField, Grid, Kind, Piece, beside, cell_of
from craftsim.discrete.kinds import NAMES, Action
from craftsim.discrete.readback import HEADING_NAMES
from craftsim.discrete.rules import Rules
from craftsim.envs.options import Options
from craftsim.envs.single_world import SingleWorld
from craftsim.errors import InputError, suggestion
from craftsim.tasks import Task

ANSWER_MARK: Final = "ANSWER:"
"""What stands before the last one of these is thought aloud, and not read."""
_FORM: Final = "car_0: lift; car_1: move forward"
"""An answer, for messages and instructions."""
_MAX_ANSWER: Final = 100_000
"""Characters of an answer."""

_SHOWN: Final = 60
_PART: Final = re.compile(r"(?:car[ _]?)?([0-9]{1,4})\s*:\s*(.+)", re.IGNORECASE)
FORBIDDEN: Final = "forbidden"
_DONE: Final = ("as predicted", "as predicted, retried")
_CHARACTERS: Final = frozenset(string.printable + ARROWS)
_MAX_TEXT: Final = 1_000_000
_SECOND: Final = tuple(SECOND_PART.values())

INSTRUCTIONS: Final = f"""\
You steer {{n_cars}} cars that build together in an area of {{length}} x {{width}} cells, {{height}} levels high.
A cell is (x, y, z): in the drawings x goes to the right and y up; z = 1 is the floor. Signs of the drawings:
{LEGEND}

Goal: {{goal}}

In each tick every car does one action; there are {{ticks}} ticks. The cars act one after the other, in an order that is
drawn anew for each tick. What the rules forbid when a car's turn comes is not done. The actions:
  lift: take up the block, flag or folded slope in the car's own cell, which the car is under
  drop: put the load down into the car's own cell
  unfold, fold: turn the slope in the car's own cell into a ramp, or back; its foot comes to lie in the next cell
  rotate left, rotate right: turn by 90 degrees on the spot, counterclockwise or clockwise
  move right (+x), move forward (+y), move left (-x), move back (-y): to the next cell, whatever the car's heading
  stop: do nothing
A car without a load can be in one cell with a block, a flag or a slope, below it; a car with a load cannot. A car
enters and leaves a block or a flag along its heading only. A ramp leads from its foot up over its body to the
level above it; cars drive up and down on it, with or without a load, facing the way they move, and do nothing else
there. Blocks bear cars, blocks and slopes.

Answer with one line such as: {_FORM}
A car that you do not name stops. What stands before the last "{ANSWER_MARK}" is not read."""


def action_words(action: int) -> str:
    """Return what an action is called in answers, ``move forward`` for instance."""
    return Action(action).name.lower().replace("_", " ")


def offered() -> tuple[str, ...]:
    """Return the actions that can be legal, in words."""
    return tuple(
        action_words(action) for action, spec in ACTIONS.items() if spec.performed or spec.legality
    )


def answer_text(actions: Mapping[str, Any]) -> str:
    """Return the answer that says these actions, numbers by agent; :func:`read_answer` reads it.

    Example:
        >>> answer_text({"car_0": 0, "car_1": 6})
        'car_0: lift; car_1: move forward'
    """
    return "; ".join(f"{agent}: {action_words(action)}" for agent, action in actions.items())


def read_answer(text: str, n_cars: int) -> list[Action]:
    """Return the action of each car that an answer names; a car that it does not name stops.

    An answer has ``car: action`` for some cars, divided by semicolons or lines; only what follows the last ``ANSWER:``,
    if there is one, is read. Case does not matter, nor whether words are joined by blanks or underscores.

    Raises InputError for a text without an action, an unknown car or action, and a car that is named twice.

    Example:
        >>> [action.name for action in read_answer("Clear the way first. ANSWER: car_1: MOVE_LEFT", 2)]
        ['STOP', 'MOVE_LEFT']
    """
    if not isinstance(text, str):
        raise InputError(f"an answer is a text such as '{_FORM}', not a {type(text).__name__}")
    if len(text) > _MAX_ANSWER:
        raise InputError(f"the answer has {len(text)} characters; allowed: {_MAX_ANSWER}")
    answer = text.rpartition(ANSWER_MARK)[2]
    actions: dict[int, Action] = {}
    for line in re.split(r"[;\n]", answer):
        clause = line.strip(" \t.`*")
        if not clause:
            continue
        match = _PART.fullmatch(clause)
        if match is None:
            raise InputError(
                f"'{clause[:_SHOWN]}' is no 'car: action'; an answer is such as '{_FORM}'"
            )
        car = int(match[1])
        if car >= n_cars:
            cars = ", ".join(f"car_{number}" for number in range(n_cars))
            raise InputError(f"there is no car_{car}; the cars are {cars}")
        if car in actions:
            raise InputError(f"car_{car} is named twice; in a tick each car does one action")
        actions[car] = _action(match[2])
    if not actions:
        raise InputError(f"the answer names no action; it should be such as '{_FORM}'")
    return [actions.get(car, Action.STOP) for car in range(n_cars)]


def _action(words: str) -> Action:
    name = re.sub(r"[\s_]+", "_", words.strip()).upper()
    if name not in action_names():
        hint = suggestion(words[:_SHOWN].lower(), offered())
        raise InputError(
            f"unknown action '{words[:_SHOWN]}'{hint}; there are {', '.join(offered())}"
        )
    return Action[name]


def goal_text(task: Task) -> str:
    """Return what is to be reached, in words, each part of a design with its cell."""
    if task.design is not None:
        parts = "\n".join(f"  {_target(target)}" for target in task.design.targets)
        return f"these cells hold this, put down and not carried:\n{parts}"
    match task.success:
        case "flag_at_goal":
            return f"the flag is at {task.layout.goal}."
        case "one_platform":
            return "all blocks are side by side on one level, and so form one platform."
        case "three_high":
            blocks = "three blocks stand on one another, the lowest on the floor"
            return f"{blocks}; ramps on blocks are rewarded, too."
        case "built":
            return "the design of the episode stands."
        case str(name):
            raise ValueError(f"the goal '{name}' has no words")
    return f"what the task '{task.name}' rewards."


def world_words(grid: Grid, task: Task) -> str:
    """Return a world as a drawing and as a list of things, and how much of the design stands."""
    goal = None
    if task.design is None:
        goal = task.layout.goal
    drawing = "\n".join(line.rstrip() for line in world_text(grid, goal).plain.splitlines())
    lines = [drawing, "Things:", *(f"  {line}" for line in _things(grid))]
    if task.design is not None:
        hits = list(task.design.hits(grid))
        lines.append(
            f"Design: {sum(hit for _, hit in hits)} of {len(hits)} cells as they should be"
        )
        lines += [f"  missing: {_target(target)}" for target, hit in hits if not hit]
    return "\n".join(lines)


def _target(target: Piece) -> str:
    slope = target.kind in (Kind.BODY, Kind.FOOT)
    return f"{NAMES[target.kind]} at {target.cell}" + (
        f", downhill {HEADING_NAMES[target.yaw]}" if slope else ""
    )


def _things(grid: Grid) -> Iterator[str]:
    for car in range(grid.n_cars):
        yield f"car_{car} {_car(grid, car)}"
    for x, y, z in np.argwhere(grid.kind[:, :, 1:] != Kind.AIR).tolist():
        cell = x, y, z + 1
        kind = grid.kind_at(cell)
        yaw = int(grid.yaw[cell])
        if kind in _SECOND:
            continue
        words = f"{NAMES[kind]} at {cell}"
        if kind == Kind.BODY:
            words = f"a ramp: body at {cell}, foot at {beside(cell, yaw)}, downhill {HEADING_NAMES[yaw]}"
        elif kind == Kind.FSLOPE:
            words += f", its gear at {beside(cell, yaw)}; unfolded there it leads downhill {HEADING_NAMES[yaw]}"
        yield words


def _car(grid: Grid, car: int) -> str:
    row = grid.cars[car].tolist()
    words = f"at {cell_of(grid, car)}, facing {HEADING_NAMES[row[CarField.YAW]]}"
    load = Kind(row[CarField.LOAD])
    if load != Kind.AIR:
        gear = ""
        if load == Kind.FSLOPE:
            gear = f" (gear {HEADING_NAMES[row[CarField.LOAD_YAW]]})"
        words += f", with {NAMES[load]}{gear}"
    return words + (", on a ramp" if row[CarField.SLOPE] else "")


def legal_words(grid: Grid, masks: NDArray[np.int8], rules: Rules) -> str:
    """Return what each car may do now, with where that leads, a line a car; ``masks`` (n, 15) as they are offered."""
    lines = []
    for car, mask in enumerate(masks):
        options = []
        for action in compress(rules.actions, mask):
            options.append(action_words(action) + _effect(grid, rules, car, action))
        lines.append(f"  car_{car}: {'; '.join(options)}")
    return "\n".join(lines)


def _effect(grid: Grid, rules: Rules, car: int, action: Action) -> str:
    """Return what an action leads to, in brackets; nothing where that goes without saying."""
    after = rules.apply(grid, car, action)
    old = grid.cars[car].tolist()
    new = after.cars[car].tolist()
    if action in (Action.LIFT, Action.DROP):
        load = Kind(max(old[CarField.LOAD], new[CarField.LOAD]))
        return f" ({NAMES[load]})"
    if cell_of(grid, car) != cell_of(after, car):
        return f" (to {cell_of(after, car)})"
    if old[CarField.YAW] != new[CarField.YAW]:
        return f" (to face {HEADING_NAMES[new[CarField.YAW]]})"
    if action == Action.UNFOLD:
        cell = cell_of(grid, car)
        return f" (the foot to {beside(cell, int(grid.yaw[cell]))})"
    return ""


@dataclass(frozen=True)
class Feedback:
    """What became of the action of one car in words; ``str()`` gives it in one line.

    Not an Attempt: on the grid there is none, and a choice that the rules forbid is an answer like others.
    """

    car: int
    action: Action  # what was asked for
    result: str  # ``forbidden``, or what the judge says of it, of which the grid knows ``as predicted`` only
    why: str = (
        ""  # why it did not go as predicted: the rule that forbids it, or what happened physically
    )

    @property
    def done(self) -> bool:
        """Whether it did what the rules predict, and nothing else."""
        return self.result in _DONE

    def __str__(self) -> str:
        result = "done"
        if not self.done:
            result = f"{self.result}: {self.why}"
        return f"car_{self.car}: {action_words(self.action)}: {result}"


class TextConstruction(SingleWorld, gymnasium.Env[str, str]):
    """A task whose observations and actions are texts, on either backend.

    ``instructions`` says what one must know beforehand. Nothing is asked of any service: send the texts to whatever
    answers, and hand its answer to :meth:`step`.

    Example:
        >>> from craftsim.envs.text import TextConstruction
        >>> env = TextConstruction("strip", backend="grid")
        >>> text, info = env.reset(seed=0)
        >>> text, reward, terminated, truncated, info = env.step("car_0: lift; car_1: move right")
        >>> print(info["feedback"][0])
        car_0: lift: forbidden: there is nothing to lift in (1, 1, 1)
    """

    def __init__(self, task: Task | str, render_mode: Any = None, **options: Any) -> None:
        """Prepare a task; ``options`` are the fields of :class:`craftsim.envs.options.Options`.

        ``observe``, ``images`` and ``helper_depth`` are none of them: texts are observed, and an answer is what is done
        now. Raises InputError for a task, an option or an option value that there is not.
        """
        chosen = Options(render_mode=render_mode, **options)
        for name in ("observe", "images", "helper_depth", "local_view", "execution"):
            if getattr(chosen, name) not in (None, "synchronous"):
                raise InputError(f"the text form knows no '{name}'; leave it out")
        super().__init__(task, chosen)
        self.observation_space = spaces.Text(_MAX_TEXT, charset=_CHARACTERS)
        self.action_space = spaces.Text(_MAX_ANSWER, charset=_CHARACTERS)
        played = self.core.task
        length, width, height = played.starts[0].size
        self._ticks = played.max_steps + 2  # docs/rules.md#episode-length
        self.instructions = INSTRUCTIONS.format(
            n_cars=self.core.n_cars,
            length=length,
            width=width,
            height=height,
            goal=goal_text(played),
            ticks=self._ticks,
        )
        """What one who steers the cars must know: the area, the goal, the actions, and how to answer."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[str, dict[str, Any]]:
        """Begin an episode; see :meth:`craftsim.envs.core.Core.reset` for the options."""
        self.core.reset(seed, options)
        super().reset(seed=seed)
        self._text = self._seen()
        return self._text, {}

    def step(self, action: str) -> tuple[str, float, bool, bool, dict[str, Any]]:
        """Let the cars do what an answer says (:func:`read_answer`).

        ``info`` has ``feedback``, a :class:`Feedback` by car, and ``success``, ``duration_s`` and ``problems`` as the
        other forms have them. Raises InputError where no episode runs, and for an answer that cannot be read; then
        nothing has happened, and the message says what to answer instead.
        """
        self.core.require_episode()
        chosen = read_answer(action, self.core.n_cars)
        before = self.core.grid
        offered = self.core.rules.actions
        for car_action in chosen:
            if car_action not in offered:
                raise InputError(
                    f"the action '{action_words(car_action)}' is not offered here; name it in 'actions'"
                )
        reward, terminated, truncated, infos = self.core.step(
            [offered.index(car_action) for car_action in chosen]
        )
        feedback = self._feedback(before, chosen, infos)
        shared = infos[0]
        lines = ["What happened:", *(f"  {line}" for line in feedback)]
        if shared["problems"]:
            lines.append(f"The world cannot be read any more: {'; '.join(shared['problems'])}.")
        over = terminated or truncated
        if shared["success"]:
            lines.append("The goal is reached.")
        elif over:
            lines.append("The episode is over; the goal is not reached.")
        text = "\n".join([*lines, "", self._seen(not over)])
        self._text = text
        info = {key: shared[key] for key in ("success", "duration_s", "problems")}
        return text, reward, terminated, truncated, info | {"feedback": feedback}

    def turn(self, answer: str) -> tuple[Exchange, str, float, bool, dict[str, Any]]:
        """Let the cars do what an answer says; for one that cannot be read they stop, which costs the tick.

        Returns the exchange, the next text, which then begins with what was wrong, the reward, whether the episode is
        over, and the info of :meth:`step`. Raises InputError where no episode runs.
        """
        self.core.require_episode()
        before = self._text
        wrong = ""
        try:
            text, reward, terminated, truncated, info = self.step(answer)
        except InputError as error:
            wrong = str(error)
            nothing = answer_text({f"car_{car}": Action.STOP for car in range(self.core.n_cars)})
            text, reward, terminated, truncated, info = self.step(nothing)
            text = f"Your answer could not be read, and all cars stopped: {wrong}\n{text}"
            self._text = text
        exchange = Exchange(before, answer, wrong, info["feedback"])
        return exchange, text, reward, terminated or truncated, info

    def _seen(self, may_act: bool = True) -> str:
        task = self.core.task
        grid = self.core.grid
        lines = [f"After tick {self.core.episodes.t[0]} of {self._ticks}", world_words(grid, task)]
        if may_act:
            lines += ["Legal actions:", legal_words(grid, self.core.masks, self.core.rules)]
        return "\n".join(lines)

    def _feedback(
        self, grid: Grid, chosen: list[Action], infos: list[dict[str, Any]]
    ) -> tuple[Feedback, ...]:
        """Return what became of each car's action, which was chosen in the world ``grid``."""
        feedback: dict[int, Feedback] = {}
        for car in self.core.order.tolist():
            action = chosen[car]
            info = infos[car]
            reason = info.get("reason", "").removeprefix("the rules forbid it: ")
            result = FORBIDDEN
            if info["illegal"]:
                if "reason" not in info:
                    reason = self.core.rules.explain(grid, car, action).why
            else:
                result = info.get("result", _DONE[0])
                grid = self.core.rules.apply(grid, car, action)
            feedback[car] = Feedback(car, action, result, reason)
        return tuple(feedback[car] for car in range(len(chosen)))


AnswerFunction = Callable[[str, str], str]
"""From the instructions and the last text to an answer."""


class Exchange(NamedTuple):
    """A text, what was answered, and what became of it."""

    text: str
    answer: str
    unreadable: (
        str  # why the answer could not be read, so that all cars stopped; empty where it could
    )
    feedback: tuple[Feedback, ...]


@dataclass(frozen=True)
class Conversation:
    """An episode in words."""

    turns: tuple[Exchange, ...]  # one a tick
    success: bool
    total_reward: float
    duration_s: float  # simulated time

    @property
    def unreadable(self) -> int:
        """Answers that could not be read."""
        return sum(bool(turn.unreadable) for turn in self.turns)

    @property
    def forbidden(self) -> int:
        """Actions that the rules forbade."""
        total = 0
        for turn in self.turns:
            for feedback in turn.feedback:
                total += feedback.result == FORBIDDEN
        return total

    @property
    def failed(self) -> int:
        """Actions that the rules allow and that did not go as predicted; on the grid there are none."""
        total = 0
        for turn in self.turns:
            for feedback in turn.feedback:
                total += not feedback.done and feedback.result != FORBIDDEN
        return total


def converse(
    env: TextConstruction, answer: AnswerFunction, seed: int | None = None
) -> Conversation:
    """Play an episode with whoever answers.

    Every text is answered once. An answer that cannot be read costs the tick: all cars stop, and the next text begins
    with what was wrong.

    Args:
        env: runs the episode.
        answer: gets the instructions, always the same, and the last text.
        seed: of the episode; the environment's generators go on unless given.
    """
    text, _ = env.reset(seed=seed)
    turns = []
    total = 0.0
    duration_s = 0.0
    over = False
    success = False
    while not over:
        reply = answer(env.instructions, text)
        exchange, text, reward, over, info = env.turn(reply)
        turns.append(exchange)
        total = total + reward
        duration_s = duration_s + info["duration_s"]
        success = info["success"]
    return Conversation(tuple(turns), success, total, duration_s)

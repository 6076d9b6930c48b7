"""The text form: a task for a language model, or anyone who reads the world and answers in words."""

from __future__ import annotations

import string
from dataclasses import dataclass
from typing import Any, Final

import gymnasium
from gymnasium import spaces

from craftsim.discrete.drawing import ARROWS
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.tasks import Task
from craftsim.envs.answers import MAX_ANSWER, read_answer, words_of
from craftsim.envs.core import Core, CoreStep
from craftsim.envs.descriptions import instructions, legal_words, ticks_of, world_words
from craftsim.envs.options import RENDER_FPS, RENDER_MODES, Options
from craftsim.errors import InputError

FORBIDDEN: Final = "forbidden"
_DONE: Final = "as predicted"
_CHARACTERS: Final = frozenset(string.printable + ARROWS)
_MAX_TEXT: Final = 1_000_000


@dataclass(frozen=True)
class Feedback:
    """What became of the action of one car; ``str()`` gives it in one line."""

    car: int
    action: Action
    """What was asked for."""
    result: str
    """``forbidden``, or what the judge says of it: ``as predicted``, ``failed``, ``side effect``, ``unsafe`` or
    ``numerics``, of which the grid knows the first only."""
    why: str = ""
    """Why it did not go as predicted: the rule that forbids it, or what happened physically."""

    @property
    def done(self) -> bool:
        """Whether it did what the rules predict, and nothing else."""
        return self.result == _DONE

    def __str__(self) -> str:
        result = "done" if self.done else f"{self.result}: {self.why}"
        return f"car_{self.car}: {words_of(self.action)}: {result}"


class TextConstruction(gymnasium.Env[str, str]):
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

    metadata: dict[str, Any] = {  # noqa: RUF012 (as Gymnasium declares it)
        "render_modes": list(RENDER_MODES),
        "render_fps": RENDER_FPS,
    }

    def __init__(self, task: Task | str, render_mode: Any = None, **options: Any) -> None:
        """Prepare a task; ``options`` are the fields of :class:`craftsim.envs.options.Options`.

        ``observe``, ``images`` and ``helper_depth`` are none of them: texts are observed, and an answer is what is done
        now. Raises InputError for a task, an option or an option value that there is not.
        """
        for name in ("observe", "images", "helper_depth"):
            if options.get(name) is not None:
                raise InputError(f"the text form knows no '{name}'; leave it out")
        chosen = Options.named(render_mode=render_mode, **options)
        self.core = Core(task, chosen)
        self.metadata = type(self).metadata | {"render_fps": chosen.render_fps}
        self.render_mode = render_mode
        self.observation_space = spaces.Text(_MAX_TEXT, charset=_CHARACTERS)
        self.action_space = spaces.Text(MAX_ANSWER, charset=_CHARACTERS)
        self.instructions = instructions(self.core.task)
        """What one who steers the cars must know: the area, the goal, the actions, and how to answer."""

    @property
    def grid(self) -> Grid:
        """A copy of the world as it is seen."""
        return self.core.grid

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[str, dict[str, Any]]:
        """Begin an episode; see :meth:`craftsim.envs.core.Core.reset` for the options."""
        super().reset(seed=seed)
        self.core.reset(seed, options)
        self._tick = 0
        return self._seen(), {}

    def step(self, action: str) -> tuple[str, float, bool, bool, dict[str, Any]]:
        """Let the cars do what an answer says (:func:`craftsim.envs.answers.read_answer`).

        ``info`` has ``feedback``, a :class:`Feedback` by car, and ``success``, ``duration_s`` and ``problems`` as the
        other forms have them. Raises InputError where no episode runs, and for an answer that cannot be read; then
        nothing has happened, and the message says what to answer instead.
        """
        self.core.require_episode()
        chosen = read_answer(action, self.core.n_cars)
        before = self.core.grid
        offered = self.core.rules.actions
        for one in chosen:
            if one not in offered:
                raise InputError(f"the action '{words_of(one)}' is not offered here; name it in 'actions'")
        result = self.core.step([offered.index(one) for one in chosen])
        self._tick += 1
        feedback = self._feedback(before, chosen, result)
        shared = result.infos[0]
        told = ["What happened:", *(f"  {line}" for line in feedback)]
        if shared["problems"]:
            told.append(f"The world cannot be read any more: {'; '.join(shared['problems'])}.")
        over = result.terminated or result.truncated
        if shared["success"]:
            told.append("The goal is reached.")
        elif over:
            told.append("The episode is over; the goal is not reached.")
        text = "\n".join([*told, "", self._seen(not over)])
        info = {key: shared[key] for key in ("success", "duration_s", "problems")}
        return text, result.reward, result.terminated, result.truncated, info | {"feedback": feedback}

    def _seen(self, may_act: bool = True) -> str:
        task, grid = self.core.task, self.core.grid
        lines = [f"After tick {self._tick} of {ticks_of(task)}", world_words(grid, task)]
        if may_act:
            lines += ["Legal actions:", legal_words(grid, self.core.masks, self.core.rules)]
        return "\n".join(lines)

    def _feedback(self, grid: Grid, chosen: list[Action], result: CoreStep) -> tuple[Feedback, ...]:
        """Return what became of each car's action, which was chosen in the world ``grid``."""
        told: dict[int, Feedback] = {}
        for car in result.order.tolist():
            action, info = chosen[car], result.infos[car]
            why = info.get("reason", "").removeprefix("the rules forbid it: ")
            if not info["illegal"]:
                told[car] = Feedback(car, action, info.get("result", _DONE), why)
                grid = self.core.rules.apply(grid, car, action)
                continue
            if "reason" not in info:
                why = self.core.rules.explain(grid, car, action).why
            told[car] = Feedback(car, action, FORBIDDEN, why)
        return tuple(told[car] for car in range(len(chosen)))

    def render(self) -> Any:
        """Return a picture (``rgb_array``), all since the last call (``rgb_array_list``) or text (``ansi``)."""
        return self.core.render()

    def close(self) -> None:
        """Release what rendering holds."""
        self.core.close()

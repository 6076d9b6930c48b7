"""An episode of the text form with whoever answers, and its figures: how language models are compared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from craftsim.discrete.kinds import Action
from craftsim.envs.answers import answer_text
from craftsim.envs.text import FORBIDDEN, Feedback, TextConstruction
from craftsim.errors import InputError

Answer = Callable[[str, str], str]
"""From the instructions and the last text to an answer."""


@dataclass(frozen=True)
class Exchange:
    """A text, what was answered, and what became of it."""

    text: str
    answer: str
    unreadable: str
    """Why the answer could not be read, so that all cars stopped; empty where it could."""
    feedback: tuple[Feedback, ...]


@dataclass(frozen=True)
class Conversation:
    """An episode in words."""

    turns: tuple[Exchange, ...]
    """One a tick."""
    success: bool
    total_reward: float
    duration_s: float
    """Simulated time."""

    @property
    def unreadable(self) -> int:
        """Answers that could not be read."""
        return sum(bool(turn.unreadable) for turn in self.turns)

    @property
    def forbidden(self) -> int:
        """Actions that the rules forbade."""
        return sum(one.result == FORBIDDEN for turn in self.turns for one in turn.feedback)

    @property
    def failed(self) -> int:
        """Actions that the rules allow and that did not go as predicted; on the grid there are none."""
        return sum(not one.done and one.result != FORBIDDEN for turn in self.turns for one in turn.feedback)


def converse(env: TextConstruction, answer: Answer, seed: int | None = None) -> Conversation:
    """Play an episode with whoever answers.

    Every text is answered once. An answer that cannot be read costs the tick: all cars stop, and the next text begins
    with what was wrong.

    Args:
        env: runs the episode.
        answer: gets the instructions, always the same, and the last text.
        seed: of the episode; the environment's generators go on unless given.
    """
    text, _ = env.reset(seed=seed)
    nothing = answer_text({f"car_{car}": Action.STOP for car in range(env.core.n_cars)})
    turns, total, duration_s, over, success = [], 0.0, 0.0, False, False
    while not over:
        said, wrong = answer(env.instructions, text), ""
        try:
            after, reward, terminated, truncated, info = env.step(said)
        except InputError as error:
            wrong = str(error)
            after, reward, terminated, truncated, info = env.step(nothing)
            after = f"Your answer could not be read, and all cars stopped: {wrong}\n{after}"
        turns.append(Exchange(text, said, wrong, info["feedback"]))
        total, duration_s = total + reward, duration_s + info["duration_s"]
        text, over, success = after, terminated or truncated, info["success"]
    return Conversation(tuple(turns), success, total, duration_s)

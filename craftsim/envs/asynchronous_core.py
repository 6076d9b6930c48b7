"""Asynchronous execution: each car decides when its own action has ended."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.events import DECIDES, Ends
from craftsim.discrete.kinds import MOVE_DIRECTION, Action
from craftsim.envs.actions import checked_actions
from craftsim.envs.core import Core, CoreStep, info_of
from craftsim.errors import InputError
from craftsim.tasks.asynchronous import BEGUN, BLOCKED, ILLEGAL, WAITS, AsynchronousEpisodes

if TYPE_CHECKING:
    from craftsim.checking.attempt import Attempt

_STOP = int(Action.STOP)


class AsynchronousCore(Core):
    """A task whose cars do not wait for each other.

    :attr:`turns` lists the cars that decide, in their order; each decides with :meth:`begin`, and when all have,
    :meth:`advance` runs to the next event, at which at least one action or wait ends.
    """

    @property
    def episodes(self) -> AsynchronousEpisodes:
        """The episode, a batch of one, whose ``grids`` are the committed world."""
        episodes = super().episodes
        assert isinstance(episodes, AsynchronousEpisodes)
        return episodes

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> list[dict[str, Any]]:
        """Begin an episode as :meth:`Core.reset` does; all cars decide."""
        super().reset(seed, options)
        self._zero_s = self.backend.advance(0.0).time_s
        self._wrong = np.zeros(self.n_cars, np.bool_)
        self._found: list[dict[str, Any]] = [{} for _ in range(self.n_cars)]
        self._refused: dict[int, Attempt | None] = {}
        self._take_turns()
        shared = {"success": False, "duration_s": 0.0, "problems": (), "deadlock": None}
        return self._infos(shared, *np.zeros((2, self.n_cars), np.bool_))

    def _take_turns(self) -> None:
        doing = self.episodes.running.action[0].tolist()
        self.turns = [
            car for car in self._rng.permutation(self.n_cars).tolist() if doing[car] == DECIDES
        ]
        """The cars that have yet to decide, in their order."""

    def begin(self, car: int, action: int) -> None:
        """Let the next car of :attr:`turns` decide on an action; what it may not do now becomes a wait.

        Raises InputError where no episode runs, for a car whose turn it is not, and for what is no action.
        """
        self.require_episode()
        if self.turns[:1] != [car]:
            raise InputError(f"car {car} does not decide now; {self.turns[:1]} does")
        checked_actions([action], (1,), self.form.n_actions)
        self._begin(car, action)

    def _begin(self, car: int, action: int) -> None:
        episodes = self.episodes
        before = episodes.grids.cars[0, car].copy()
        chosen = np.full((1, self.n_cars), _STOP, np.int64)
        chosen[0, car] = action
        numbers, queued = self.form.begin(episodes, chosen)
        due = self._due(car, int(numbers[0, car]))
        outcome = episodes.decide(numbers, np.array([[car]]), timed=False)[0, car]
        # A choice of an object to which there is no way is a STOP that was not asked for.
        strayed = outcome == WAITS and not (queued is not None and queued[0, car])
        self._wrong[car] = action != _STOP and (outcome == ILLEGAL or strayed)
        if outcome == BEGUN:
            begun_action = Action(episodes.running.action[0, car])
            self.backend.begin(car, begun_action, before, episodes.grids.cars[0, car])
        elif outcome == ILLEGAL and due != _STOP:
            self._refused[car] = self.backend.refuse(car, Action(due), episodes.grid(0))
        del self.turns[0]
        self._seen = None

    def _due(self, car: int, action: int) -> int:
        """Return the primitive or registered action that a choice stands for, if the rules forbid it.

        That is the next one of the helper's queue. A move to which the helper finds no way stands for STOP.
        """
        queue = self.episodes.queue[0, car]
        if queue[0] >= 0:
            return int(queue[0])
        if self.episodes.depth is not None and action in MOVE_DIRECTION:
            return _STOP
        return action

    def step(self, actions: Any) -> CoreStep:
        """Let the cars that decide begin their actions, and run to the next event; ``actions`` (n,) by car."""
        self.require_episode()
        chosen = checked_actions(actions, (self.n_cars,), self.form.n_actions)
        for car in list(self.turns):
            self._begin(car, int(chosen[car]))
        return self.advance()

    def advance(self) -> CoreStep:
        """Run to the next event, for which all cars must have decided; what ends at one time is one event."""
        self.require_episode()
        if self.turns:
            raise InputError(f"cars {self.turns} have not decided")
        episodes = self.episodes
        running = self.episodes.running
        before = episodes.worlds_before()
        began_s = float(episodes.time_s[0])
        doing = running.action.copy()
        ended = np.zeros(self.n_cars, np.bool_)
        failed = np.zeros(self.n_cars, np.bool_)
        attempts: list[Attempt | None] = [None] * self.n_cars
        for car, refused in self._refused.items():
            attempts[car] = refused
        self._refused.clear()
        contacts: tuple[Any, ...] | None = None
        problems: tuple[str, ...] = ()
        while not (ended.any() or problems or episodes.lost.all()):
            until_s = min(running.ends_s[0].tolist())
            happened = self.backend.advance(self._zero_s + until_s if until_s < math.inf else None)
            time_s = round(happened.time_s - self._zero_s, 6)
            ended = episodes.finish(
                0, time_s, list(happened.failed), happened.confirmed, happened.lost
            )
            problems = happened.problems
            for car, fails in happened.failed.items():
                failed[car] = fails
            for car, attempt in happened.attempts.items():
                attempts[car] = attempt
            if happened.contacts is not None:
                contacts = (contacts or ()) + happened.contacts
        lost = {car: {"lost": reason} for car, reason in happened.lost.items()}
        self._found = [info_of(attempt) | lost.get(car, {}) for car, attempt in enumerate(attempts)]
        episodes.queue[0, failed] = -1  # what was planned starts from where the car is not
        duration_s = round(float(episodes.time_s[0]) - began_s, 6)
        ends = Ends(np.array([duration_s]), doing, ended[None], failed[None])
        if any(attempts):
            tried = tuple(attempts)
        else:
            tried = ()
        steps = episodes.settle(before, ends, self.options.time_weight, problems, tried, contacts)
        self._look()
        self._show()
        success = bool(steps.success[0])
        over = bool(steps.done[0]) or bool(problems)
        if over or (success and self.task.ends_on_success):
            deadlock = None
        else:
            deadlock = episodes.deadlock(0)
        terminated, truncated = self._ends(success, over or deadlock is not None)
        self.turns = []
        if self._runs:
            self._take_turns()
        shared = {
            "success": success,
            "duration_s": duration_s,
            "problems": problems,
            "deadlock": deadlock,
        }
        by_car = self._infos(shared, ended | (not self._runs), failed)
        return float(steps.reward[0]), terminated, truncated, by_car

    def _infos(
        self, shared: dict[str, Any], ended: NDArray[np.bool_], failed: NDArray[np.bool_]
    ) -> list[dict[str, Any]]:
        """Return the infos by car after an event: ``ended`` (n,) are whose decisions have, ``failed`` whose actions."""
        episodes = self.episodes
        over = ended.tolist()
        wrong = self._wrong.tolist()
        failures = failed.tolist()
        time_s = float(episodes.time_s[0])
        running = episodes.running
        doing = running.action[0].tolist()
        began_s = running.began_s[0].tolist()
        outcome = running.outcome[0].tolist()
        earned = running.earned[0].tolist()
        masks = self.masks.copy()
        infos = []
        for car, car_info in enumerate(self._found):
            infos.append(
                {
                    **car_info,
                    "action_mask": masks[car],
                    "illegal": wrong[car],
                    "blocked": outcome[car] == BLOCKED,
                    "decides": doing[car] == DECIDES,
                    "elapsed_s": round(time_s - began_s[car], 6) if over[car] else 0.0,
                    "earned": earned[car] if over[car] else 0.0,
                    "failed": failures[car],
                    **shared,
                }
            )
        return infos

"""Episodes of a task, many side by side: reset, masks, tick, reward, done."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.actions import act_registered, is_registered, registered_columns
from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel import batch
from craftsim.discrete.kernel.batch import NO_HELPER
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kernel.search import search_buffers
from craftsim.discrete.kernel.state import World
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import DEFAULT_DEPTH, Rules, RuleSet, empty_queue
from craftsim.discrete.schedule import car_durations
from craftsim.tasks.observation import car_vectors, entity_rows
from craftsim.tasks.rewards import Transition
from craftsim.tasks.starts import Starts
from craftsim.tasks.task import Task


@dataclass(frozen=True)
class Steps:
    """The result of a tick, one element an episode."""

    reward: NDArray[np.float64]
    """(B,): one number shared by all cars."""
    done: NDArray[np.bool_]
    """(B,): the episode is over, by its length or, where the task says so, by success."""
    success: NDArray[np.bool_]
    """(B,): the work is done now."""
    applied: NDArray[np.bool_]
    """(B, n): by car, true if its action was legal when its turn came."""
    order: NDArray[np.int64]
    """(B, n): the cars in the order in which they acted."""


class Episodes:
    """B episodes of one task, side by side. Nothing is hidden: all state is in public attributes.

    With ``helper_depth`` the action helper is on: a MOVE asks for the neighbour cell, and ``queue`` holds what is left
    to do. ``rng`` draws starts and, where the caller gives none, the order in which cars act; episodes whose ``starts``
    are given begin with those. Masks have a further column for each of the registered ``actions``.
    """

    def __init__(
        self,
        task: Task,
        rng: np.random.Generator,
        n: int = 1,
        rule_set: RuleSet | str = "physical",
        helper_depth: int | None = None,
        starts: Starts | None = None,
        actions: Sequence[Action | str] = (),
    ) -> None:
        if starts is None:
            starts = task.draw_starts(rng, n)
        else:
            starts = starts.take(np.arange(len(starts)))
        self.task = task
        self.rng = rng
        self.layout = task.layout
        rules = Rules(rule_set, actions=actions)
        self.corrections = int(rules.corrections)
        self.patterns = rules.patterns
        self.rules = rules
        self.registered = rules.registered
        self.depth = helper_depth
        self.grids = starts.grids
        """The B worlds, a batch that is changed in place."""
        self.designs = starts.designs
        """(B, T, 5): what is to be built in each world, see :data:`craftsim.tasks.starts.Targets`."""
        self.queue = np.stack(
            [empty_queue(self.n_cars, helper_depth or 0) for _ in range(len(starts))]
        )
        """(B, n, depth + 1): actions that the helper has still to do, -1 where none."""
        self.t = np.zeros(len(starts), np.int64)
        self.bonus_given = np.zeros(len(starts), np.bool_)
        """(B,): the goal was reached in an earlier tick but the first: a bonus that is paid once is spent."""
        self.done = np.zeros(len(starts), np.bool_)
        self.potentials = task.reward.potentials(self.grids, self.designs, self.layout)
        """The potentials that terms of the reward look at, each (B,)."""
        self._space = search_buffers(self.grids.size)

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.designs)

    @property
    def n_cars(self) -> int:
        """Number of cars in each world."""
        return self.grids.n_cars

    @property
    def world(self) -> World:
        """The worlds, and what decides on legality in them, for compiled code."""
        return self.grids.world(self.corrections, self.patterns)

    @property
    def busy(self) -> NDArray[np.bool_]:
        """(B, n): which helpers are under way, so that the actions of their cars are not executed."""
        return self.queue[..., 0] >= 0

    @property
    def scored(self) -> Grid:
        """The worlds that rewards and success are a matter of."""
        return self.grids

    @property
    def potential(self) -> NDArray[np.float64]:
        """(B,): the potential of each world, see :meth:`craftsim.tasks.rewards.Reward.potential`."""
        return self.task.reward.potential(self.potentials, len(self))

    def grid(self, i: int) -> Grid:
        """Return a copy of one world."""
        return self.grids[i].copy()

    def put(self, rows: Any, grids: Grid) -> None:
        """Replace the world of an episode by a copy of another, or those of several by a batch; the episodes go on."""
        self.grids.cells[rows] = grids.cells
        self.grids.cars[rows] = grids.cars

    def some(self, rows: NDArray[np.integer]) -> Self:
        """Return some of the episodes to look at; what is done to them is not done to these."""
        episodes = object.__new__(type(self))
        episodes.__dict__ |= self.__dict__
        episodes.grids = self.grids[rows]
        episodes.designs = self.designs[rows]
        episodes.queue = self.queue[rows]
        return episodes

    def reset(self, which: Sequence[int] | NDArray[np.integer] | None = None) -> None:
        """Start some episodes anew, or all."""
        if which is None:
            rows = np.arange(len(self))
        else:
            rows = np.asarray(which, np.int64)
        if len(rows):
            self.begin(rows, self.task.draw_starts(self.rng, len(rows)))

    def begin(self, rows: NDArray[np.integer], starts: Starts) -> None:
        """Start the episodes ``rows`` anew, each as the start of the same place says."""
        self.put(rows, starts.grids)
        self.designs[rows] = starts.designs
        if self.depth is not None:
            self.queue[rows] = -1
        self.t[rows] = 0
        self.bonus_given[rows] = False
        self.done[rows] = False
        fresh = self.task.reward.potentials(starts.grids, starts.designs, self.layout)
        for values, fresh_values in zip(self.potentials, fresh, strict=True):
            values[rows] = fresh_values

    def draw_order(self) -> NDArray[np.int64]:
        """Return (B, n): for each episode a fresh, uniform order of its cars."""
        return np.argsort(self.rng.random((len(self), self.n_cars)), axis=1)

    def step(self, actions: NDArray[np.integer], order: NDArray[np.integer] | None = None) -> Steps:
        """Let all cars act once; ``actions`` (B, n) by car, ``order`` (B, n) of the cars' turns."""
        if order is None:
            turns = self.draw_order()
        else:
            turns = np.asarray(order, np.int64)
        before = self.worlds_before()
        applied = self.act(actions, turns)
        transition = None
        if before is not None:
            acts = np.asarray(actions, np.int64)
            durations_s = car_durations(before.cars, self.grids.cars, acts, applied)
            duration_s = durations_s.max(axis=1, initial=0.0)
            transition = self.transition(before, acts, applied, durations_s, duration_s)
        return self.score(applied, turns, transition)

    def worlds_before(self) -> Grid | None:
        """Return copies of the worlds that are scored where the reward needs a :meth:`transition`, else None."""
        if self.task.reward.sees_transitions:
            return self.scored.copy()
        return None

    def transition(
        self,
        before: Grid,
        actions: NDArray[np.int64],
        applied: NDArray[np.bool_],
        durations_s: NDArray[np.float64],
        duration_s: NDArray[np.float64],
        attempts: Sequence[Any] = (),
        contacts: tuple[Any, ...] | None = None,
        problems: tuple[str, ...] = (),
    ) -> Transition:
        """Return what terms of the reward see of a tick that the episodes have just had.

        Arguments are its fields; the last three are those of the only world.
        """
        n_worlds = len(self)
        return Transition(
            before=before,
            after=self.scored.copy(),
            designs=self.designs.copy(),
            layout=self.layout,
            t=self.t.copy(),
            actions=actions.copy(),
            applied=applied.copy(),
            durations_s=durations_s,
            duration_s=duration_s,
            attempts=(tuple(attempts) or (None,) * self.n_cars,) * n_worlds,
            contacts=(contacts,) * n_worlds,
            problems=(problems,) * n_worlds,
        )

    def act(self, actions: NDArray[np.integer], order: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Let all cars act; return (B, n), by car, whether what each did was legal when its turn came.

        ``actions`` (B, n) is by car, ``order`` (B, n) lists the cars of each world as they act. Raises ValueError if
        a shape or an order is wrong. A tick of an episode ends with :meth:`score`.
        """
        turns: NDArray[np.int64] = np.ascontiguousarray(order, np.int64)
        acts: NDArray[np.int64] = np.asarray(actions, np.int64)
        shape = (len(self), self.n_cars)
        if acts.shape != shape or turns.shape != shape:
            raise ValueError(
                f"actions and order must have shape {shape}, not {acts.shape} and {turns.shape}"
            )
        if self.n_cars and (np.sort(turns, axis=1) != np.arange(self.n_cars)).any():
            raise ValueError(f"an order must name each of the cars 0 to {self.n_cars - 1} once")
        acting = np.take_along_axis(acts, turns, axis=1)
        in_order = np.empty(turns.shape, np.bool_)
        if acting.max(initial=0) < N_ACTIONS:
            self._step(turns, acting, in_order)
        else:
            self._step_with_registered(turns, acting, in_order)
        applied = np.empty_like(in_order)
        np.put_along_axis(applied, turns, in_order, axis=1)
        return applied

    def _step(
        self, turns: NDArray[np.int64], acting: NDArray[np.int64], applied: NDArray[np.bool_]
    ) -> None:
        """Let cars act by the compiled rules, in this order."""
        arrays = *self.world, turns, acting, applied
        if self.depth is None:
            batch.step(*arrays)
        else:
            batch.step_with_helper(*arrays, self.queue, self._space, self.depth)

    def _step_with_registered(
        self, turns: NDArray[np.int64], acting: NDArray[np.int64], applied: NDArray[np.bool_]
    ) -> None:
        """Do the same where some actions are registered ones: one turn after the other.

        A car whose queue still has something to do goes on with that, as it does whatever else it is asked for.
        """
        for turn in range(self.n_cars):
            cars = turns[:, turn].copy()
            actions = acting[:, turn].copy()
            legal = np.empty((len(self), 1), np.bool_)
            queued = self.queue[np.arange(len(self)), cars, 0] >= 0
            registered = [i for i in np.flatnonzero(~queued).tolist() if is_registered(actions[i])]
            actions[registered] = Action.STOP
            self._step(cars[:, None], actions[:, None], legal)
            for i in registered:
                legal[i] = act_registered(
                    self.grids[i], self.corrections, int(cars[i]), int(acting[i, turn])
                )
            applied[:, turn] = legal[:, 0]

    def score(
        self,
        applied: NDArray[np.bool_],
        order: NDArray[np.int64],
        transition: Transition | None = None,
        readable: bool = True,
        usual_ticks: NDArray[np.float64] | None = None,
    ) -> Steps:
        """End a tick: return what it brought. What is not ``readable`` as a grid has the potentials of before.

        ``transition`` and ``usual_ticks`` are as of :meth:`craftsim.tasks.rewards.Reward.score`.
        """
        task = self.task
        reward = task.reward
        before = self.potentials
        if readable:
            grids = self.scored
            self.potentials = reward.potentials(grids, self.designs, self.layout)
            success = task.reached(grids, self.designs)
        else:
            success = np.zeros(len(self), np.bool_)
        t = self.t
        paid = reward.score(before, self.potentials, t, self.bonus_given, transition, usual_ticks)
        if reward.pays_once:
            self.bonus_given = self.bonus_given | (success & (t >= 1))
        self.done = task.over(t, success)
        self.t = t + 1
        return Steps(paid, self.done, success, applied, order)

    def legal(self) -> NDArray[np.bool_]:
        """Return (B, n, 15): what each car could do at once; registered actions have further columns."""
        return self._masks(NO_HELPER)

    def reachable(self) -> NDArray[np.bool_]:
        """Return (B, n, 15): the same, and the moves that the helper finds a plan for."""
        return self._masks(DEFAULT_DEPTH if self.depth is None else self.depth)

    def _masks(self, depth: int) -> NDArray[np.bool_]:
        out = np.empty((len(self), self.n_cars, N_ACTIONS), np.bool_)
        batch.masks(*self.world, self._space, depth, out)
        return registered_columns(out, self.grids, self.corrections, self.registered)

    def offered(self) -> NDArray[np.bool_]:
        """Return (B, n, 15): what is legal, with the helper also what is reachable; never all false.

        A car that the rules leave nothing, on a ramp with both ways blocked, is offered STOP, which does nothing.
        """
        if self.depth is None:
            mask = self.legal()
        else:
            mask = self.reachable()
        mask[..., Action.STOP] |= ~mask.any(-1)
        return mask

    def begins(self, actions: NDArray[np.int8]) -> NDArray[np.bool_]:
        """Return which of some actions a car may begin now, (B, n, k), legal ones, or -1 where there is none."""
        return np.asarray(actions >= 0)

    def entity_rows(self) -> NDArray[np.int32]:
        """Return (B, n_observed, 13): what is where, as :mod:`craftsim.tasks.observation` lays it out."""
        return entity_rows(self.grids, self.layout, self.designs)

    def vectors(self) -> NDArray[np.int32]:
        """Return (B, n, vector_length): each car's observation."""
        return car_vectors(self.entity_rows(), self.n_cars)

"""Asynchronous episodes: each car decides when its own action has ended, while others are in the middle of theirs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete import own_actions
from craftsim.discrete.actions import footprint
from craftsim.discrete.footprint import Footprint
from craftsim.discrete.grid import CarField, Grid
from craftsim.discrete.kernel import batch, events
from craftsim.discrete.kernel.batch import NO_HELPER
from craftsim.discrete.kernel.claims import MOST, clashes, empty_board
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kernel.events import BEGUN, BLOCKED, DECIDES, ILLEGAL, RUNS, WAITS, Running
from craftsim.discrete.kinds import Action
from craftsim.discrete.reasons import explain
from craftsim.discrete.schedule import nominal_durations, situation
from craftsim.discrete.tasks.episodes import Episodes, Steps
from craftsim.discrete.tasks.rewards import Reward
from craftsim.discrete.tasks.starts import Starts

__all__ = [
    "BEGUN",
    "BLOCKED",
    "DECIDES",
    "ILLEGAL",
    "RUNS",
    "WAITS",
    "AsynchronousEpisodes",
    "Deadlock",
    "Timing",
]

_STOP: Final = int(Action.STOP)


@dataclass(frozen=True)
class Timing:
    """How long actions take on the grid, and how long a car waits."""

    wait_s: float = 1.0
    """A wait ends with the next event, after so many seconds at the latest."""
    jitter: float = 0.0
    """Standard deviation of the logarithm of durations."""
    failures: float = 0.0
    """Probability that an action ends without effect."""
    equal: bool = False
    """Whether every action takes 1 s instead of its nominal duration."""

    def seconds(
        self,
        actions: NDArray[np.integer],
        before: NDArray[np.integer],
        after: NDArray[np.integer],
        noise: Any,
    ) -> NDArray[np.float64]:
        """Return how long actions (...) take, of cars (..., 7) before and after them, for standard normal ``noise``."""
        nominal = 1.0 if self.equal else nominal_durations()[actions, situation(before, after)]
        return np.asarray(nominal * np.exp(self.jitter * noise))


class Deadlock(NamedTuple):
    """Why nothing can go on in a world."""

    words: str
    """A sentence for each car."""
    pairs: tuple[tuple[int, int], ...]
    """(car, the car that it waits for)."""


def moment(seconds: Any) -> Any:
    """Return times in seconds, rounded to microseconds: what ends then ends at the same time, however it was added."""
    return np.round(np.asarray(seconds) * 1e6) / 1e6


class AsynchronousEpisodes(Episodes):
    """B asynchronous episodes of one task. All state is in public attributes.

    ``grids`` are the committed worlds, on which cars decide: the confirmed ones with the effects of what runs. Rewards
    and success are a matter of the confirmed ones.
    """

    def __init__(self, *arguments: Any, timing: Timing | None = None, **more: Any) -> None:
        """Take what :class:`Episodes` takes, and how long things take."""
        super().__init__(*arguments, **more)
        self.timing = timing or Timing()
        b, n = len(self), self.n_cars
        self.confirmed = self.grids.copy()
        """What is so: the effects of all that has ended."""
        self.time_s = np.zeros(b)
        """(B,): since the episode began."""
        self.running = Running(
            np.full((b, n), DECIDES, np.int64),
            np.zeros((b, n)),
            np.full((b, n), np.inf),
            np.zeros((b, n), np.int64),
            np.zeros((b, n), np.bool_),
            np.zeros((b, n, MOST, 4), np.int16),
            np.zeros((b, n), np.int64),
        )
        self.outcome = np.full((b, n), WAITS, np.int64)
        """(B, n): what became of each car's last decision, as :mod:`craftsim.discrete.kernel.events` has it."""
        self.asked = np.full((b, n), _STOP, np.int64)
        """(B, n): what each car asked for then."""
        self.decisions = np.zeros(b, np.int64)
        """(B,): how many have been made."""
        self.earned = np.zeros((b, n))
        """(B, n): the rewards since each car's last decision."""
        self._board = empty_board(self.grids.size)
        self._row = np.zeros((MOST, 4), np.int16)
        self._plan = np.zeros((self.depth or 0) + 1, np.int8)

    @property
    def scored(self) -> Grid:
        """The confirmed worlds."""
        return self.confirmed

    @property
    def decides(self) -> NDArray[np.bool_]:
        """(B, n): which cars have no action and decide."""
        return np.asarray(self.running.action == DECIDES)

    def begin(self, rows: NDArray[np.integer], starts: Starts) -> None:
        """Start the episodes ``rows`` anew; all their cars decide."""
        super().begin(rows, starts)
        self.confirmed.cells[rows], self.confirmed.cars[rows] = starts.grids.cells, starts.grids.cars
        self.time_s[rows], self.decisions[rows], self.earned[rows] = 0.0, 0, 0.0
        self.running.action[rows], self.running.turn[rows], self.running.n_claims[rows] = DECIDES, 0, 0
        self.outcome[rows] = WAITS

    def decide(self, actions: NDArray[np.integer], order: NDArray[np.integer]) -> NDArray[np.int64]:
        """Let cars begin what they have decided on; return (B, n), what became of each decision.

        Args:
            actions: (B, n) by car; those of cars whose actions run are ignored.
            order: (B, k), the cars that decide now, in their order; each is judged on what the earlier ones have begun.

        What the rules forbid, or what a claim stands against, becomes a wait. Ends of what begins are not known yet.
        """
        turns, acts = np.ascontiguousarray(order, np.int64), np.ascontiguousarray(actions, np.int64)
        deciding = np.take_along_axis(self.decides, turns, 1)
        self.decisions += deciding.sum(1)
        out = np.full(acts.shape, RUNS, np.int64)
        done = 0
        some = (acts >= N_ACTIONS).any(1) if self.own else np.zeros(len(self), np.bool_)
        for i in [*np.flatnonzero(some).tolist(), len(self)]:
            self._decide(slice(done, i), turns, acts, out)
            done = i + 1
            for place in range(turns.shape[1] if i < len(self) else 0):
                car = int(turns[i, place])
                queued = self.depth is not None and self.queue[i, car, 0] >= 0
                if deciding[i, place] and acts[i, car] >= N_ACTIONS and not queued:
                    out[i, car] = self._decide_own(i, car, int(acts[i, car]))
                else:
                    kept = out[i].copy()
                    self._decide(slice(i, i + 1), turns[:, place : place + 1], acts, out)
                    kept[car], out[i] = out[i, car], kept
        now = self.time_s[:, None]
        began = out != RUNS
        self.running.began_s[:] = np.where(began, now, self.running.began_s)
        waits = began & (out != BEGUN)
        self.running.ends_s[:] = np.where(
            waits, moment(now + self.timing.wait_s), np.where(began, np.inf, self.running.ends_s)
        )
        self.running.fails[began] = False
        self.earned[began] = 0.0
        self.outcome = np.where(began, out, self.outcome)
        self.asked = np.where(began, acts, self.asked)
        return out

    def _decide(self, worlds: slice, turns: Any, acts: Any, out: Any) -> None:
        running = Running._make(array[worlds] for array in self.running)
        some = self.grids.cells[worlds], self.grids.cars[worlds], self.corrections, running
        scratch = self._board, self.queue[worlds], self._space
        depth = NO_HELPER if self.depth is None else self.depth
        events.decide(*some, turns[worlds].copy(), acts[worlds], *scratch, depth, out[worlds])

    def _decide_own(self, i: int, car: int, action: int) -> int:
        """Let a car begin a registered action, which is a user's code."""
        running, before = self.running, self.grids[i].copy()
        running.turn[i, car], running.action[i, car] = running.turn[i].max() + 1, _STOP
        if own_actions.why(before, self.corrections, car, action):
            return ILLEGAL
        after = before.copy()
        own_actions.carry_out(after, car, action)
        needs = footprint(before, after, car, Action(action))
        if self._clash(i, needs):
            return BLOCKED
        claims = needs.claims()
        most = running.claims.shape[2]
        if len(claims) > most:
            more = ((0, 0), (0, 0), (0, len(claims) - most), (0, 0))
            self.running = running = running._replace(claims=np.pad(running.claims, more))
        running.claims[i, car, : len(claims)], running.n_claims[i, car] = claims, len(claims)
        running.action[i, car] = action
        self.grids.cells[i], self.grids.cars[i] = after.cells, after.cars
        return BEGUN

    def _clash(self, i: int, needs: Footprint) -> bool:
        one = Running._make(array[i : i + 1] for array in self.running)
        events.mark_running(one, 0, self._board, True)
        rows = needs.claims()
        found = bool(clashes(self._board, rows, len(rows)))
        events.mark_running(one, 0, self._board, False)
        return found

    def draw_ends(self, cars_before: NDArray[np.integer], out: NDArray[np.int64]) -> None:
        """Draw when what has just begun ends, and whether it fails.

        Args:
            cars_before: (B, n, 7), the cars before they decided.
            out: what :meth:`decide` returned.
        """
        timing, begun = self.timing, out == BEGUN
        shape = out.shape
        noise = self.rng.standard_normal(shape) if timing.jitter else 0.0
        if timing.failures:
            self.running.fails[:] = np.where(
                begun, self.rng.random(shape) < timing.failures, self.running.fails
            )
        action = np.maximum(self.running.action, 0)
        seconds = timing.seconds(action, cars_before, self.grids.cars, noise)
        ends = moment(self.time_s[:, None] + seconds)
        self.running.ends_s[:] = np.where(begun, ends, self.running.ends_s)

    def advance(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Let time pass in each world to its next event; return which decisions have ended, and which have failed.

        All cars must have decided; both (B, n).
        """
        assert not self.decides.any(), "a car has not decided"
        before = self.running.action.copy()
        own = np.flatnonzero((before >= N_ACTIONS).any(1)).tolist() if self.own else []
        kept = {i: self.confirmed[i].copy() for i in own}
        failing = self.running.fails.copy()
        ended = np.zeros(before.shape, np.bool_)
        worlds = self.confirmed.world(self.corrections), self.grids.world(self.corrections)
        events.advance(*worlds, self.running, self.queue, self.time_s, ended)
        for i, grid in kept.items():
            for car in np.argsort(self.running.turn[i]):
                if ended[i, car] and not failing[i, car]:
                    self._enforce(grid, int(car), int(before[i, car]))
            self.confirm(i, grid)
        return ended, ended & failing

    def step(self, actions: NDArray[np.integer], order: NDArray[np.integer] | None = None) -> Steps:
        """Let the cars that decide begin, ``actions`` (B, n) by car, and advance each world to its next event."""
        cars, before, now_s = self.grids.cars.copy(), self.confirmed.copy(), self.time_s.copy()
        outcome = self.decide(actions, self.draw_order() if order is None else order)
        self.draw_ends(cars, outcome)
        doing = self.running.action.copy()
        ended, _ = self.advance()
        return self.settle(before, doing, ended, np.round(self.time_s - now_s, 6), 0.0)

    def finish(self, i: int, time_s: float, cars: Any, confirmed: Grid) -> NDArray[np.bool_]:
        """Bring a world to an event that something else has simulated; return which decisions have ended, (n,).

        Args:
            i: its number.
            time_s: the time now; waits that end then have ended, and all waits if an action has.
            cars: whose actions have ended.
            confirmed: what is so now.
        """
        running = self.running
        self.time_s[i] = time_s
        ended = np.zeros(self.n_cars, np.bool_)
        ended[list(cars)] = True
        ended |= (running.action[i] == _STOP) & ((running.ends_s[i] <= time_s + 1e-6) | ended.any())
        if ended.any():
            ended |= running.action[i] == _STOP
        running.action[i, ended], running.n_claims[i, ended] = DECIDES, 0
        self.confirm(i, confirmed)
        return ended

    def confirm(self, i: int, confirmed: Grid) -> None:
        """Replace a confirmed world, and make the committed one of it anew, with the effects of what runs."""
        self.confirmed.cells[i], self.confirmed.cars[i] = confirmed.cells, confirmed.cars
        grid = confirmed.copy()
        for car in np.argsort(self.running.turn[i]):
            self._enforce(grid, int(car), int(self.running.action[i, car]))
        self.grids.cells[i], self.grids.cars[i] = grid.cells, grid.cars

    def _enforce(self, grid: Grid, car: int, action: int) -> None:
        if own_actions.is_own(action):
            own_actions.carry_out(grid, car, action)
        elif action not in (DECIDES, _STOP):
            events.enforce(grid.cells, grid.cars, self.corrections, car, action)

    def settle(
        self,
        before: Grid,
        actions: NDArray[np.integer],
        ended: NDArray[np.bool_],
        duration_s: NDArray[np.float64],
        time_weight: float,
        problems: tuple[str, ...] = (),
    ) -> Steps:
        """Score an event: as many decisions as cars count as a tick. What it earns is added to ``earned``, too.

        Args:
            before: the B confirmed worlds before it.
            actions: (B, n), what the cars were doing.
            ended: (B, n), whose actions have ended; waits count.
            duration_s: (B,), since the event before.
            time_weight: cost of a second.
            problems: why the worlds cannot be read as grids any more.
        """
        self.t = np.maximum(self.decisions - 1, 0) // max(self.n_cars, 1)
        # The rules forbid a STOP on a ramp.
        stood = (self.outcome == WAITS) & (before.cars[..., CarField.SLOPE] == 0)
        applied = ended & ((actions != _STOP) | stood)
        seen = []
        if not isinstance(self.task.reward, Reward):
            took = np.where(ended & (actions != _STOP), self.time_s[:, None] - self.running.began_s, 0.0)
            done = np.where(ended, actions, _STOP)
            seen = [
                self.transition(i, before[i], done[i], applied[i], took[i], duration_s[i], problems=problems)
                for i in range(len(self))
            ]
        steps = self.score(applied, np.argsort(self.running.turn), not problems, seen)
        steps = replace(steps, reward=steps.reward - time_weight * duration_s)
        self.earned += steps.reward[:, None]
        return steps

    def _masks(self, depth: int) -> NDArray[np.bool_]:
        out = np.empty((len(self), self.n_cars, N_ACTIONS), np.bool_)
        some = self.grids.cells, self.grids.cars, self.corrections, self.running
        events.offer(*some, self._board, self._row, self._plan, self._space, depth, out)
        if not self.own:
            return out
        mask = own_actions.add_columns(out, self.grids, self.corrections, self.own)
        for i, car, k in np.argwhere(mask[..., N_ACTIONS:]).tolist():
            mask[i, car, N_ACTIONS + k] = bool(self.decides[i, car]) and not self._blocks(i, car, self.own[k])
        return mask

    def _blocks(self, i: int, car: int, action: Action) -> bool:
        if not self.running.n_claims[i].any():
            return False
        before = self.grids[i].copy()
        after = before.copy()
        own_actions.carry_out(after, car, action)
        return self._clash(i, footprint(before, after, car, action))

    def deadlocks(self, masks: NDArray[Any]) -> NDArray[np.bool_]:
        """Return (B,): in which worlds nothing can go on, as :meth:`deadlock` says; ``masks`` (B, n, actions)."""
        idle = self.decides.all(1)
        at_most_stop = masks.sum(-1) <= masks[..., _STOP]
        doubted = idle & (at_most_stop.all(1) | (self.outcome == ILLEGAL).all(1))
        found = np.zeros(len(self), np.bool_)
        for i in np.flatnonzero(doubted).tolist():
            found[i] = self.deadlock(i, masks[i]) is not None
        return found

    def deadlock(self, i: int, mask: NDArray[Any]) -> Deadlock | None:
        """Return why nothing can go on in a world at an event, or None where something can.

        Nothing runs, and no car has an action but to wait; or each car has asked in vain for one that another car
        forbids. ``mask`` (n, actions) is what the cars are offered.
        """
        if not self.decides[i].all() or (self.queue[i, :, 0] >= 0).any() or not self.n_cars:
            return None
        stuck = ~np.delete(mask.astype(np.bool_), _STOP, axis=1).any(1)
        refused = self.outcome[i] == ILLEGAL
        if not (stuck.all() or refused.all()):
            return None
        found = [
            self._waits_for(i, car, None if stuck.all() else int(self.asked[i, car]))
            for car in range(self.n_cars)
        ]
        if not stuck.all() and not all(found):
            return None
        pairs = tuple((car, other) for car, others in enumerate(found) for other in others)
        words = [
            f"car {car} waits for car {other}: {why}"
            for car, others in enumerate(found)
            for other, why in others.items()
        ]
        words += [f"car {car} can do nothing" for car, others in enumerate(found) if not others]
        return Deadlock("; ".join(words), pairs)

    def _waits_for(self, i: int, car: int, action: int | None) -> dict[int, str]:
        """Return why a car cannot act, by each other car without which it could; ``action`` is what it asked for."""
        grid, found = self.grids[i], dict[int, str]()
        for other in range(self.n_cars):
            without = grid.copy()
            without.cars[other, CarField.Z] += 2 * grid.size[2]
            for one in Action if action is None else (Action(action),):
                forbidden = one < N_ACTIONS and batch.reason(
                    grid.cells, grid.cars, self.corrections, car, one
                )
                if other == car or other in found or not forbidden:
                    continue
                if not batch.reason(without.cells, without.cars, self.corrections, car, one):
                    found[other] = str(explain(grid, self.corrections, car, one))
        return found

    def doing(self) -> NDArray[np.float32]:
        """Return (B, n, 2): of each car what it does, -1 if it decides, and the seconds since that began."""
        idle = self.decides
        since = np.where(idle, 0.0, self.time_s[:, None] - self.running.began_s)
        return np.stack([np.where(idle, DECIDES, self.running.action), since], axis=-1).astype(np.float32)

    def claimed(self) -> NDArray[np.int8]:
        """Return (B, L, W, H + 1): 1 for each cell that what runs has claimed."""
        out = np.zeros(self.grids.cells.shape[:4], np.int8)
        events.claimed(self.running, out)
        return out

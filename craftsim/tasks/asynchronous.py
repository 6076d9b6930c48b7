"""Asynchronous episodes: each car decides when its own action has ended, while others are in the middle of theirs."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.actions import (
    ACTIONS,
    carry_out,
    footprint,
    is_registered,
    registered_reason,
)
from craftsim.discrete.grid import CarField, Grid
from craftsim.discrete.kernel import batch, events
from craftsim.discrete.kernel.batch import NO_HELPER
from craftsim.discrete.kernel.claims import MOST, Claims, conflict
from craftsim.discrete.kernel.codes import FIRST_MOVE, LAST_MOVE, N_ACTIONS
from craftsim.discrete.kernel.events import (
    BEGUN,
    BLOCKED,
    DECIDES,
    ILLEGAL,
    RUNS,
    WAITS,
    ActionDurations,
    Ends,
    Running,
)
from craftsim.discrete.kernel.state import DERIVED_MARKS
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import enforce, explain
from craftsim.discrete.schedule import SITUATIONS, nominal_durations, situation
from craftsim.tasks.episodes import Episodes, Steps
from craftsim.tasks.starts import Starts

USUAL_TICK_S: Final = 1.0
"""Approximate duration of a move: costs and discounts of a tick are those of so much time."""
_STOP: Final = int(Action.STOP)


@dataclass(frozen=True)
class Timing:
    """Durations of actions on the grid, and of a wait."""

    wait_s: float = 1.0
    """A wait ends with the next event, after so many seconds at the latest."""
    jitter: float = 0.0
    """Standard deviation of the logarithm of durations."""
    failures: float = 0.0
    """Probability that an action ends without effect."""
    equal: bool = False
    """Every action takes 1 s instead of its nominal duration."""

    @property
    def nominal_s(self) -> NDArray[np.float64]:
        """(actions, 4): durations by action and situation, before jitter."""
        if self.equal:
            return np.ones_like(nominal_durations())
        return nominal_durations()

    def factors(self, rng: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Draw the ratios of some durations to the nominal ones."""
        if self.jitter:
            return np.exp(self.jitter * rng.standard_normal(shape))
        return np.ones(shape)

    def fails(self, rng: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Draw which of some actions fail."""
        if self.failures:
            fails = rng.random(shape) < self.failures
        else:
            fails = np.zeros(shape, np.bool_)
        return np.asarray(fails)


class Deadlock(NamedTuple):
    """The reasons why nothing can go on in a world."""

    words: str
    """A sentence for each car."""
    pairs: tuple[tuple[int, int], ...]
    """(car, the car that it waits for)."""


@dataclass(frozen=True)
class Event(Steps):
    """The result of an event in B worlds."""

    duration_s: NDArray[np.float64]
    """(B,): since the event before."""
    outcome: NDArray[np.int64]
    """(B, n): the outcome of each car's decision, RUNS where it had none to make."""
    failed: NDArray[np.bool_]
    """(B, n): cars whose actions have ended without effect."""
    elapsed_s: NDArray[np.float64]
    """(B, n): the time since each decision that has ended, and with an episode since all."""
    earned: NDArray[np.float64]
    """(B, n): the sum of the rewards of that time."""
    deadlock: NDArray[np.bool_]
    """(B,): nothing can go on, for :meth:`AsynchronousEpisodes.deadlock` says why."""


def make_episodes(*arguments: Any, timing: Timing | None = None, **options: Any) -> Episodes:
    """Return episodes in ticks, or with a timing asynchronous ones; other arguments are those of :class:`Episodes`."""
    if timing is None:
        return Episodes(*arguments, **options)
    return AsynchronousEpisodes(*arguments, timing=timing, **options)


class AsynchronousEpisodes(Episodes):
    """B asynchronous episodes of one task. All state is in public attributes.

    ``grids`` are the committed worlds, on which cars decide: the confirmed ones with the effects of what runs. Rewards
    and success are a matter of the confirmed ones.
    """

    def __init__(self, *arguments: Any, timing: Timing | None = None, **options: Any) -> None:
        """Take what :class:`Episodes` takes, and how long things take."""
        super().__init__(*arguments, **options)
        self.timing = timing or Timing()
        b = len(self)
        n = self.n_cars
        self.confirmed = self.grids.copy()
        """The worlds with the effects of all that has ended."""
        self.running = Running(
            np.full((b, n), DECIDES, np.int64),
            np.zeros((b, n)),
            np.full((b, n), np.inf),
            np.zeros((b, n), np.int64),
            np.zeros((b, n), np.bool_),
            np.zeros((b, n, MOST, 4), np.int16),
            np.zeros((b, n), np.int64),
            np.full((b, n), _STOP, np.int64),
            np.full((b, n), RUNS, np.int64),
            np.zeros((b, n)),
            np.zeros(b, np.int64),
            np.zeros(b),
        )
        self._no_way = np.zeros((b, n), np.bool_)
        """Cars whose last decision was a move to which the action helper found no way: a STOP, as in ticks."""
        self._row = np.zeros((MOST, 4), np.int16)
        self._plan = np.zeros((self.depth or 0) + 1, np.int8)

    @property
    def scored(self) -> Grid:
        """The confirmed worlds."""
        return self.confirmed

    @property
    def time_s(self) -> NDArray[np.float64]:
        """(B,): since the episode began."""
        return self.running.time_s

    @property
    def decides(self) -> NDArray[np.bool_]:
        """(B, n): which cars have no action and decide."""
        return np.asarray(self.running.action == DECIDES)

    def begin(self, rows: NDArray[np.integer], starts: Starts) -> None:
        """Start the episodes ``rows`` anew; all their cars decide."""
        super().begin(rows, starts)
        self.confirmed.cells[rows] = starts.grids.cells
        self.confirmed.cars[rows] = starts.grids.cars
        self.time_s[rows] = 0.0
        self.running.decided[rows] = 0
        self.running.outcome[rows] = RUNS
        self.running.action[rows] = DECIDES
        self.running.n_claims[rows] = 0

    def grid(self, i: int) -> Grid:
        """Return a copy of a committed world, with its marks."""
        return self._marked(self.grids[i])

    def _marked(self, grid: Grid) -> Grid:
        """Return a copy of a world, with derived marks where the rules have them derived: they are not kept here."""
        copied = grid.copy()
        if self.corrections & DERIVED_MARKS:
            copied.derive_marks()
        return copied

    def decide(
        self, actions: NDArray[np.integer], order: NDArray[np.integer], timed: bool = True
    ) -> NDArray[np.int64]:
        """Let the cars of ``order`` (B, k) begin what they decided on; return what became of each decision, (B, n).

        ``actions`` (B, n) are by car; those of cars whose actions run are ignored. Each is judged on what the earlier
        ones have begun; what the rules forbid, or what a claim stands against, becomes a wait. If it is not ``timed``
        here when an action ends, and whether it fails, :meth:`finish` is to say so.
        """
        turns = np.ascontiguousarray(order, np.int64)
        acts = np.ascontiguousarray(actions, np.int64)
        timing = self.timing
        out = np.full(acts.shape, RUNS, np.int64)
        queued_before = self.queue[:, :, 0] >= 0
        if not timed:
            nominal_s = np.full((len(ACTIONS), len(SITUATIONS)), np.inf)
            factors_and_failures = np.ones(acts.shape), np.zeros(acts.shape, np.bool_)
        else:
            nominal_s = timing.nominal_s
            factors_and_failures = (
                timing.factors(self.rng, acts.shape),
                timing.fails(self.rng, acts.shape),
            )
        durations = ActionDurations(nominal_s, *factors_and_failures, timing.wait_s)
        # In worlds in which one asks for a registered action, which is a user's code, the cars decide one by one.
        rows: list[int] = []
        if self.registered:
            rows = np.flatnonzero((acts >= N_ACTIONS).any(1)).tolist()
        for i in rows:
            for car in turns[i].tolist():
                queued = self.depth is not None and self.queue[i, car, 0] >= 0
                if (
                    self.running.action[i, car] == DECIDES
                    and acts[i, car] >= N_ACTIONS
                    and not queued
                ):
                    out[i, car] = self._decide_registered(i, car, int(acts[i, car]), durations)
                else:
                    self._decide(durations, np.full((len(acts), 1), car), acts, i, i + 1, out)
        self._decide(durations, turns, acts, 0, len(self), out)
        if self.depth is not None:
            no_way = (out == ILLEGAL) & ~queued_before & (acts >= FIRST_MOVE) & (acts <= LAST_MOVE)
            self._no_way = np.where(out == RUNS, self._no_way, no_way)
        return out

    def _decide(self, durations: ActionDurations, *decisions: Any) -> None:
        """Let cars begin actions of the 15; ``decisions`` are the last arguments of the compiled function."""
        depth = NO_HELPER if self.depth is None else self.depth
        world = self.world
        events.decide(world, self.running, self.queue, self._space, depth, durations, *decisions)

    def _decide_registered(self, i: int, car: int, action: int, durations: ActionDurations) -> int:
        running = self.running
        before = self.grids.cars[i, car].copy()
        end_s = self.time_s[i] + durations.wait_s
        running.turn[i, car] = running.turn[i].max() + 1
        running.action[i, car] = _STOP
        result, after, claims = self._try_registered(i, car, action)
        if result == BEGUN:
            capacity = running.claims.shape[2]
            if len(claims) > capacity:
                padding = ((0, 0), (0, 0), (0, len(claims) - capacity), (0, 0))
                self.running = running = running._replace(claims=np.pad(running.claims, padding))
            running.claims[i, car, : len(claims)] = claims
            running.n_claims[i, car] = len(claims)
            running.action[i, car] = action
            self.grids.cells[i] = after.cells
            self.grids.cars[i] = after.cars
            column = int(situation(before, after.cars[car]))
            end_s = self.time_s[i] + durations.nominal_s[action, column] * durations.factor[i, car]
        events.note_decision(self.running, durations, i, car, action, result, end_s)
        return result

    def _try_registered(self, i: int, car: int, action: int) -> tuple[int, Grid, Claims]:
        """Return whether a registered action of a car could begin now, the world after it, and its claims."""
        before = self.grid(i)
        after = before.copy()
        if registered_reason(before, self.corrections, car, action):
            return ILLEGAL, after, self._row[:0]
        carry_out(after, car, action)
        claims = footprint(before, after, car, Action(action))
        for other_car in range(self.n_cars):
            if self._clashes(i, other_car, claims):
                return BLOCKED, after, claims
        return BEGUN, after, claims

    def _clashes(self, i: int, other_car: int, claims: Claims) -> bool:
        """Return whether what a car of a world runs stands against an action with these claims."""
        rows = self.running.claims[i, other_car, : self.running.n_claims[i, other_car]]
        return any(conflict(claims, len(claims), *row) for row in rows)

    def advance(self) -> Ends:
        """Let time pass in each world to its next event, for which all cars must have decided."""
        shape = self.running.action.shape
        masks = np.empty(shape, np.bool_), np.empty(shape, np.bool_)
        ends = Ends(np.empty(len(self)), np.empty(shape, np.int64), *masks)
        # Registered actions do not end by themselves.
        rows: list[int] = []
        if self.registered:
            rows = np.flatnonzero((self.running.action >= N_ACTIONS).any(1)).tolist()
        worlds = {i: self._marked(self.confirmed[i]) for i in rows}
        events.advance(
            self.confirmed.world(self.corrections, self.patterns), self.running, self.queue, ends
        )
        for i, grid in worlds.items():
            done = np.where(ends.ended[i] & ~ends.failed[i], ends.doing[i], _STOP)
            self._enforce(grid[None], done[None], self.running.turn[i : i + 1])
            self.confirm(i, grid)
        self._commit(np.flatnonzero(ends.failed.any(1)))
        return ends

    def step(
        self,
        actions: NDArray[np.integer],
        order: NDArray[np.integer] | None = None,
        *,
        offered: NDArray[Any] | None = None,
        time_weight: float = 0.0,
    ) -> Event:
        """Let the cars that decide begin, ``actions`` (B, n) by car, and advance each world to its next event.

        With ``offered`` (B, n, actions), what the cars have chosen from, deadlocks are found sooner. A second costs
        ``time_weight``.
        """
        before = self.worlds_before()
        if order is None:
            order = self.draw_order()
        outcome = self.decide(actions, order)
        ends = self.advance()
        steps = self.settle(before, ends, time_weight)
        elapsed_s = np.empty(outcome.shape)
        earned = np.empty(outcome.shape)
        waited = np.empty(len(self), np.bool_)
        deadlock = np.zeros(len(self), np.bool_)
        if offered is None:
            masks = np.zeros((len(self), 1, 1), np.int8)
        else:
            masks = offered.view(np.int8)
        events.close(self.running, masks, ends.ended, steps.done, elapsed_s, earned, waited)
        rows = np.flatnonzero(waited)
        deadlock[rows] = self.deadlocked(rows)
        return Event(
            **vars(steps),
            duration_s=ends.duration_s,
            outcome=outcome,
            failed=ends.failed,
            elapsed_s=elapsed_s,
            earned=earned,
            deadlock=deadlock,
        )

    @property
    def lost(self) -> NDArray[np.bool_]:
        """(B, n): which cars nothing can drive any more: they wait without an end, and keep their claims."""
        return np.asarray((self.running.action == _STOP) & np.isinf(self.running.ends_s))

    def finish(
        self, i: int, time_s: float, cars: Any, confirmed: Grid, lost: Collection[int] = ()
    ) -> NDArray[np.bool_]:
        """Bring a world to an event that something else has simulated; return which decisions have ended, (n,).

        Those are the actions of ``cars`` and waits that end now, and all waits if an action has. Nothing can drive the
        cars that are ``lost`` from now on, for good.
        """
        running = self.running
        is_lost = np.zeros(self.n_cars, np.bool_)
        if lost:
            is_lost[list(lost)] = True
            running.action[i, is_lost] = _STOP
            running.ends_s[i, is_lost] = np.inf
        waits = (running.action[i] == _STOP) & ~is_lost
        self.time_s[i] = time_s
        ended = np.zeros(self.n_cars, np.bool_)
        ended[list(cars)] = True
        ended &= ~is_lost
        if ended.any() or (waits & (running.ends_s[i] <= time_s + 1e-6)).any():
            ended |= waits
        running.action[i, ended] = DECIDES
        running.n_claims[i, ended] = 0
        self.confirm(i, confirmed)
        return ended

    def confirm(self, i: int, confirmed: Grid) -> None:
        """Replace a confirmed world, and make the committed one of it anew, with the effects of what runs."""
        self.confirmed.cells[i] = confirmed.cells
        self.confirmed.cars[i] = confirmed.cars
        self._commit(np.array([i]))

    def _commit(self, rows: NDArray[np.integer]) -> None:
        """Make committed worlds anew: the confirmed ones with the effects of what runs."""
        if len(rows):
            grids = self.confirmed[rows]
            self._enforce(grids, self.running.action[rows], self.running.turn[rows])
            self.put(rows, grids)

    def _enforce(self, grids: Grid, actions: NDArray[np.int64], turn: NDArray[np.int64]) -> None:
        """Change worlds as the actions (B, n) of their cars do, in the order of their turns, legal or not."""
        turns = turn.argsort(1)
        acting = np.take_along_axis(actions, turns, 1)
        has_registered = (acting >= N_ACTIONS).any(1)
        for i in np.flatnonzero(has_registered).tolist():
            for car, action in zip(turns[i, :, None, None], acting[i, :, None, None], strict=True):
                if is_registered(int(action[0, 0])):
                    carry_out(grids[i], int(car[0, 0]), int(action[0, 0]))
                else:
                    enforce(*grids[i : i + 1].world(self.corrections, self.patterns), car, action)
        acting[has_registered] = _STOP
        enforce(*grids.world(self.corrections, self.patterns), turns, acting)

    def settle(
        self,
        before: Grid | None,
        ends: Ends,
        time_weight: float,
        problems: tuple[str, ...] = (),
        attempts: tuple[Any, ...] = (),
        contacts: tuple[Any, ...] | None = None,
    ) -> Steps:
        """Score an event: as many decisions as cars count as a tick.

        What a tick costs in which nothing changes is charged for each usual tick of time, and ``time_weight`` for each
        second. ``before`` is from :meth:`worlds_before`; ``problems`` say why worlds cannot be read as grids any more.
        ``attempts`` and ``contacts`` are as of a :class:`craftsim.tasks.rewards.Transition`.
        """
        self.t = np.maximum(self.running.decided - 1, 0) // max(self.n_cars, 1)
        transition = None
        applied = ends.ended
        duration_s = ends.duration_s
        if self.corrections & DERIVED_MARKS and self.sees_marks:
            self.confirmed.derive_marks()
        if before is not None:
            # The rules forbid a STOP on a ramp.
            stops = (self.running.outcome == WAITS) | self._no_way
            stood = stops & (before.cars[..., CarField.SLOPE] == 0)
            acted = ends.ended & (ends.doing != _STOP)
            applied = acted | (ends.ended & stood)
            took = np.where(acted, self.time_s[:, None] - self.running.began_s, 0.0)
            for car, attempt in enumerate(attempts):
                if attempt is not None:
                    took[:, car] = attempt.duration_s
            chosen = np.where(ends.ended, self.running.requested, _STOP)
            transition = self.transition(
                before, chosen, applied, took, duration_s, attempts, contacts, problems
            )
        steps = self.score(
            applied, self.running.turn, transition, not problems, duration_s / USUAL_TICK_S
        )
        reward = steps.reward
        if time_weight:
            reward = reward - time_weight * duration_s
        self.running.earned[:] += reward[:, None]
        return replace(steps, reward=reward)

    @property
    def sees_marks(self) -> bool:
        """Whether the reward or success may look at the marks of worlds, as functions of a user's may."""
        success = self.task.success
        return self.task.reward.sees_marks or not (success is None or isinstance(success, str))

    def begins(self, actions: NDArray[np.int8]) -> NDArray[np.bool_]:
        """Return which of some legal actions a car that decides may begin now, as :meth:`Episodes.begins`."""
        may_begin = np.take_along_axis(
            self.legal(), np.maximum(actions, 0).astype(np.int64), axis=-1
        )
        return may_begin & (actions >= 0) & self.decides[..., None]

    def some(self, rows: NDArray[np.integer]) -> Self:
        """Return some of the episodes to look at; what is done to them is not done to these."""
        episodes = super().some(rows)
        episodes.running = Running._make(array[rows] for array in self.running)
        return episodes

    def _masks(self, depth: int) -> NDArray[np.bool_]:
        """Return (B, n, 15): what a car that decides may begin now: legal, and compatible with what runs.

        STOP alone where that is nothing, and for the others. With a depth also what is reachable.
        """
        out = np.zeros((len(self), self.n_cars, N_ACTIONS), np.bool_)
        scratch = self._row, self._plan, self._space
        events.offer(self.world, self.running, *scratch, depth, out)
        if not self.registered:
            return out
        mask = np.concatenate(
            [out, np.zeros((*out.shape[:2], len(self.registered)), np.bool_)], axis=-1
        )
        for i, car in np.argwhere(self.decides).tolist():
            for k, action in enumerate(self.registered, N_ACTIONS):
                mask[i, car, k] = self._try_registered(i, car, action)[0] == BEGUN
        return mask

    def deadlocked(self, rows: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Return (k,): in which of the worlds ``rows`` (k,) nothing can go on at an event.

        All cars have waited with nothing running, and no car has an action but to wait, or each has asked in vain for
        one that another car forbids.
        """
        outcome = self.running.outcome[rows]
        waited = self.decides[rows] & ((outcome == WAITS) | (outcome == ILLEGAL))
        idle = (self.lost[rows] | waited).all(1) & (self.queue[rows, :, 0] < 0).all(1)
        places = np.flatnonzero(idle)
        deadlocked = np.zeros(len(rows), np.bool_)
        if not len(places):
            return deadlocked
        in_vain = np.empty(len(places), np.bool_)
        worlds = self.world
        events.asked_in_vain(
            worlds, self.running, np.asarray(rows, np.int64)[places], self._row, in_vain
        )
        deadlocked[places[in_vain]] = True
        undecided = places[~in_vain]
        deadlocked[undecided] = self._stuck(rows[undecided])
        return deadlocked

    def _stuck(self, rows: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Return (k,): in which worlds no car may begin anything. A move by the helper begins with a legal action."""
        if not len(rows):
            return np.zeros(0, np.bool_)
        offered = self.some(rows).legal()
        offered[..., _STOP] = False
        return ~np.asarray(offered.any((1, 2)))

    def deadlock(self, i: int) -> Deadlock | None:
        """Return why nothing can go on in a world at an event, or None where something can: :meth:`deadlocked`."""
        row = np.array([i])
        if not self.deadlocked(row)[0]:
            return None
        lost = self.lost[i]
        stuck = self._stuck(row)[0]
        words = []
        idle = []
        pairs = []
        for car in range(self.n_cars):
            reasons: dict[int, str] = {}
            if not lost[car]:
                reasons = self._waits_for(
                    i, car, None if stuck else int(self.running.requested[i, car])
                )
            for other_car, reason in reasons.items():
                pairs.append((car, other_car))
                words.append(f"car {car} waits for car {other_car}: {reason}")
            if not reasons:
                idle.append(f"car {car} {'does not answer' if lost[car] else 'can do nothing'}")
        return Deadlock("; ".join(words + idle), tuple(pairs))

    def _waits_for(self, i: int, car: int, action: int | None) -> dict[int, str]:
        """Return why a car cannot act, by each other car without which it could; ``action`` is what it asked for."""
        grid = self.grid(i)
        world = grid.world(self.corrections, self.patterns)
        reasons: dict[int, str] = {}
        for other_car in range(self.n_cars):
            for attempted in Action if action is None else (Action(action),):
                if (
                    other_car == car
                    or other_car in reasons
                    or attempted >= N_ACTIONS
                    or attempted == _STOP
                ):
                    continue
                if events.stands_against(
                    world, self.running, i, car, int(attempted), other_car, self._row
                ):
                    legal = not batch.reason(*world, car, attempted)
                    claims = f"its claims stand against {attempted.name}"
                    if legal:
                        reasons[other_car] = claims
                    else:
                        reasons[other_car] = str(explain(grid, self.rules, car, attempted))
        return reasons

    def activity(self) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
        """Return what each car sees of what all are doing, and of what is claimed.

        That is (B, n, n, 2), of each car what it does, -1 if it decides, and the seconds since that began; and
        (B, n, L, W, H + 1), 1 for each cell that what runs has claimed. Both are views of the same for all cars.
        """
        cars = self.running.action.shape
        doing = np.empty((*cars, 2), np.float32)
        claimed = np.zeros(self.grids.cells.shape[:4], np.int8)
        events.write_activity(self.running, doing, claimed)
        b, n = cars
        shared = np.broadcast_to(doing[:, None], (b, n, n, 2))
        return shared, np.broadcast_to(claimed[:, None], (b, n, *claimed.shape[1:]))

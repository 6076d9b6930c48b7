"""Asynchronous execution: it agrees with ticks where all actions take the same time, and keeps to its claims."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from discrete.worldgen import conflict
from pettingzoo.test import api_test, parallel_api_test
from registered import forget

import craftsim
from craftsim.checking.setup import RANDOMIZE
from craftsim.discrete.actions import footprint
from craftsim.discrete.grid import Grid, Kind, Piece, check_values
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.tasks import make_task
from craftsim.tasks.asynchronous import BEGUN, BLOCKED, ILLEGAL, WAITS, AsynchronousEpisodes, Timing
from craftsim.tasks.episodes import Episodes

STOP = int(Action.STOP)
RULES = Rules("physical")
CASES = [
    ("simple_two_story", None, {}),
    ("complex_two_story", None, {}),
    ("strip", 3, {}),
    ("free_building", 4, {}),
    ("breaking_barrier", None, {}),
    ("simple_two_story", None, {"helper_depth": 10}),
]


def aec(task="simple_two_story", n_cars=None, backend="grid", max_steps=None, **options):
    task = make_task(task, n_cars=n_cars, **({} if max_steps is None else {"max_steps": max_steps}))
    return craftsim.env(task, backend, execution="asynchronous", **options)


def pick(rng, mask):
    return int(rng.choice(np.flatnonzero(mask)))


@pytest.mark.parametrize(("task", "n_cars", "options"), CASES)
def test_batches_of_equal_durations_give_what_ticks_give(task, n_cars, options):
    """170 episodes a case, 1,020 in all; what a claim blocks is a STOP in ticks, which know no claims."""
    n, made = 170, make_task(task, n_cars=n_cars, max_steps=25)
    rng, depth = np.random.default_rng(0), options.get("helper_depth")
    starts = made.draw_starts(rng, n)
    ticks = Episodes(made, rng, n, "physical", depth, starts)
    events = AsynchronousEpisodes(
        made, rng, n, "physical", depth, starts, timing=Timing(equal=True)
    )
    same, compared = np.ones(n, bool), 0
    while not ticks.done.any() or not ticks.done[same].all():
        masks = events.offered()
        actions = (rng.random(masks.shape) * masks).argmax(-1)
        order, queued = ticks.draw_order(), ticks.queue[:, :, 0] >= 0
        out = events.decide(actions, order)
        one = events.settle(None, events.advance(), 0.0)
        # A car that goes on with the queue of the helper cannot be made to wait in ticks.
        same &= ~((out == BLOCKED) & (queued | (depth is not None))).any(1)
        two = ticks.step(np.where(out == BLOCKED, STOP, actions), order)
        for a, b in (
            (events.confirmed.cars, ticks.grids.cars),
            (events.confirmed.kind, ticks.grids.kind),
            (events.confirmed.yaw, ticks.grids.yaw),
            (events.grids.cars, ticks.grids.cars),
            (events.queue, ticks.queue),
            (one.success, two.success),
            (one.done, two.done),
            (one.reward, two.reward),
            # With the helper a MOVE without a way is a legal STOP in ticks; on a ramp the rules forbid a STOP.
            (
                out == BEGUN,
                two.applied
                & (out != WAITS)
                & (out != BLOCKED)
                & ((depth is None) | (out == BEGUN)),
            ),
        ):
            np.testing.assert_array_equal(a[same], b[same])
        compared += int(same.sum())
        assert (events.time_s == events.running.decided / made.layout.n_cars).all()
        if depth is not None and not same.any():
            break
    assert compared > 10 * n


@pytest.mark.parametrize("task", ["strip", "complex_two_story"])
def test_what_is_offered_is_what_a_schedule_lets_run_beside_the_rest(task):
    episodes = AsynchronousEpisodes(
        make_task(task), np.random.default_rng(0), 6, timing=Timing(jitter=0.4, failures=0.2)
    )
    rng, running, compared, refused = np.random.default_rng(1), {}, 0, 0
    for _ in range(60):
        masks, grids = episodes.offered(), [episodes.grid(i) for i in range(6)]
        for i, car in np.argwhere(episodes.decides).tolist():
            legal = RULES.mask(grids[i])[car]
            others = [needs for (world, _), needs in running.items() if world == i]
            expected = np.zeros(15, bool)
            for action in np.flatnonzero(legal):
                step = make_schedule(grids[i], [[(car, Action(action))]], RULES).steps[0]
                clash = action != STOP and any(conflict(needs, step.footprint) for needs in others)
                expected[action] = not clash
                compared, refused = compared + bool(others), refused + clash
            expected[STOP] |= not expected.any()
            np.testing.assert_array_equal(masks[i, car], expected)
        actions = np.array([[pick(rng, mask) for mask in masks[i]] for i in range(6)])
        order = episodes.draw_order()
        out = episodes.decide(actions, order)
        for i in range(6):
            grid = grids[i]
            for car in order[i].tolist():
                if out[i, car] == BEGUN:
                    then = RULES.apply(grid, car, Action(actions[i, car]))
                    running[i, car] = footprint(grid, then, car, Action(actions[i, car]))
                    grid = then
            assert grid.same_visible(episodes.grids[i])
        ends = episodes.advance()
        episodes.settle(None, ends, 0.0)
        running = {key: needs for key, needs in running.items() if not ends.ended[key]}
        for i in range(6):
            committed = episodes.confirmed[i].copy()
            for car in np.argsort(episodes.running.turn[i]).tolist():
                if episodes.running.action[i, car] not in (-1, STOP):
                    committed = RULES.enforce(committed, car, int(episodes.running.action[i, car]))
            assert committed.same_visible(episodes.grids[i])
            check_values(episodes.grid(i))
        over = np.flatnonzero(episodes.done)
        running = {key: needs for key, needs in running.items() if key[0] not in over}
        episodes.reset(over)
    assert compared > 500
    assert refused >= 20


@pytest.mark.parametrize("helper_depth", [None, 10])
def test_a_batch_is_its_worlds_one_by_one(helper_depth):
    options = {
        "jitter": 0.3,
        "failures": 0.2,
        "helper_depth": helper_depth,
        "time_weight": 0.1,
        "wait_s": 0.5,
    }
    task, rng = make_task("simple_two_story", max_steps=12), np.random.default_rng(0)
    envs = craftsim.vector_env(task, 5, execution="asynchronous", **options)
    seen, infos = envs.reset(seed=0)
    ones = [
        craftsim.parallel_env(task, "grid", execution="asynchronous", **options) for _ in range(5)
    ]
    drawn = SimpleNamespace()

    def keep(name, function):
        def call(*arguments):
            setattr(drawn, name, function(*arguments))
            return getattr(drawn, name)

        return call

    episodes = envs.episodes
    episodes.draw_order = keep("order", episodes.draw_order)
    timing = episodes.timing
    episodes.timing = SimpleNamespace(
        wait_s=timing.wait_s,
        nominal_s=timing.nominal_s,
        factors=keep("factors", timing.factors),
        fails=keep("fails", timing.fails),
    )

    class Same:
        """What the batch has drawn, for the car that begins."""

        def __init__(self, i, backend):
            self.i, self.begin, self.nominal_s = i, backend.begin, timing.nominal_s
            backend.begin, backend._timing = self.of, self

        def of(self, car, action, *rows):
            self.car = car
            self.begin(car, action, *rows)

        def factors(self, rng, shape):
            return drawn.factors[self.i, self.car]

        def fails(self, rng, shape):
            return drawn.fails[self.i, self.car]

    for i, one in enumerate(ones):
        one.reset(options={"grid": episodes.grid(i)})
        Same(i, one.core.backend)
    n_ended = 0
    for _ in range(70):
        decides, masks = infos["decides"], seen["action_mask"]
        actions = np.array([[pick(rng, mask) for mask in masks[i]] for i in range(5)])
        seen, reward, terminated, truncated, infos = envs.step(actions)
        for i, one in enumerate(ones):
            assert set(one.core.turns) == set(np.flatnonzero(decides[i]))
            np.testing.assert_array_equal(one.core.masks, masks[i])
            one.core.turns = [car for car in drawn.order[i].tolist() if decides[i, car]]
            earned, *ends, infos_of_one = one.core.step(actions[i])
            over = terminated[i] | truncated[i]
            assert earned == pytest.approx(reward[i])
            assert ends == [terminated[i], truncated[i]]
            last = infos["final_obs"][i] if over else {key: value[i] for key, value in seen.items()}
            np.testing.assert_array_equal(one.core.state(), last["observation"])
            for key in ("doing", "claimed"):
                np.testing.assert_allclose(one.core.seen[key], last[key], atol=1e-5)
            for car, info in enumerate(infos_of_one):
                assert info["duration_s"] == pytest.approx(infos["duration_s"][i])
                for key in ("illegal", "blocked") if decides[i, car] else ():
                    assert info[key] == infos[key][i, car]
                assert info["failed"] == infos["failed"][i, car]
                for key in ("elapsed_s", "earned"):
                    assert info[key] == pytest.approx(infos[key][i, car])
            if over:
                n_ended += 1
                one.reset(options={"grid": episodes.grid(i)})
    assert n_ended >= 5


def test_rewards_come_with_the_end_of_an_action_and_sum_to_what_the_team_gets():
    task = make_task("strip", max_steps=25)
    env = craftsim.parallel_env(task, "grid", execution="asynchronous", jitter=0.2, time_weight=0.1)
    rng, total, team = np.random.default_rng(0), dict.fromkeys(env.possible_agents, 0.0), 0.0
    seen, infos = env.reset(seed=3)
    start = env.core.episodes.potential[0]
    while env.agents:
        acting = set(env.agents_to_act)
        actions = {agent: pick(rng, one["action_mask"]) for agent, one in seen.items()}
        seen, rewards, _, _, infos = env.step(actions)
        team -= 0.1 * infos["car_0"]["duration_s"]
        for agent, reward in rewards.items():
            total[agent] += reward
            assert infos[agent]["ignored"] == (agent not in acting)
            if env.agents and not infos[agent]["decides"]:
                assert reward == 0.0
                assert seen[agent]["action_mask"].nonzero()[0].tolist() == [STOP]
    assert total == pytest.approx(
        dict.fromkeys(total, team + env.core.episodes.potential[0] - start)
    )


def test_what_a_tick_costs_is_charged_by_time():
    env = craftsim.parallel_env("breaking_barrier", "grid", execution="asynchronous", wait_s=0.25)
    env.reset(seed=0)
    _, rewards, *_ = env.step(dict.fromkeys(env.agents, STOP))
    assert set(rewards.values()) == {-0.25}
    envs = craftsim.vector_env("breaking_barrier", 40, execution="asynchronous", jitter=0.3)
    (seen, _), rng = envs.reset(seed=0), np.random.default_rng(0)
    for _ in range(30):
        before = envs.episodes.potential.copy()
        actions = np.array([[pick(rng, mask) for mask in masks] for masks in seen["action_mask"]])
        seen, reward, terminated, truncated, infos = envs.step(actions)
        same = (envs.episodes.potential == before) & ~(terminated | truncated)
        np.testing.assert_allclose(reward[same], -infos["duration_s"][same])


def episode(env, seed):
    """Return all that happens in a random episode."""
    env.reset(seed=seed)
    rng, found = np.random.default_rng(seed), []
    for agent in env.agent_iter():
        seen, reward, terminated, truncated, info = env.last()
        found.append(
            (agent, seen["observation"].tolist(), seen["doing"].tolist(), reward, info["elapsed_s"])
        )
        env.step(None if terminated or truncated else pick(rng, seen["action_mask"]))
    return found


def test_equal_seeds_are_equal_and_durations_and_failures_are_drawn():
    env = aec(max_steps=20, jitter=0.3, failures=0.3)
    assert (
        episode(env, 5)
        == episode(env, 5)
        == episode(aec(max_steps=20, jitter=0.3, failures=0.3), 5)
    )
    assert episode(env, 5) != episode(env, 6)
    never = aec(max_steps=20, failures=1.0)
    never.reset(seed=0)
    start = never.core.grid
    episode(never, 0)
    assert never.core.episodes.confirmed[0].same_visible(start)


def test_a_deadlock_ends_the_episode_and_says_who_waits_for_whom():
    task = make_task("simple_two_story")
    grid = Grid.empty(task.starts[0].size, 2)
    grid.put(Piece(Kind.BODY, (2, 1, 1), 0))
    grid.kind[1, 1, 1] = Kind.BLOCK
    grid.cars[:] = (3, 1, 1, 2, 0, 0, 1), (2, 1, 2, 0, 0, 0, 2)
    grid.derive_marks()
    env = craftsim.parallel_env(task, "grid", execution="asynchronous")
    env.reset(options={"grid": grid})
    _, _, terminated, truncated, infos = env.step({"car_0": STOP, "car_1": STOP})
    assert (any(terminated.values()), all(truncated.values())) == (False, True)
    deadlock = infos["car_0"]["deadlock"]
    assert deadlock.pairs == ((0, 1), (1, 0))
    assert "car 0 waits for car 1: MOVE_LEFT is forbidden" in deadlock.words
    envs = craftsim.vector_env(task.starting_from([grid]), 3, execution="asynchronous")
    envs.reset(seed=0)
    _, _, _, truncated, infos = envs.step(np.full((3, 2), STOP))
    assert infos["deadlock"].all()
    assert truncated.all()


def _has_a_car_in_its_way(episodes, i, car):
    """Return whether the rules would allow what a car asked for, were some other car not there."""
    grid = episodes.grid(i)
    asked = int(episodes.running.requested[i, car])
    for other in range(episodes.n_cars):
        without = grid.copy()
        without.cars[other, 2] += 2 * grid.size[2]
        if other != car and RULES.legal(without, car, asked) and not RULES.legal(grid, car, asked):
            return True
    return False


def test_a_batch_finds_deadlocks_by_their_definition_and_writes_no_words_for_them(monkeypatch):
    """Unmasked play asks in vain very often: whether another car is why is not looked up in words."""
    task = make_task("simple_two_story", max_steps=40)
    rng = np.random.default_rng(1)
    episodes = AsynchronousEpisodes(task, rng, 200, timing=Timing(jitter=0.1))

    def no_words(*_):
        raise AssertionError("words that nobody reads")

    monkeypatch.setattr("craftsim.tasks.asynchronous.explain", no_words)
    deadlocks = 0
    in_vain = 0
    for _ in range(60):
        offered = episodes.offered()
        actions = rng.integers(0, len(Action), offered.shape[:2])
        crowded = rng.random(len(actions)) < 0.5
        actions[crowded] = rng.integers(Action.MOVE_FORWARD, Action.STOP, (int(crowded.sum()), 2))
        event = episodes.step(actions, offered=offered)
        vain = (episodes.running.outcome == ILLEGAL).all(1)
        for i in np.flatnonzero(vain).tolist():
            blocked = all(_has_a_car_in_its_way(episodes, i, car) for car in range(2))
            assert event.deadlock[i] == blocked
            in_vain += 1
            deadlocks += blocked
        assert not event.deadlock[~vain].any()
        episodes.reset(np.flatnonzero(event.done | event.deadlock))
    assert in_vain > 500
    assert deadlocks > 3


def test_registered_actions_run_beside_the_others_and_claim_their_cells():
    def beside(grid, car):
        return None if grid.cars[car, 2] == 1 and grid.cars[car, 4] == 0 else "the car is not free"

    def about(grid, car):
        grid.cars[car, 3] = (grid.cars[car, 3] + 2) % 4

    def around(before, after, car):
        x, y, z = before.cars[car, :3].tolist()
        return [(x + dx, y + dy, z) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]

    own = craftsim.register_action("SPIN", beside, about, duration_s=4.0, footprint=around)
    try:
        env = craftsim.parallel_env(
            "simple_two_story", "grid", execution="asynchronous", actions=(own,), wait_s=9.0
        )
        grid = Grid.empty(make_task("simple_two_story").starts[0].size, 2)
        grid.cars[:, :4] = (1, 1, 1, 0), (3, 1, 1, 0)
        grid.derive_marks()
        seen, _ = env.reset(options={"grid": grid})
        assert seen["car_0"]["action_mask"][15] == 1
        seen, _, _, _, infos = env.step({"car_0": 15, "car_1": int(Action.ROTATE_LEFT)})
        assert env.agents_to_act == ["car_1"]
        assert seen["car_1"]["claimed"][0:3, 0:3, 1].all()
        assert seen["car_0"]["doing"][0, 0] == 15
        # The other car spins beside this one only if no cell of the two is the same.
        mask = seen["car_1"]["action_mask"]
        assert (mask[Action.MOVE_LEFT], mask[Action.ROTATE_LEFT], mask[15]) == (0, 1, 0)
        seen, _, _, _, infos = env.step({"car_1": int(Action.MOVE_LEFT)})
        assert (infos["car_1"]["blocked"], infos["car_0"]["decides"]) == (True, True)
        assert env.core.episodes.time_s[0] == 4.0
        assert env.grid.cars[0, 3] == 2
    finally:
        forget()


@pytest.mark.parametrize(
    ("task", "backend", "options", "cycles"),
    [
        ("simple_two_story", "grid", {}, 60),
        (
            "strip",
            "grid",
            {"jitter": 0.3, "failures": 0.3, "helper_depth": 10, "local_view": 2},
            60,
        ),
        ("strip", "physics", {}, 4),
    ],
)
def test_pettingzoo_takes_both_forms(task, backend, options, cycles):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        api_test(aec(task, backend=backend, max_steps=20, **options), num_cycles=2 * cycles)
        env = craftsim.parallel_env(task, backend, execution="asynchronous", **options)
        parallel_api_test(env, num_cycles=cycles)


def test_equal_seeds_are_bit_equal_in_physics():
    env = craftsim.parallel_env("strip", execution="asynchronous", randomization=RANDOMIZE["mild"])
    runs = []
    for seed in (5, 5, 6):
        rng, (seen, _), states = np.random.default_rng(0), env.reset(seed=seed), []
        for _ in range(8):
            seen, *_ = env.step(
                {agent: pick(rng, one["action_mask"]) for agent, one in seen.items()}
            )
            data = env.core.backend.judge.physics.data
            states.append(data.qpos.tobytes() + np.float64(data.time).tobytes())
        runs.append(states)
    env.close()
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_a_batch_in_physics_says_who_decides():
    envs = craftsim.vector_env(
        make_task("strip", max_steps=1),
        2,
        "physics",
        workers=1,
        execution="asynchronous",
        wait_s=0.3,
    )
    try:
        seen, infos = envs.reset(seed=0)
        rng, decides = np.random.default_rng(0), np.ones((2, 2), bool)
        for _ in range(6):
            np.testing.assert_array_equal(seen["doing"][:, 0, :, 0] == -1, decides)
            actions = np.array(
                [[pick(rng, mask) for mask in masks] for masks in seen["action_mask"]]
            )
            seen, _, _, _, infos = envs.step(actions)
            decides = infos["decides"]
            assert decides.any(1).all()
            assert (infos["elapsed_s"][~decides] == 0).all()
    finally:
        envs.close()

"""Terms of rewards: each has an example here, and all are summed by one function, whatever performs the tick."""

import copy
import pickle
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from registered import forget

from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError
from craftsim.tasks import as_task, make_task
from craftsim.tasks.asynchronous import AsynchronousEpisodes, Timing
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.rewards import (
    REWARDS,
    TERMS,
    PotentialTerm,
    Reward,
    make_reward,
    register_term,
)
from craftsim.tasks.starts import Starts, targets_of

STOP = int(Action.STOP)


@pytest.fixture
def free_names():
    yield
    forget()


def bare(task):
    """Return the start of a task without anything on the floor."""
    grid = task.draw(np.random.default_rng(0))
    grid.kind[:, :, 1:] = Kind.AIR
    return grid


def with_pieces(task, *pieces):
    """Return the same with pieces: kind, cell, and for slopes yaw."""
    grid = bare(task)
    for kind, cell, *yaw in pieces:
        grid.kind[cell] = kind
        grid.yaw[cell] = yaw[0] if yaw else 0
    return grid


def built(name):
    """Return a task, and its world with all cells of the design."""
    task = make_task(name)
    pieces = [(target.kind, target.cell, max(target.yaw, 0)) for target in task.design.targets]
    return task, with_pieces(task, *pieces)


def paid(term, task, after, before=None, t=1, **facts):
    """Return what a term pays for a tick from one world to another; ``facts`` are of its Transition."""
    before = bare(task) if before is None else before
    task = replace(task, reward=Reward({term: 1.0}))
    starts = Starts(before[None], targets_of(task.design)[None])
    episodes = Episodes(task, np.random.default_rng(0), starts=starts)
    episodes.t[:] = t
    episodes.put(0, after)
    shape = (1, episodes.n_cars)
    applied = facts.pop("applied", np.ones(shape, bool))
    transition = episodes.transition(
        before[None],
        np.full(shape, STOP),
        applied,
        np.zeros(shape),
        np.array([facts.pop("duration_s", 0.0)]),
        **facts,
    )
    (reward,) = episodes.score(applied, episodes.draw_order(), transition).reward
    return reward


def barrier(x):
    """Return the barrier task, and its world with the flag so many cells from the goal."""
    task = make_task("breaking_barrier")
    goal_x, y, z = task.goal_cell
    return task, with_pieces(task, (Kind.FLAG, (goal_x + x, y, z)))


STRIP, STRIP_BUILT = built("strip")
FREE = make_task("free_building")
ROW = [(Kind.BLOCK, (x, 0, 1)) for x in range(3)]
TALL = as_task("large_free_building_4")
TOWER = with_pieces(TALL, *[(Kind.BLOCK, (0, 0, z)) for z in (1, 2, 3)])
BARRIER, FAR = barrier(3)
NEAR = barrier(1)[1]
ARRIVED = barrier(0)[1]
WRONG = SimpleNamespace(result="failed")
RIGHT = SimpleNamespace(result="as predicted")

EXAMPLES = {
    "building": (8, lambda: paid("building", STRIP, STRIP_BUILT)),
    "complex_building": (
        16,
        lambda: paid("complex_building", *built("complex_two_story")),
    ),
    # In the first tick the whole potential, that of the start included.
    "published_building": (
        12,
        lambda: paid("published_building", STRIP, STRIP_BUILT, before=STRIP_BUILT, t=0),
    ),
    "platform": (2, lambda: paid("platform", FREE, with_pieces(FREE, *ROW))),
    "published_platform": (3, lambda: paid("published_platform", FREE, with_pieces(FREE, *ROW))),
    "complexity": (3, lambda: paid("complexity", TALL, TOWER)),
    "structure": (52, lambda: paid("structure", TALL, TOWER)),
    "flag_nearness": (2, lambda: paid("flag_nearness", BARRIER, NEAR, before=FAR)),
    "flag_at_goal": (1, lambda: paid("flag_at_goal", BARRIER, ARRIVED, before=FAR)),
    "published_flag_steps": (2, lambda: paid("published_flag_steps", BARRIER, NEAR, before=FAR)),
    "published_flag_bonus": (17, lambda: paid("published_flag_bonus", BARRIER, ARRIVED, t=3)),
    "tick": (1, lambda: paid("tick", STRIP, bare(STRIP))),
    "illegal_actions": (
        2,
        lambda: paid("illegal_actions", STRIP, bare(STRIP), applied=np.array([[False, False]])),
    ),
    "failures": (1, lambda: paid("failures", STRIP, bare(STRIP), attempts=(RIGHT, WRONG))),
    "seconds": (2.5, lambda: paid("seconds", STRIP, bare(STRIP), duration_s=2.5)),
}
"""By term what a tick pays, and how that is asked."""


@pytest.mark.parametrize("name", TERMS)
def test_each_term_pays_what_its_example_says(name):
    expected, pay = EXAMPLES[name]
    assert pay() == expected


def test_what_published_code_pays_depends_on_the_first_tick_and_what_was_paid():
    assert paid("published_building", STRIP, STRIP_BUILT, before=STRIP_BUILT) == 0
    assert paid("published_flag_steps", BARRIER, NEAR, before=FAR, t=0) == 0
    assert paid("published_flag_bonus", BARRIER, ARRIVED, t=0) == 0
    task = replace(BARRIER, reward=Reward({"published_flag_bonus": 1.0}), ends_on_success=False)
    episodes = Episodes(task, np.random.default_rng(0))
    stop = np.full((1, episodes.n_cars), STOP)
    bonuses = []
    for world in (FAR, ARRIVED, ARRIVED, FAR, ARRIVED):
        episodes.put(0, world)
        bonuses += episodes.step(stop).reward.tolist()
    assert bonuses == [0, 19, 0, 0, 0]


def _episodes(reward, execution, n=20):
    task = replace(make_task("free_building", max_steps=60), reward=reward)
    rng = np.random.default_rng(4)
    if execution == "ticks":
        return Episodes(task, rng, n)
    return AsynchronousEpisodes(task, rng, n, timing=Timing(jitter=0.2))


def _play(episodes, ticks=25):
    """Return (ticks, B): the rewards of random actions, legal or not, the same in every call."""
    rng = np.random.default_rng(7)
    rewards = []
    for _ in range(ticks):
        actions = rng.integers(0, len(Action), (len(episodes), episodes.n_cars))
        rewards.append(episodes.step(actions, episodes.draw_order()).reward)
    return np.array(rewards)


@pytest.mark.parametrize("execution", ["ticks", "asynchronous"])
def test_a_reward_is_the_weighted_sum_of_its_terms(execution):
    weights = {"platform": 1.0, "tick": -0.5, "illegal_actions": -0.25, "seconds": -0.125}
    total = _play(_episodes(Reward(weights), execution))
    parts = [_play(_episodes(Reward({name: w}), execution)) for name, w in weights.items()]
    np.testing.assert_allclose(total, np.sum(parts, axis=0), atol=1e-12)
    assert all(np.any(part) for part in parts)


def test_what_a_tick_costs_is_charged_for_time_in_asynchronous_execution():
    episodes = _episodes(Reward({"tick": -2.0}), "asynchronous")
    stop = np.full((len(episodes), 2), STOP)
    actions = stop.copy()
    actions[:, 0] = Action.MOVE_RIGHT
    for chosen in (stop, actions, stop):
        event = episodes.step(chosen)
        np.testing.assert_allclose(event.reward, -2.0 * event.duration_s)


def test_the_potential_is_of_terms_that_pay_changes():
    reward = make_reward({"paper": 2.0, "tick": -1.0}, "flag_at_goal")
    assert reward.terms == {"flag_nearness": 2.0, "flag_at_goal": 20.0, "tick": -3.0}
    task = replace(BARRIER, reward=reward)
    assert task.potential(FAR[None], targets_of(None)[None]).tolist() == [-6.0]
    assert Reward({"seconds": -1.0}).potential([], 2).tolist() == [0.0, 0.0]


def blocks(grids, designs, layout):
    return (grids.kind == Kind.BLOCK).sum(axis=(1, 2, 3))


def test_a_registered_term_is_known_by_its_name_and_copies_keep_the_name(free_names):
    register_term("blocks", PotentialTerm(blocks))
    assert paid("blocks", FREE, with_pieces(FREE, *ROW)) == 3
    register_term("hands", lambda tick: (tick.after.cars[..., 4] != 0).sum(axis=1))
    task = make_task("strip", reward={"paper": 1.0, "hands": 0.5})
    episodes = Episodes(task, np.random.default_rng(0), 3)
    _play(episodes, 2)
    for other in (copy.deepcopy(episodes), pickle.loads(pickle.dumps(episodes))):
        assert other.task.reward == task.reward
        assert np.array_equal(_play(other, 5), _play(copy.deepcopy(episodes), 5))
    for name, term, message in (
        ("building", blocks, "'building' is a term or reward of craftsim's own"),
        ("paper", blocks, "'paper' is a term or reward of craftsim's own"),
        ("two words", blocks, "made of letters, digits and _"),
        ("three", 3, "must be a PotentialTerm or a function, not 3"),
    ):
        with pytest.raises(InputError, match=message):
            register_term(name, term)


def test_a_potential_for_one_world_is_refused():
    def for_one(grids, designs, layout):
        return 1.0

    with pytest.raises(InputError, match=r"a potential returned 1\.0; .* number a world, shape"):
        Episodes(replace(STRIP, reward=Reward({PotentialTerm(for_one): 1.0})), None, 1)


def test_a_reward_of_a_goal_needs_one():
    assert make_reward("complexity").terms == {"complexity": 1.0}
    for name in REWARDS:
        with pytest.raises(InputError, match=f"the reward '{name}' is of a goal"):
            make_reward(name)
    for reward, message in (
        ("papr", "unknown reward 'papr'; did you mean 'paper'"),
        ({"papr": 1}, "unknown reward 'papr'; did you mean 'paper'"),
        (["paper"], "a reward is a name, or a mapping of names and weights"),
        ({"paper": None}, "the weight of the reward term 'paper' is None"),
    ):
        with pytest.raises(InputError, match=message):
            make_reward(reward, "built")

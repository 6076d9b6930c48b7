"""What is chosen by a word: each word has its own meaning everywhere, and an unknown one is an error, no default."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

import craftsim
from craftsim.checking.attempt import Verdict
from craftsim.checking.setup import setup_of
from craftsim.discrete.kinds import Action, Execution, Kind
from craftsim.envs.text import goal_text
from craftsim.errors import InputError, check_choice
from craftsim.experiments.counterexample import _RESULTS
from craftsim.learning.settings import AlgoName, PresetName
from craftsim.reports.report import Tone
from craftsim.reports.terminal import _STYLES
from craftsim.tasks import TASK_NAMES, make_task
from craftsim.tasks.kernel import TYPE_FLAGS
from craftsim.tasks.random_tasks import STEP_LIMITS
from craftsim.tasks.rewards import GOALS
from craftsim.tasks.task import _REWARDS, RewardName
from craftsim.validation.options import PlanOrder
from craftsim.validation.rollout import steps_of
from craftsim.workers.pool import Engine, Pool

torch = pytest.importorskip("torch")

from craftsim.learning.config import (  # noqa: E402 (after the check for torch)
    _GRID_WORLDS,
    IS_SAMPLED,
    IS_VARIED,
    Acting,
    NetworkName,
    TrainConfig,
    protocol,
    settings_of,
)
from craftsim.learning.evaluation import evaluate  # noqa: E402
from craftsim.learning.features import make_encoder  # noqa: E402
from craftsim.learning.policy_gradient import COMALearner, PPOLearner  # noqa: E402
from craftsim.learning.q_learning import TEAMS, PQNLearner, QLearner  # noqa: E402
from craftsim.learning.settings import KINDS  # noqa: E402
from craftsim.learning.shape import Shape  # noqa: E402
from craftsim.learning.trainer import LEARNERS, Trainer  # noqa: E402
from craftsim.learning.worlds import TIMINGS, GridWorlds  # noqa: E402

TABLES = {
    "settings": (KINDS, AlgoName),
    "worlds": (_GRID_WORLDS, AlgoName),
    "timings": (TIMINGS, Execution),
    "sampled": (IS_SAMPLED, Acting),
    "varied": (IS_VARIED, Acting),
}
STRIP = make_task("strip")
SHAPE = Shape.of(STRIP, 8)


@pytest.mark.parametrize(("table", "words"), TABLES.values(), ids=TABLES)
def test_a_table_has_an_entry_for_each_word(table, words):
    assert {*table} == {*get_args(words)}


def test_a_table_has_an_entry_for_each_member():
    goals = {*GOALS} - {
        "three_high"
    }  # the goal of the large tasks alone, whose reward is their own
    assert {*_REWARDS} == {(goal, reward) for goal in goals for reward in get_args(RewardName)}
    assert {*STEP_LIMITS} == {*TASK_NAMES}
    assert {*_STYLES} == {*Tone}
    assert {*_RESULTS} == {*Verdict}
    without_rows = {Kind.AIR, Kind.GROUND, Kind.WALL, Kind.GEAR}
    assert {kind for kind in Kind if not TYPE_FLAGS[kind]} == without_rows


@pytest.mark.parametrize("algo", get_args(AlgoName))
def test_each_algorithm_has_a_learner_that_knows_it_and_learns(algo):
    kind = LEARNERS[KINDS[algo]]
    assert algo in kind.algos
    trainer = Trainer(TrainConfig("strip", algo, worlds=2, width=8))
    assert type(trainer.learner) is kind
    trainer.learner.update(trainer.play(0))


def test_the_algorithms_of_learners_are_all_there_are_and_differ():
    algos = [algo for kind in LEARNERS.values() for algo in kind.algos]
    assert sorted(algos) == sorted(get_args(AlgoName))
    assert {*TEAMS} == {*QLearner.algos}


@pytest.mark.parametrize("kind", [PPOLearner, COMALearner, QLearner, PQNLearner])
def test_a_learner_refuses_an_algorithm_that_it_does_not_know(kind):
    (settings,) = (settings for settings, learner in LEARNERS.items() if learner is kind)
    with pytest.raises(InputError, match=r"unknown algorithm 'ippa'.*there are"):
        kind(SHAPE, 2, "ippa", settings())


@pytest.mark.parametrize("network", get_args(NetworkName))
def test_each_network_has_an_encoder(network):
    assert (
        make_encoder(Shape.of(STRIP, 8, network)).absent == Shape.of(STRIP, 8, network).places - 1
    )


@pytest.mark.parametrize("goal", GOALS)
def test_each_goal_has_words(goal):
    words = goal_text(replace(STRIP, design=None, success=goal))
    assert words != goal_text(replace(STRIP, design=None, success=None))


UNKNOWN = {
    "order": lambda: steps_of([[(0, Action.MOVE_RIGHT)]], "tick"),
    "order of a validation": lambda: craftsim.validate("strip", plan="strip", order="tick"),
    "engine": lambda: Pool(1, "rya"),
    "rule set": lambda: setup_of(rules="physics"),
    "placement": lambda: craftsim.read_blueprint("strip").grid(np.random.default_rng(0), "sain"),
    "algorithm": lambda: settings_of("ippa", {}),
    "preset": lambda: protocol("papers", "strip", "ippo"),
    "network": lambda: Shape.of(STRIP, 8, "maps"),
    "execution": lambda: GridWorlds(STRIP, 1, execution="synchron"),
    "way of acting": lambda: evaluate(None, STRIP, 1, 0, acting="vary"),
}


@pytest.mark.parametrize("choose", UNKNOWN.values(), ids=UNKNOWN)
def test_an_unknown_word_is_an_error_that_says_what_there_is(choose):
    with pytest.raises(InputError, match=r"unknown .*; there are "):
        choose()


def test_a_choice_is_one_of_the_known_words():
    for words in (PlanOrder, PresetName, Engine):
        for word in get_args(words):
            check_choice("word", word, get_args(words))
    with pytest.raises(
        InputError, match=r"unknown word 'lokal'; did you mean 'local'\?; there are local, ray"
    ):
        check_choice("word", "lokal", get_args(Engine))

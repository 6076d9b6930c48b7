"""What is chosen by a word: each word has its own meaning everywhere, and an unknown one is an error, no default."""

from dataclasses import replace
from typing import get_args, get_type_hints

import numpy as np
import pytest

import craftsim
from craftsim.checking.attempt import Verdict
from craftsim.checking.setup import setup_of
from craftsim.discrete.kinds import Action, Execution, Kind
from craftsim.envs.text import goal_text
from craftsim.errors import InputError, check_choice
from craftsim.experiments.counterexample import _RESULTS
from craftsim.learning.algorithms import ALGORITHMS
from craftsim.learning.settings import PresetName
from craftsim.reports.report import Tone
from craftsim.reports.terminal import _STYLES
from craftsim.tasks import TASK_NAMES, make_task
from craftsim.tasks.kernel import TYPE_FLAGS
from craftsim.tasks.potentials import GOALS
from craftsim.tasks.random_tasks import STEP_LIMITS
from craftsim.tasks.rewards import REWARDS
from craftsim.validation.options import PlanOrder
from craftsim.validation.rollout import steps_of
from craftsim.workers.pool import Engine, Pool

torch = pytest.importorskip("torch")

from craftsim.learning.config import (  # noqa: E402 (after the check for torch)
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
from craftsim.learning.learner import Learner, learner_class  # noqa: E402
from craftsim.learning.policy_gradient import PPOLearner  # noqa: E402
from craftsim.learning.q_learning import QLearner  # noqa: E402
from craftsim.learning.shape import Shape  # noqa: E402
from craftsim.learning.trainer import Trainer  # noqa: E402
from craftsim.learning.worlds import TIMINGS, GridWorlds  # noqa: E402

TABLES = {
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
    assert all(goals <= {*by_goal} for by_goal in REWARDS.values())
    assert {*STEP_LIMITS} == {*TASK_NAMES}
    assert {*_STYLES} == {*Tone}
    assert {*_RESULTS} == {*Verdict}
    without_rows = {Kind.AIR, Kind.GROUND, Kind.WALL, Kind.GEAR}
    assert {kind for kind in Kind if not TYPE_FLAGS[kind]} == without_rows


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_each_algorithm_has_a_learner_of_its_own_that_learns_and_has_its_traits(algo):
    algorithm = ALGORITHMS[algo]
    kind = learner_class(algo)
    assert [name for name in ALGORITHMS if learner_class(name) is kind] == [algo]
    assert issubclass(kind, Learner)
    assert get_type_hints(kind)["settings"] is algorithm.settings
    assert algorithm.imitates == issubclass(kind, PPOLearner)
    assert algorithm.is_recurrent == issubclass(kind, QLearner)
    trainer = Trainer(TrainConfig("strip", algo, worlds=2, width=8))
    assert type(trainer.learner) is kind
    assert trainer.shape.layer_norm == (not algorithm.learns_probabilities)
    trainer.learner.update(trainer.play(0))


@pytest.mark.parametrize("network", get_args(NetworkName))
def test_each_network_has_an_encoder(network):
    assert (
        make_encoder(Shape.of(STRIP, 8, network)).table.num_embeddings
        == Shape.of(STRIP, 8, network).places
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

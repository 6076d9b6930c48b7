"""Which gains are tuned, and how turning a gain changes one."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from craftsim.audit.survey import situation_of
from craftsim.discrete.rules import Rules
from craftsim.skills.gains import SECTIONS, load_gains
from craftsim.tuning.tunable import FIXED, GROUPS, situations, tunable_gains, values_at, with_values

GAINS = load_gains()


def test_every_gain_is_tuned_or_says_why_it_is_not():
    every = {f"{section}.{f.name}" for section, kind in SECTIONS.items() for f in fields(kind)}
    assert {gain.name for gain in tunable_gains("all", GAINS)} == every - set(FIXED)
    assert set(FIXED) < every


def test_tolerances_and_times_of_giving_up_are_never_tuned():
    tuned = " ".join(gain.name for gain in tunable_gains("all", GAINS))
    words = ("tolerance", "certainty", "allowance", "blocked", "at_rest", "reached", "still", "tipped")
    assert not [word for word in words if word in tuned]


def test_zero_is_the_start_and_the_bounds_are_its_span():
    for gain in tunable_gains("all", GAINS):
        low, high = gain.bounds
        assert gain.value(0.0) == gain.start == gain.of(GAINS)
        assert -1 - 1e-12 <= low < 0 <= high <= 1 + 1e-12
        assert gain.value(-99) == pytest.approx(gain.least, rel=1e-5)
        assert gain.value(99) == pytest.approx(gain.most, rel=1e-5)
        assert gain.position(gain.value(low / 2)) == pytest.approx(low / 2, abs=1e-4)


def test_fractions_stay_fractions():
    tunable = {gain.name: gain for gain in tunable_gains("drive", GAINS)}
    assert tunable["drive.load_factor"].most == tunable["drive.motor_share"].most == 1


def test_turning_all_knobs_to_their_ends_makes_gains_that_a_file_may_hold():
    tunable = tunable_gains("all", GAINS)
    for end in (-1, 1):
        gains = with_values(GAINS, tunable, values_at(tunable, [end * math.inf] * len(tunable)))
        assert gains != GAINS


def test_what_is_not_of_the_subject_stays():
    tunable = tunable_gains("board", GAINS)
    gains = with_values(GAINS, tunable, {"board.gain": 3.0})
    assert gains == replace(GAINS, board=replace(GAINS.board, gain=3.0))


def test_every_situation_is_a_world_in_which_its_action_is_legal():
    assert len(set(situations("all"))) == len(situations("all"))
    for row in situations("all"):
        placed = situation_of(row, "physical").placed(np.random.default_rng(1))
        assert placed.legal(Rules("physical"))


def test_every_tuned_section_has_situations_of_its_own():
    assert sum(len(situations(section)) for section in GROUPS["all"]) == len(situations("all"))

"""Which gains are tuned, and how turning a gain changes one."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from craftsim.audit.survey import situation_of
from craftsim.discrete.rules import Rules
from craftsim.skills.gains import SECTIONS, load_gains
from craftsim.tuning.tunable import (
    FIXED,
    GAIN_GROUPS,
    situations,
    tunable_gains,
    values_at,
    with_values,
)

GAINS = load_gains()
TUNABLE = {gain.name: gain for gain in tunable_gains("all", GAINS)}


def test_every_gain_is_tuned_or_says_why_it_is_not_and_tolerances_never_are():
    every = {f"{section}.{f.name}" for section, kind in SECTIONS.items() for f in fields(kind)}
    assert TUNABLE.keys() == every - set(FIXED)
    assert set(FIXED) < every
    words = (
        "tolerance",
        "certainty",
        "allowance",
        "blocked",
        "at_rest",
        "reached",
        "still",
        "tipped",
    )
    assert not [word for word in words if word in " ".join(TUNABLE)]


def test_zero_is_the_start_and_the_bounds_are_its_span():
    for gain in TUNABLE.values():
        low, high = gain.bounds
        assert gain.value(0.0) == gain.start == gain.of(GAINS)
        assert -1 - 1e-12 <= low < 0 <= high <= 1 + 1e-12
        assert gain.value(-99) == pytest.approx(gain.low, rel=1e-5)
        assert gain.value(99) == pytest.approx(gain.high, rel=1e-5)
        assert gain.position(gain.value(low / 2)) == pytest.approx(low / 2, abs=1e-4)
    assert TUNABLE["drive.load_factor"].high == TUNABLE["drive.motor_share"].high == 1  # fractions


def test_what_is_tuned_makes_gains_that_a_file_may_hold_and_the_others_stay():
    tunable = [*TUNABLE.values()]
    for end in (-1, 1):
        gains = with_values(GAINS, tunable, values_at(tunable, [end * math.inf] * len(tunable)))
        assert gains != GAINS
    gains = with_values(GAINS, tunable_gains("board", GAINS), {"board.gain": 3.0})
    assert gains == replace(GAINS, board=replace(GAINS.board, gain=3.0))


def test_each_section_has_situations_of_its_own_in_which_the_action_is_legal():
    rows = situations("all")
    assert (
        len(set(rows))
        == len(rows)
        == sum(len(situations(section)) for section in GAIN_GROUPS["all"])
    )
    for row in rows:
        placed = situation_of(row, "physical").placed(np.random.default_rng(1))
        assert placed.legal(Rules("physical"))

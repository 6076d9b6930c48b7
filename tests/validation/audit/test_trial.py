"""A trial of the audit: a sample of what physical allows succeeds, and the limits decide."""

from dataclasses import replace

import pytest

from craftsim.audit.survey import survey
from craftsim.checking.attempt import Thresholds
from craftsim.checking.setup import setup_of
from craftsim.discrete.actions import ACTIONS, verbs
from craftsim.validation.audit.trial import Trial, try_it

NOMINAL = setup_of("none")
ALLOWED = [situation for situation, legal in survey() if legal]


def _of(verb):
    return [situation for situation in ALLOWED if ACTIONS[situation.acts[0]].verb == verb]


def _sample(per_verb):
    """Return situations of every action, more of moves, which vary most."""
    chosen = []
    for verb in verbs():
        mine = _of(verb)
        wanted = 3 * per_verb if verb == "MOVE" else per_verb
        chosen += mine[:: max(1, len(mine) // wanted)][:wanted]
    return chosen


SAMPLE = _sample(4)


@pytest.mark.parametrize("situation", SAMPLE, ids=lambda situation: situation.id)
def test_a_quick_sample_of_what_physical_allows_succeeds(situation):
    done = try_it(Trial(situation, True, 0, 1, NOMINAL))
    assert done.agrees, done
    assert done.attempts[0].agrees


def test_an_error_beyond_its_limit_is_a_failure_with_a_reason():
    strict = replace(NOMINAL, thresholds=Thresholds(car_m=-1.0))
    drop = _of("DROP")[0]
    done = try_it(Trial(drop, True, 0, 0, strict))
    assert not done.agrees
    (attempt,) = done.attempts
    assert (attempt.result, attempt.finding) == ("failed", "agrees")
    assert attempt.reason.startswith("the car is ")


def test_each_trial_of_a_situation_has_its_own_noise_and_physics():
    setup = setup_of("strong")
    stop = _of("STOP")[0]
    first, second, again = (try_it(Trial(stop, True, number, 0, setup)).attempts[0] for number in (0, 1, 0))
    assert first == again
    assert first.car_error_m != second.car_error_m

"""A trial of the audit: a sample of what physical allows succeeds, and the limits decide."""

from dataclasses import replace

import pytest

from craftsim.checking.attempt import Thresholds
from craftsim.checking.setup import setup_of
from craftsim.validation.audit.trial import Trial, try_it
from craftsim.validation.contexts.context import Verb
from craftsim.validation.contexts.survey import survey

NOMINAL = setup_of("none")
CONTEXTS = survey().contexts


def _sample(per_verb):
    """Return contexts of every action, more of moves, which vary most."""
    chosen = []
    for verb in Verb:
        mine = [context for context in CONTEXTS if context.verb is verb]
        wanted = 3 * per_verb if verb is Verb.MOVE else per_verb
        chosen += mine[:: max(1, len(mine) // wanted)][:wanted]
    return chosen


SAMPLE = _sample(4)


@pytest.mark.parametrize("context", SAMPLE, ids=lambda context: context.id)
def test_a_quick_sample_of_what_physical_allows_succeeds(context):
    done = try_it(Trial(context, True, 0, 1, NOMINAL))
    assert done.agrees, done
    assert done.attempts[0].agrees


def test_an_error_beyond_its_limit_is_a_failure_with_a_reason():
    strict = replace(NOMINAL, thresholds=Thresholds(car_m=-1.0))
    drop = next(context for context in CONTEXTS if context.verb is Verb.DROP)
    done = try_it(Trial(drop, True, 0, 0, strict))
    assert not done.agrees
    (attempt,) = done.attempts
    assert (attempt.result, attempt.finding) == ("failed", "agrees")
    assert attempt.reason.startswith("the car is ")


def test_each_trial_of_a_context_has_its_own_noise_and_physics():
    setup = setup_of("strong")
    stop = next(context for context in CONTEXTS if context.verb is Verb.STOP)
    first, second, again = (try_it(Trial(stop, True, number, 0, setup)).attempts[0] for number in (0, 1, 0))
    assert first == again
    assert first.car_error_m != second.car_error_m

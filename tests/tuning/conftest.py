"""The log of a car whose figures are hidden."""

import pytest
from tuning.tuning_cars import HIDDEN, NOMINAL, log_of

from craftsim.tuning.identification import identify

TIME_S = 16.0


@pytest.fixture(scope="session")
def log():
    """With mild noise."""
    return log_of(HIDDEN, TIME_S)


@pytest.fixture(scope="session")
def found(log):
    return identify(log, NOMINAL)

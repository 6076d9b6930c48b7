"""The log of a car whose figures are hidden."""

import pytest
from tuning_cars import HIDDEN, log_of


@pytest.fixture(scope="session")
def log():
    """Twenty seconds, with mild noise."""
    return log_of(HIDDEN, 20.0)

"""Find out once whether anything renders here; tests of physics do not need it."""

import pytest

from craftsim.rendering.backend import RenderingUnavailable, choose_backend

try:
    choose_backend()
    _WHY_NOT = ""
except RenderingUnavailable as error:
    _WHY_NOT = str(error)


@pytest.fixture
def rendering() -> None:
    """Skip the test where nothing renders."""
    if _WHY_NOT:
        pytest.skip(_WHY_NOT)

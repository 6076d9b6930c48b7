"""Tests of training run on one thread, which adds up in one order, and draw the same weights each time."""

from pathlib import Path

import pytest
import torch
from matplotlib.figure import Figure


def _leave_out(figure, path, dpi):
    Path(path).write_bytes(b"not rendered")


@pytest.fixture(autouse=True)
def _curves_are_not_rendered(request, monkeypatch):
    """Draw learning curves from their data, but leave out what matplotlib would do with them."""
    if "rendered_drawings" not in request.fixturenames:
        monkeypatch.setattr(Figure, "savefig", _leave_out)


@pytest.fixture(autouse=True)
def _one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(autouse=True)
def _same_weights():
    """Draw a test's networks alike whichever tests ran before: few weights tell nothing apart."""
    torch.manual_seed(0)

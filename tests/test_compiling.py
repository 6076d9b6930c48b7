"""While something is compiled, commands say how far it is, and so do the processes that they start."""

import io
import logging
import sys

import pytest

from craftsim.compiled import progress as compiling
from craftsim.workers.actor import spawn_context

pytestmark = pytest.mark.usefixtures("spawned")


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def log():
    compiling.report_compiling()
    yield compiling.PROGRESS_LOG
    for handler in list(compiling.PROGRESS_LOG.handlers):
        compiling.PROGRESS_LOG.removeHandler(handler)
    compiling.PROGRESS_LOG.setLevel(logging.NOTSET)
    compiling.PROGRESS_LOG.propagate = True


def test_on_a_terminal_one_line_is_written_again_and_removed_in_the_end(log, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(sys, "__stderr__", terminal)
    for done in range(3):
        log.info("compiled %d of %d", done, 2)
    assert (
        terminal.getvalue()
        == "\r\x1b[Kcraftsim: compiled 0 of 2\r\x1b[Kcraftsim: compiled 1 of 2\r\x1b[K"
    )


def test_elsewhere_a_line_follows_another_after_a_while(log, monkeypatch):
    file, seconds = io.StringIO(), [0.0, 0.9, 1.1, 2.0, 6.2, 7.0]
    monkeypatch.setattr(sys, "stderr", file)
    monkeypatch.setattr(compiling.time, "monotonic", iter(seconds).__next__)
    for done in range(len(seconds)):
        log.info("compiled %d of %d", done, 9)
    log.warning("not kept")
    assert file.getvalue().splitlines() == [
        "craftsim: compiled 2 of 9",
        "craftsim: compiled 4 of 9",
        "craftsim: not kept",
    ]


@pytest.mark.parametrize("told", [False, True])
def test_a_process_says_it_if_the_one_that_starts_it_does(told, request):
    if told:
        request.getfixturevalue("log")
    context = spawn_context()
    answers = context.SimpleQueue()
    process = context.Process(target=_answer, args=(answers,))
    process.start()
    assert answers.get() is told
    process.join()


def _answer(answers):
    answers.put(compiling.reports_compiling())

"""Ctrl-C is heard by the process that a person started, and by it alone; not at all where it is ignored."""

import os
import signal
import time

import pytest

from craftsim.workers.actor import defer_sigint, spawn_context
from craftsim.workers.pool import Pool

pytestmark = pytest.mark.usefixtures("spawned")


def test_a_process_that_still_imports_hears_of_no_interrupt_and_whoever_starts_it_hears_as_before():
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    process = spawn_context().Process(target=time.sleep, args=(0.0,))
    process.start()
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before
    os.kill(process.pid, signal.SIGINT)
    process.join()
    assert process.exitcode == 0


def test_workers_hear_of_no_interrupt():
    with Pool(1) as pool:
        assert list(pool.map_unordered(signal.raise_signal, [signal.SIGINT])) == [(signal.SIGINT, None)]


def test_where_an_interrupt_is_ignored_work_goes_on():
    usual = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with defer_sigint():
            signal.raise_signal(signal.SIGINT)
            assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, usual)


def test_what_is_under_way_ends_before_an_interrupt_is_heard():
    done = []

    def interrupted():
        with defer_sigint():
            signal.raise_signal(signal.SIGINT)
            done.append(1)

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert done

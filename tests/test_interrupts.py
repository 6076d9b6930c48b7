"""Ctrl-C is heard by the process that was started by hand, and by it alone."""

import os
import signal
import time
from multiprocessing import get_context

from craftsim.interrupts import kept_from_children
from craftsim.rendering.processes import Shielded


def test_a_process_that_still_imports_hears_of_no_interrupt():
    process = get_context("spawn").Process(target=time.sleep, args=(0.0,))
    with kept_from_children():
        process.start()
    os.kill(process.pid, signal.SIGINT)
    process.join()
    assert process.exitcode == 0


def test_whoever_starts_it_hears_as_before():
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    with kept_from_children():
        assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before


def test_processes_of_a_film_hear_of_no_interrupt():
    with Shielded(1, get_context("spawn")) as processes:
        processes.submit(signal.raise_signal, signal.SIGINT).result()

"""Functions for workers that go wrong in every way."""

import os
import signal
import time

from craftsim.errors import CraftsimError


class UnsendableError(Exception):
    """Stands no pickling."""

    def __init__(self, one, two):
        super().__init__(one)


def square(job):
    match job:
        case "die":
            os.kill(os.getpid(), signal.SIGKILL)
        case "hang":
            time.sleep(3600)
        case "raise":
            raise CraftsimError("no square")
        case "unsendable":
            raise UnsendableError(1, 2)
        case ("die once", mark) if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return job * job if isinstance(job, int) else "squared"


def never():
    """Make no handler: such a worker answers nothing, as one on a cluster without a free processor."""
    time.sleep(3600)


class Counter:
    """Counts the jobs that its worker has done for it."""

    def __init__(self):
        self.n = 0

    def __call__(self, job):
        self.n += 1
        return os.getpid(), self.n

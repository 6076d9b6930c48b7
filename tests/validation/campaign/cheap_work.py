"""Work that costs nothing and goes wrong in every way, for campaigns; imported by their workers."""

import errno
import os
import signal
import time
from pathlib import Path

from craftsim.experiments.experiment import Experiment, Result, Trial


def items(n, **jobs):
    """Return n items; ``jobs`` gives some of them, by ``i`` and their number, something else to do."""
    return [
        Trial(f"item {i}", f"group {i % 2}", 7, (i, jobs.get(f"i{i}", "add"))) for i in range(n)
    ]


def experiment(n_or_items, command="test", config=None, **options):
    """Return the experiment of some items."""
    some = items(n_or_items) if isinstance(n_or_items, int) else n_or_items
    return Experiment(command, 7, config or {}, some, options.pop("work", work), **options)


def work(job):
    number, what = job
    match what:
        case "raise":
            raise ValueError(f"no {number}\nin two lines")
        case "odd":
            raise ValueError("\ud800")
        case "exit":
            raise SystemExit(3)
        case "hang":
            time.sleep(3600)
        case "die":
            os.kill(os.getpid(), signal.SIGKILL)
        case "nan":
            return Result(False, [{"error_m": float("nan")}])
        case "disk":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "bundles/one")
        case "memory":
            raise MemoryError
        case "large":
            return Result(True, [{"sum": number / 3, "text": "x" * 400}] * 60)
        case ("text", int() as length):
            return Result(True, [{"text": "x" * length}])
        case "slow":
            time.sleep(0.02)
        case ("slow while", Path() as mark) if mark.exists():
            time.sleep(5)
        case ("die once", Path() as mark) if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        case ("touch", Path() as mark):
            mark.touch()
            time.sleep(3600)
    return Result(True, [{"sum": number / 3}], extra={"number": number})


def leave(job):
    """Do the work, and leave a file."""
    folder, inner = job
    done = work(inner)
    (folder / f"left-{inner[0]}").touch()
    return done

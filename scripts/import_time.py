"""Time ``import craftsim`` in fresh interpreters. Usage: import_time.py [RUNS]"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time


def seconds(statement: str) -> float:
    """Return the wall time of one statement in a fresh interpreter, its start included."""
    begun = time.perf_counter()
    subprocess.run([sys.executable, "-c", statement], check=True)
    return time.perf_counter() - begun


def main(runs: int) -> None:
    """Print the median with and without the import; one run before the first fills the caches."""
    for statement in ("pass", "import craftsim"):
        seconds(statement)
        median = statistics.median(seconds(statement) for _ in range(runs))
        print(f"{statement:<16} {median:.3f} s (median of {runs})")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)

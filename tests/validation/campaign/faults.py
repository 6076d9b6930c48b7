"""Kill a real ``craftsim validate`` at random moments, resume it, and compare it with an undisturbed one."""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

WORDS = [sys.executable, "-m", "craftsim.cli", "validate", "strip", "block", "--policy", "planner", "random"]
OPTIONS = ["--randomize", "strong", "--trials", "3", "--workers", "2", "--video", "none"]


def _start(out: Path, *options: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [*WORDS, *OPTIONS, *options, "--out", str(out)], stdout=subprocess.DEVNULL, start_new_session=True
    )


def _finish(out: Path, *options: str) -> float:
    begun = time.monotonic()
    status = _start(out, *options).wait()
    assert status in (0, 1), f"exit status {status}"
    return time.monotonic() - begun


def _results(out: Path) -> tuple[dict[str, object], bytes]:
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    del report["wall"]
    return report, (out / "trials.jsonl").read_bytes()


def main(kills: int, seed: int) -> None:
    """Kill and resume so many times."""
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        undisturbed = Path(folder) / "undisturbed"
        took_s = _finish(undisturbed)
        expected = _results(undisturbed)
        for kill in range(kills):
            out, moments = Path(folder) / f"killed-{kill}", []
            for _ in range(2):
                process = _start(out, "--resume")
                moments.append(rng.uniform(0.0, took_s))
                time.sleep(moments[-1])
                process.kill()
                process.wait()
            lines = out / "trials.jsonl"
            kept = lines.read_bytes().count(b"\n") if lines.exists() else 0
            _finish(out, "--resume")
            same = _results(out) == expected
            when = " and ".join(f"{moment:.1f} s" for moment in moments)
            print(
                f"killed after {when} of {took_s:.0f} s, {kept} trials kept: {'equal' if same else 'DIFFERENT'}"
            )
            assert same


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    main(given.kills, given.seed)

"""Train policies for random_strip in the same number of joint steps on the grid, on the grid from worlds that strongly
randomized physics reached, and in that physics; play them all in it.

python scripts/training_in_physics.py --seeds 3        # goes on where it was interrupted: a quarter of an hour
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]
TASK: Final = "random_strip"
REACHED: Final = ROOT / "examples" / "starts_from_physics.py"
REACHED_EPISODES: Final = 100
STEPS: Final = 5120
SETTINGS: Final = f"--network relative --imitate 2000 --worlds 32 --evaluate-every {STEPS}".split()
WAYS: Final = {
    "grid": ("--backend", "grid", *SETTINGS),
    "reached": ("--backend", "grid", *SETTINGS, "--starts", "{}"),
    "physics": ("--backend", "physics", *SETTINGS, "--randomize", "strong", "--workers", "1"),
}


def main() -> None:
    """Train what is missing, and play all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument(
        "--trials", type=int, default=60, help="episodes of each policy, from held-out starts"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "training_in_physics")
    asked = parser.parse_args()
    out: Path = asked.out
    reached = out / "reached.npz"
    if not reached.exists():
        run(
            str(REACHED), "--task", TASK, "--episodes", str(REACHED_EPISODES), "--out", str(reached)
        )
    policies = []
    for seed in range(asked.seeds):
        for way, words in WAYS.items():
            folder = out / f"{way}-{seed}"
            if not (folder / "report.json").exists():
                common = (
                    "--steps",
                    str(STEPS),
                    "--until",
                    "1",
                    "--episodes",
                    "20",
                    "--seed",
                    str(seed),
                )
                options = [word.format(reached) for word in words]
                craftsim("train", TASK, *common, *options, "--resume", "--out", str(folder))
            policies.append(str(folder))
    played = (
        "--randomize",
        "strong",
        "--drive",
        "wheels",
        "--trials",
        str(asked.trials),
        "--seed",
        "5000",
    )
    craftsim(
        "validate",
        f"{TASK}@test",
        "--policy",
        *policies,
        *played,
        "--video",
        "none",
        "--out",
        str(out),
    )


def craftsim(*words: str) -> None:
    """Run a command of craftsim, whose exit status 1 is a finding."""
    run("-P", "-m", "craftsim", *words)


def run(*words: str) -> None:
    """Run Python. Raises CalledProcessError for a status other than 0 and 1."""
    print(*words, flush=True)
    done = subprocess.run([sys.executable, *words], cwd=ROOT, check=False)
    if done.returncode > 1:
        raise subprocess.CalledProcessError(done.returncode, words)


if __name__ == "__main__":
    main()

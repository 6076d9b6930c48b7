"""Kill real commands while they write and at random moments, resume them, and compare with undisturbed ones."""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from writings import Writings

SIGNALS = (
    signal.SIGKILL,
    signal.SIGKILL,
    signal.SIGKILL,
    signal.SIGTERM,
    signal.SIGHUP,
    signal.SIGINT,
)
TO_ALL = 0.3
"""Share of kills that meet the workers, too, as those of systemd, Slurm and a closing terminal do."""
KILLS = 2
"""How often each round kills its command before that may end."""


@dataclass(frozen=True)
class Command:
    """A command, and what it leaves of its results."""

    words: str
    results: str = "trials.jsonl"
    begun: str = "session.db"
    """File with which a run can be resumed."""

    def start(self, out: Path, scratch: Path) -> subprocess.Popen[bytes]:
        """Begin the command in a session of its own, or go on with it."""
        resume = ["--resume"] if (out / self.begun).exists() else []
        return subprocess.Popen(
            [
                sys.executable,
                "-m",
                "craftsim",
                *shlex.split(self.words),
                *resume,
                "--out",
                str(out),
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
            env={**os.environ, "TMPDIR": str(scratch)},
        )


COMMANDS = {
    "validate": Command(
        "validate strip block --policy planner random --randomize strong --trials 3 --workers 2 --video none"
    ),
    "play": Command("validate random --cars 1 --max-steps 4 --trials 6 --workers 2 --video none"),
    "audit": Command("audit --situations 'MOVE/scene=on* a second ramp' --trials 2 --workers 2"),
    "margins": Command("audit margins --quick --situations 'lift*' --workers 2"),
    "tune": Command("tune board --evaluations 4 --trials 1 --workers 2"),
    "train": Command(
        "train strip --steps 60000 --worlds 50 --episodes 50", "curve.csv", "run.safetensors"
    ),
    "imitate": Command(
        "train random_strip --steps 24000 --worlds 50 --network relative --imitate 60 --episodes 50",
        *("curve.csv", "run.safetensors"),
    ),
    # Not resumed: it begins again where a better plan may lie already.
    "plan": Command(
        "plan simple_two_story --attempts 150 --time-limit 600", "simple_two_story.plan", "none"
    ),
    "study": Command(f"train study '{Path(__file__).with_name('short_study.yaml')}' --workers 2"),
}


def _results(command: Command, out: Path) -> tuple[object, bytes, list[str]]:
    """Return what must be equal: the report but for the clock, the records, and which files there are."""
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    del report["wall"]
    files = sorted(str(path.relative_to(out)) for path in out.rglob("*"))
    # The records of a study say how long each training took, and whether it was one that went on.
    results = re.sub(rb'"(cpu_s|resumed)": [\w.]+, ', b"", (out / command.results).read_bytes())
    return report, results, files


def _names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def _session(number: int) -> list[str]:
    """Return the processes of a session that are alive, with their commands."""
    found = []
    for place in Path("/proc").iterdir():
        try:
            fields = (place / "stat").read_text().rsplit(")", 1)[1].split()
            if place.name.isdigit() and int(fields[3]) == number and fields[0] != "Z":
                found.append(f"{place.name}: {(place / 'cmdline').read_bytes()[:120]!r}")
        except (OSError, IndexError):
            continue
    return found


def _no_orphans(number: int, limit_s: float = 60.0) -> None:
    end = time.monotonic() + limit_s
    while found := _session(number):
        assert time.monotonic() < end, f"left behind: {found}"
        time.sleep(0.05)


def _finish(command: Command, out: Path, scratch: Path) -> tuple[float, Counter[str]]:
    """Let a command end; return how long it took, and how often it wrote what."""
    begun, seen = time.monotonic(), Counter[str]()
    out.mkdir(exist_ok=True)
    with Writings(out) as writings:
        process = command.start(out, scratch)
        for kind in writings.until(float("inf")):
            seen[kind] += bool(kind)
            if not kind and process.poll() is not None:
                break
    message = process.communicate()[1].decode()
    assert process.returncode in (0, 1), f"exit status {process.returncode}: {message}"
    _no_orphans(process.pid)
    return time.monotonic() - begun, +seen


def _kill(
    command: Command,
    out: Path,
    scratch: Path,
    rng: random.Random,
    took_s: float,
    seen: Counter[str],
) -> str:
    """Kill a command, mostly while it writes something; return when, or that it ended before."""
    number = rng.choice(SIGNALS)
    to_all = rng.random() < TO_ALL
    aimed = rng.choice(sorted(seen)) if rng.random() < 0.75 else None
    left = rng.randint(1, seen[aimed]) if aimed else 0
    when = f"writing {aimed}, {left} of {seen[aimed]}" if aimed else "at random"
    moment = time.monotonic() + (2 * took_s if aimed else rng.uniform(0, took_s))
    out.mkdir(exist_ok=True)
    with Writings(out) as writings:
        process = command.start(out, scratch)
        for kind in writings.until(moment):
            left -= bool(aimed) and kind == aimed
            if (aimed and not left) or process.poll() is not None:
                break
        if process.poll() is None:
            (os.killpg if to_all else os.kill)(process.pid, number)
        else:
            when += " (ended before)"
    message = process.communicate()[1].decode()
    assert "Traceback" not in message, message
    _no_orphans(process.pid)
    return f"{signal.Signals(number).name}{' to all' if to_all else ''} {when}"


def _round(
    name: str,
    folder: Path,
    rng: random.Random,
    undisturbed: tuple[float, Counter[str], tuple[object, bytes, list[str]], set[str]],
) -> None:
    command, (took_s, seen, expected, caches) = COMMANDS[name], undisturbed
    with (
        tempfile.TemporaryDirectory(dir=folder) as place,
        tempfile.TemporaryDirectory(dir=folder) as scratch,
    ):
        out = Path(place) / "out"
        moments = [_kill(command, out, Path(scratch), rng, took_s, seen) for _ in range(KILLS)]
        _finish(command, out, Path(scratch))
        found, left = _results(command, out), _names(Path(scratch)) - caches
    same = found == expected and not left
    print(f"{name}: {'; '.join(moments)}: {'equal' if same else 'DIFFERENT'}", flush=True)
    assert not left, f"left in the temporary folder: {sorted(left)}"
    for one, other in zip(found, expected, strict=True):
        assert one == other, f"{name}: {one!r:.2000}\nis not\n{other!r:.2000}"


def main(names: list[str], rounds: int, seed: int) -> None:
    """Kill and resume each command so many times."""
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name in names:
            out, scratch = folder / name, folder / f"{name}-tmp"
            scratch.mkdir()
            took_s, seen = _finish(COMMANDS[name], out, scratch)
            print(
                f"{name}: undisturbed in {took_s:.1f} s, writing {dict(sorted(seen.items()))}",
                flush=True,
            )
            # Libraries keep caches in the temporary folder, torch for instance.
            undisturbed = took_s, seen, _results(COMMANDS[name], out), _names(scratch)
            for _ in range(rounds):
                _round(name, folder, rng, undisturbed)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "names", nargs="*", default=list(COMMANDS), help=f"of {', '.join(COMMANDS)}"
    )
    parser.add_argument("--rounds", type=int, default=5, help="of each command")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    main(given.names, given.rounds, given.seed)

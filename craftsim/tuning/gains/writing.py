"""What a tuning leaves: a file of gains that says where it comes from."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import yaml

from craftsim.reports.json_file import versions
from craftsim.skills.gains import SECTIONS
from craftsim.storage.writing import write_whole
from craftsim.tuning.gains.tune import GAINS_FILE, Tuned


def write_gains(out: Path, tuned: Tuned, command: str) -> Path:
    """Write ``gains.yaml`` into a folder and return its path.

    It holds all gains, and in comments what they come from: command, seed, budget, versions, and the verdict.

    Raises InputError where the disk does not take it.
    """
    comments = "".join(f"# {line}\n" for line in _provenance(tuned, command))
    sections = {name: asdict(getattr(tuned.gains, name)) for name in SECTIONS}
    return write_whole(out / GAINS_FILE, comments + yaml.safe_dump(sections, sort_keys=False))


def _provenance(tuned: Tuned, command: str) -> Iterator[str]:
    verdict, config = tuned.verdict, tuned.config
    yield "Gains of the skills. Units are in craftsim/skills/gains.py."
    yield f"Command: {json.dumps(command)}"
    if not verdict.improved:
        yield "Nothing better than the start was found: these are the gains that it began with."
    yield f"Start: {json.dumps(config['setup'].gains.source)}, digest {config['digests']['gains']}"
    yield f"Goal: {tuned.goal}; seed {tuned.seed}; {config['evaluations']} candidates"
    installed = ", ".join(f"{name} {version}" for name, version in versions().items())
    yield f"Versions: {installed}"
    yield f"On seeds held out ({verdict.before.trials} actions each), before and after:"
    for name in verdict.before.values:
        yield f"  {name}: {verdict.before.values[name]:.4g}, {verdict.after.values[name]:.4g}"
    yield f"  failed: {verdict.before.failed}, {verdict.after.failed}"
    yield f"  product of the goal: {verdict.against_start.factor:.4f} times that of the start"

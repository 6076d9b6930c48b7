"""Make the pages and films of the gallery: ``scripts/gallery.py WORKERS AUDIT ...``.

AUDIT is the folder of an audit of the published rules, whose replay bundles show what is unsound. Each task of the
paper is built in physics, and each unsound rule is shown in the smallest world in which it fails.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from craftsim.checking.episode import Recipe, Step, do, start
from craftsim.checking.setup import SEED_0, Seed, Setup
from craftsim.cli import main as craftsim_command
from craftsim.discrete.drawing import LEGEND, world_text
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.tasks import TASK_NAMES
from craftsim.experiments.bundle import read_bundle
from craftsim.rendering.frames import Look
from craftsim.rendering.recorder import Recorder
from craftsim.rendering.render import render
from craftsim.rendering.trajectory import Trajectory
from craftsim.storage.writing import write_whole
from craftsim.validation.runs.once import record_once
from craftsim.validation.shrinking.shrink import DependsError, Smallest, failing_actions, shrink
from craftsim.validation.shrinking.words import sentence
from craftsim.workers.pool import Pool, answered

ROOT: Final = Path(__file__).parents[1]
GALLERY: Final = ROOT / "docs" / "gallery"
FILMS: Final = GALLERY / "films"
"""What the site has at its root: pages embed films by raw HTML, which Sphinx copies nothing for (docs/conf.py)."""
MADE: Final = "<!-- Made by `make gallery`; do not edit. -->\n\n"
BUDGET_BYTES: Final = 1_000_000
"""Of a film."""
TASK_LOOK: Final = Look((960, 540), quality="paper")
HERO: Final = "simple_two_story"
"""The task that README opens with, as an animation that shows without a player."""
HERO_LOOK: Final = Look((720, 360), fps=12, quality="paper", speed=4.0, cards=False)
BUILDINGS: Final = {
    "pyramid": ("pyramid", "--cars", "8", "--area", "12", "12", "4", "--spare-slopes", "2"),
    "house": ("house", "--cars", "8", "--spare-slopes", "1"),
}
"""Buildings that are planned and built, and what `craftsim design` is asked for."""
BUILDING_LOOK: Final = Look((640, 360), fps=12, speed=16.0)
RULE_LOOK: Final = Look(
    (720, 320), 15, ("overview", "follow:0"), quality="paper", length_s=4.0, cards=False, captions=False
)
TRIES: Final = 5
"""Bundles of a rule that are tried until one fails by itself, from a fresh start."""


def main(audits: Sequence[Path], workers: int) -> None:
    """Make everything."""
    FILMS.mkdir(parents=True, exist_ok=True)
    flags = _bundles_by_flag(audits)
    jobs: list[tuple[str, tuple[Path, ...]]] = [(task, ()) for task in TASK_NAMES]
    jobs += [(building, ()) for building in BUILDINGS]
    jobs += [(flag, tuple(bundles)) for flag, bundles in flags.items()]
    with Pool(workers) as pool:
        for number, (_, answer) in enumerate(pool.map_unordered(_make, jobs)):
            answered(answer)
            print(f"{number + 1} of {len(jobs)}", flush=True)
    for path in (*GALLERY.iterdir(), *FILMS.iterdir()):
        if path.stat().st_size > BUDGET_BYTES:
            raise SystemExit(f"{path} has {path.stat().st_size} bytes; allowed: {BUDGET_BYTES}")
    _write_index([flag for flag in flags if (GALLERY / f"{flag}.md").exists()])


def _make(job: tuple[str, tuple[Path, ...]]) -> None:
    name, bundles = job
    if bundles:
        _make_rule(name, bundles)
    elif name in BUILDINGS:
        _make_building(name)
    else:
        _make_task(name)


def _make_task(task: str) -> None:
    trajectory = record_once(task, Setup(), 0)
    title = task.replace("_", " ")
    look = replace(TASK_LOOK, title=title)
    render(trajectory, FILMS / f"{task}.mp4", look)
    last = float(trajectory.time[-1])
    render(trajectory, FILMS / f"{task}.png", replace(look, captions=False), at=(last,))
    if task == HERO:
        render(trajectory, GALLERY / f"{task}.webp", replace(HERO_LOOK, title=title))
    page = [
        f"{MADE}# {title.capitalize()}\n",
        _video(f"{task}.mp4", f"{task}.png"),
        _figures(trajectory),
        "## Start\n",
        f"```{{literalinclude}} ../../craftsim/data/blueprints/{task}.yaml\n:language: yaml\n```\n",
        "## Plan\n",
        f"```{{literalinclude}} ../../craftsim/data/plans/{task}.plan\n:language: text\n```\n",
    ]
    write_whole(GALLERY / f"{task}.md", "\n".join(page))


def _make_building(name: str) -> None:
    folder = ROOT / "out" / "gallery" / name
    start, goal = folder / "start.yaml", folder / "goal.yaml"
    design = ["design", *BUILDINGS[name], "--out", str(folder)]
    build = [
        "build",
        str(start),
        "--goal",
        str(goal),
        "--drive",
        "reduced",
        "--rounds",
        "6",
        "--timeout",
        "3600",
    ]
    for command in (design, [*build, "--video", "--out", str(folder / "build")]):
        if craftsim_command(command):
            raise SystemExit(f"craftsim {' '.join(command)} failed")
    _show_building(name, folder / "build", " ".join(design[:-2]))


def _show_building(name: str, built: Path, design: str) -> None:
    """Film a building from the trajectory of its run, and write its page."""
    (file,) = (built / "trajectories").glob("*.npz")
    trajectory = Trajectory.read(file)
    look = replace(BUILDING_LOOK, title=name)
    render(trajectory, FILMS / f"{name}.mp4", look)
    render(trajectory, FILMS / f"{name}.png", replace(look, captions=False), at=(float(trajectory.time[-1]),))
    out = f"out/{name}"
    commands = [
        f"craftsim {design} --out {out}",
        f"craftsim build {out}/start.yaml --goal {out}/goal.yaml --drive reduced --rounds 6 --video",
    ]
    page = [
        f"{MADE}# {name.capitalize()}\n",
        "Planned from a start and a design, and built by eight cars at once with the reduced drive.\n",
        _video(f"{name}.mp4", f"{name}.png"),
        _figures(trajectory),
        "\n".join(["```", *commands, "```\n"]),
    ]
    write_whole(GALLERY / f"{name}.md", "\n".join(page))


def _figures(trajectory: Trajectory) -> str:
    attempts = trajectory.story.attempts
    rows = {
        "actions as predicted": f"{sum(a.agrees for a in attempts)} of {len(attempts)}",
        "simulated time": f"{trajectory.duration_s:.1f} s",
        "cars off their cells' centres": f"{1e3 * max(a.car_error_m for a in attempts):.2f} mm at most",
        "headings off": f"{1e3 * max(a.heading_error_rad for a in attempts):.2f} mrad at most",
        "bystanders moved": f"{1e3 * max(a.bystander_displacement_m for a in attempts):.2f} mm at most",
        "largest force between two machines": f"{max(a.peak_force_n for a in attempts):.0f} N",
    }
    return "\n".join(
        ["| | |", "| --- | --- |", *(f"| {name} | {value} |" for name, value in rows.items()), ""]
    )


def _bundles_by_flag(audits: Sequence[Path]) -> dict[str, list[Path]]:
    """Return, by the correction that concerns them, the bundles of the rows of audits that are unsound."""
    rows = [
        (row, audit)
        for audit in audits
        for row in json.loads((audit / "report.json").read_text(encoding="utf-8"))["figures"]["audit"]["rows"]
    ]
    found: dict[str, list[Path]] = {}
    # Those first that a single flag corrects: they show that flag and no other.
    for row, audit in sorted(rows, key=lambda pair: len(pair[0]["corrections"])):
        if row["verdict"] == "unsound" and row["bundles"]:
            for flag in row["corrections"]:
                found.setdefault(flag, []).append(audit / row["bundles"][0])
    return found


def _make_rule(flag: str, bundles: Sequence[Path]) -> None:
    found = _smallest(bundles[:TRIES])
    if found is None:
        return
    smallest, seed, chance = found
    recipe = Recipe(
        blueprint_text(smallest.grid), (Step.single(0, 0, smallest.action),), smallest.setup, seed
    )
    judge, recorder = start(recipe), Recorder()
    recorder.begin(judge)
    attempts = do(judge, recipe.steps[0])
    for _ in range(50):  # what follows: a second
        judge.executor.advance()
    trajectory = recorder.trajectory(flag, recipe, attempts)
    render(trajectory, GALLERY / f"{flag}.webp", RULE_LOOK)
    world = world_text(smallest.grid).plain.rstrip()
    page = [
        f"{MADE}# {flag.replace('_', ' ').capitalize()}\n",
        f"![{sentence(smallest)}]({flag}.webp)\n",
        f"{_upper(sentence(smallest))}. In physics: {attempts[0].result}"
        + (f" ({attempts[0].reason})" if attempts[0].reason else "")
        + ". CraftEnv's rules allow it; `physical` has the correction "
        f"[`{flag}`](../rules.md) against it."
        + (
            " It takes chance: nominal physics does not do it, but physics and noise as drawn in one trial do."
            if chance
            else ""
        )
        + "\n",
        f"## The smallest world\n\n```text\n{world}\n\n{LEGEND}\n```\n",
    ]
    write_whole(GALLERY / f"{flag}.md", "\n".join(page))


def _smallest(bundles: Sequence[Path]) -> tuple[Smallest, Seed, bool] | None:
    """Return the smallest world of the first failure of a rule that fails by itself.

    Beside it are the seed with which it fails, and whether it needs that one: in nominal physics it does not fail then.
    """
    for folder in bundles:
        bundle = read_bundle(folder).bundle
        for failing in failing_actions(bundle.recipe, bundle.attempts, bundle.most_s):
            try:
                smallest = shrink(failing)
            except DependsError:
                continue
            chance = smallest.setup == failing.setup
            return smallest, failing.seed if chance else SEED_0, chance
    return None


def _upper(text: str) -> str:
    return text[:1].upper() + text[1:]


def _video(film: str, poster: str) -> str:
    return (
        f'<video controls loop muted playsinline width="100%" poster="../{poster}" src="../{film}"></video>\n'
    )


def _write_index(flags: list[str]) -> None:
    tasks = "\n".join(TASK_NAMES)
    text = (
        f"{MADE}# Gallery\n\n"
        "Every task of the paper, built in contact physics by the shipped plans, buildings that were planned from a "
        "design, and every rule of CraftEnv that `craftsim audit` finds to be unsound, in the smallest world in which "
        "it fails. All of it is made by `make gallery`.\n\n"
        f"```{{toctree}}\n:caption: Tasks\n:maxdepth: 1\n\n{tasks}\n```\n\n"
        f"```{{toctree}}\n:caption: From designs\n:maxdepth: 1\n\n" + "\n".join(BUILDINGS) + "\n```\n\n"
        "```{toctree}\n:caption: Unsound rules\n:maxdepth: 1\n\n" + "\n".join(flags) + "\n```\n"
    )
    write_whole(GALLERY / "index.md", text)


if __name__ == "__main__":
    main([Path(word) for word in sys.argv[2:]], int(sys.argv[1]))

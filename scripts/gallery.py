"""Make films of the gallery, and its page: ``scripts/gallery.py [NAME ...] [--audits DIR ...] [--recordings]``.

Each task of the paper is built in physics, a plan is carried out in ticks and asynchronously, and each unsound rule is
shown in the smallest world in which it fails, from the replay bundles of audits of the published rules. What the page
says is in docs/gallery/gallery.json: films that are not made stay, and without arguments only the page is written.
What a film shows is also written for the site's player; with --recordings that alone, of what the page says already.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from measure_results import revision

from craftsim.checking.recipe import Recipe, Step, perform_step, start
from craftsim.checking.setup import SEED_0, Seed, Setup
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.experiments.bundle import read_bundle
from craftsim.experiments.minimize import NotReproducibleError, Smallest, failing_actions, minimize
from craftsim.rendering.film import FilmOptions
from craftsim.rendering.player import PLAYER_SUFFIX, write_player_file
from craftsim.rendering.render import render
from craftsim.rendering.trajectory import Recorder, Trajectory
from craftsim.storage.writing import write_whole
from craftsim.tasks import TASK_NAMES
from craftsim.validation.options import PlanOrder
from craftsim.validation.sources import record_once
from craftsim.workers.pool import Pool, answered

ROOT: Final = Path(__file__).parents[1]
GALLERY: Final = ROOT / "docs" / "gallery"
PAGE: Final = ROOT / "docs" / "gallery.md"
STORED: Final = GALLERY / "gallery.json"
FILMS: Final = GALLERY / "films"
RECORDINGS: Final = GALLERY / "recordings"
"""What docs/in-3d.md plays."""
MADE: Final = "<!-- Made by `scripts/gallery`; do not edit. -->\n\n"
HEAD: Final = """# Gallery

Each picture links to its film: the paper's six tasks, built in contact physics by the shipped plans, and two buildings
that were planned from a design and built by eight cars. Below each: actions as predicted,
simulated time, and by how much cars miss the centres of cells at most. [In 3D](in-3d.md) they can be turned.

"""
OVERLAP_HEAD: Final = """## In ticks and asynchronously

One plan in ticks (left) and asynchronously (right), from the same start ([tutorial](tutorials/asynchronous.md)).

"""
RULES_HEAD: Final = """## Unsound rules

Every rule of CraftEnv that `craftsim audit` finds to be unsound, in the smallest world in which it fails, with the
[correction](rules.md) that forbids it or corrects its effect.

"""
COLUMNS: Final = 2
"""Of thumbnails."""
Entry = dict[str, Any]
"""What the page says of a film."""
BUDGET_BYTES: Final = 1_000_000
"""Of a film."""
TASK_LOOK: Final = FilmOptions((960, 540), quality="paper")
HERO: Final = "simple_two_story"
"""The task that README opens with, as an animation that shows without a player."""
HERO_LOOK: Final = FilmOptions((720, 360), fps=12, quality="paper", speed=4.0, cards=False)
BUILDINGS: Final = {
    "pyramid": ("pyramid", "--cars", "8", "--area", "12", "12", "4", "--spare-slopes", "2"),
    "house": ("house", "--cars", "8", "--spare-slopes", "1"),
}
"""Buildings that are planned and built, and what `craftsim design` is asked for."""
BUILDING_LOOK: Final = FilmOptions((640, 360), fps=12, speed=16.0)
OVERLAP: Final = "ramp"
"""The plan that is carried out in ticks and asynchronously, in examples/overlap."""
ORDERS: Final[dict[PlanOrder, str]] = {
    "ticks": "in ticks: all wait for the slowest",
    "concurrent": "asynchronously: each goes on by itself",
}
OVERLAP_LOOK: Final = FilmOptions((960, 480), quality="paper", speed=1.5)
RULE_LOOK: Final = FilmOptions(
    (720, 320),
    15,
    ("overview", "follow:0"),
    quality="paper",
    length_s=4.0,
    cards=False,
    captions=False,
)
ON_ROLLERS: Final = "strip_rollers"
"""The strip with the reference drive, a recording without a film."""
Job = tuple[str, tuple[Path, ...], bool]
"""A name, the bundles of a rule, and whether a film is made beside the recording."""
TRIES: Final = 5
"""Bundles of a rule that are tried until one fails by itself, from a fresh start."""


def main() -> None:
    """Make the films that are asked for, and the page."""
    films = (*TASK_NAMES, *BUILDINGS, OVERLAP, ON_ROLLERS)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"all, or some of {', '.join(films)}"
    )
    parser.add_argument("--audits", nargs="*", type=Path, default=[], metavar="DIR")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--recordings", action="store_true")
    asked = parser.parse_args()
    if strange := {*asked.names} - {*films, "all"}:
        parser.error(
            f"no film is called {', '.join(sorted(strange))}; allowed: all, {', '.join(films)}"
        )
    for folder in (FILMS, RECORDINGS):
        folder.mkdir(parents=True, exist_ok=True)
    filmed = not asked.recordings
    jobs: list[Job]
    jobs = [(name, (), filmed) for name in (films if "all" in asked.names else asked.names)]
    for flag, bundles in _bundles_by_flag(asked.audits).items():
        jobs.append((flag, tuple(bundles), filmed))
    found: dict[str, dict[str, Entry]] = json.loads(STORED.read_text(encoding="utf-8"))
    at = revision()
    with Pool(asked.workers) as pool:
        for number, (_, answer) in enumerate(pool.map_unordered(_make, jobs)):
            part, name, entry = answered(answer)
            if entry is not None and filmed:
                found.setdefault(part, {})[name] = entry | {"revision": at}
            elif entry is not None:
                _check_said(name, entry, found[part][name])
            print(f"{number + 1} of {len(jobs)}", flush=True)
    for path in (*GALLERY.iterdir(), *FILMS.iterdir(), *RECORDINGS.iterdir()):
        if path.stat().st_size > BUDGET_BYTES:
            raise SystemExit(f"{path} has {path.stat().st_size} bytes; allowed: {BUDGET_BYTES}")
    write_whole(STORED, json.dumps(found, indent=1) + "\n")
    write_whole(PAGE, page_text(found))


def _check_said(name: str, entry: Entry, stored: Entry) -> None:
    """Stop where a recording shows something else than its film."""
    for key in ("agree", "sentence"):
        if entry.get(key) != stored.get(key):
            raise SystemExit(f"{name}: its film shows {stored}, its recording {entry}; film it")


def _make(job: Job) -> tuple[str, str, Entry | None]:
    name, bundles, filmed = job
    if bundles:
        return "rules", name, _make_rule(name, bundles, filmed)
    if name in BUILDINGS:
        return "buildings", name, _make_building(name, filmed)
    if name == OVERLAP:
        return "overlap", name, _make_overlap(filmed)
    if name == ON_ROLLERS:
        return "tasks", name, _record_on_rollers()
    return "tasks", name, _make_task(name, filmed)


def _make_task(task: str, filmed: bool) -> Entry:
    trajectory = record_once(task, Setup(), 0)
    trajectory = trajectory.titled(task.replace("_", " "))
    _record(trajectory, task)
    if filmed:
        _film(trajectory, task, TASK_LOOK)
    if filmed and task == HERO:
        render(trajectory, GALLERY / f"{task}.webp", HERO_LOOK)
    return _metrics(trajectory)


def _record_on_rollers() -> None:
    setup = Setup()
    machines = replace(setup.machines, drive="rollers")
    trajectory = record_once("strip", replace(setup, machines=machines), 0)
    _record(trajectory.titled("strip on rollers"), ON_ROLLERS)


def _record(trajectory: Trajectory, name: str) -> None:
    write_player_file(RECORDINGS / f"{name}{PLAYER_SUFFIX}", trajectory)


def _make_building(name: str, filmed: bool) -> Entry:
    folder = ROOT / "out" / "gallery" / name
    start, goal = folder / "start.yaml", folder / "start_goal.yaml"
    design = ["design", *BUILDINGS[name], "--out", str(folder)]
    options = "--plan auto --drive wheels --attempts 6 --timeout 3600 --trials 1 --randomize none"
    build = [
        "validate",
        str(start),
        "--goal",
        str(goal),
        *options.split(),
        "--record",
        "trajectory",
        "--out",
        str(folder / "build"),
    ]
    for command in (design, build):
        # A worker of a pool has no workers of its own.
        subprocess.run([sys.executable, "-P", "-m", "craftsim", *command], cwd=ROOT, check=True)
    (file,) = (folder / "build" / "trajectories").glob("*.npz")
    trajectory = Trajectory.read(file)
    _record(trajectory.titled(name), name)
    if filmed:
        _film(trajectory.titled(name), name, BUILDING_LOOK)
    return _metrics(trajectory)


def _make_overlap(filmed: bool) -> Entry:
    world = ROOT / "examples" / "overlap" / f"{OVERLAP}.yaml"
    shown = {
        order: record_once(
            str(world), Setup(), 0, plan=world.with_suffix(".plan"), order=order
        ).titled(title)
        for order, title in ORDERS.items()
    }
    for order, trajectory in shown.items():
        _record(trajectory, f"{OVERLAP}_{order}")
    if filmed:
        _film_overlap(shown)
    return {order: _metrics(trajectory) for order, trajectory in shown.items()}


def _film_overlap(shown: dict[PlanOrder, Trajectory]) -> None:
    render([*shown.values()], FILMS / f"{OVERLAP}.mp4", OVERLAP_LOOK)
    middle = 0.5 * float(shown["concurrent"].time[-1])
    render(
        [*shown.values()],
        FILMS / f"{OVERLAP}.png",
        replace(OVERLAP_LOOK, captions=True),
        at=(middle,),
    )


def _film(trajectory: Trajectory, name: str, look: FilmOptions) -> None:
    render(trajectory, FILMS / f"{name}.mp4", look)
    render(trajectory, FILMS / f"{name}.png", look, at=(float(trajectory.time[-1]),))


def _metrics(trajectory: Trajectory) -> Entry:
    attempts = trajectory.story.attempts
    return {
        "agree": f"{sum(a.agrees for a in attempts)} of {len(attempts)}",
        "simulated_s": round(trajectory.duration_s, 1),
        "car_mm": round(1e3 * max(a.car_error_m for a in attempts), 2),
    }


def _bundles_by_flag(audits: Sequence[Path]) -> dict[str, list[Path]]:
    """Return, by the correction that concerns them, the bundles of the rows of audits that are unsound."""
    rows = [
        (row, audit)
        for audit in audits
        for row in json.loads((audit / "report.json").read_text(encoding="utf-8"))["figures"][
            "audit"
        ]["rows"]
    ]
    found: dict[str, list[Path]] = {}
    # Those first that a single flag corrects: they show that flag and no other.
    for row, audit in sorted(rows, key=lambda pair: len(pair[0]["corrections"])):
        if row["verdict"] == "unsound" and row["bundles"]:
            for flag in row["corrections"]:
                found.setdefault(flag, []).append(audit / row["bundles"][0])
    return found


def _make_rule(flag: str, bundles: Sequence[Path], filmed: bool) -> Entry | None:
    found = _smallest(bundles[:TRIES])
    if found is None:
        return None
    smallest, seed, chance = found
    recipe = Recipe(
        blueprint_text(smallest.grid), (Step.single(0, 0, smallest.action),), smallest.setup, seed
    )
    judge, recorder = start(recipe), Recorder()
    recorder.begin(judge)
    attempts = perform_step(judge, recipe.steps[0])
    for _ in range(50):  # what follows: a second
        judge.executor.advance()
    trajectory = recorder.trajectory(flag, recipe, attempts)
    _record(trajectory, flag)
    if filmed:
        render(trajectory, GALLERY / f"{flag}.webp", RULE_LOOK)
    reason = f" ({attempts[0].reason})" if attempts[0].reason else ""
    return {
        "sentence": smallest.words,
        "physics": f"{attempts[0].result}{reason}",
        "needs_its_draw": chance,
    }


def _smallest(bundles: Sequence[Path]) -> tuple[Smallest, Seed, bool] | None:
    """Return the smallest world of the first failure of a rule that fails by itself.

    Beside it are the seed with which it fails, and whether it needs that one: in nominal physics it does not fail then.
    """
    for folder in bundles:
        bundle = read_bundle(folder).bundle
        for failing in failing_actions(bundle.recipe, bundle.attempts, bundle.most_s):
            try:
                smallest = minimize(failing)
            except NotReproducibleError:
                continue
            chance = smallest.setup == failing.setup
            return smallest, failing.seed if chance else SEED_0, chance
    return None


def page_text(stored: dict[str, dict[str, Entry]]) -> str:
    """Return the page of thumbnails: a film behind each picture, and each unsound rule as an animation."""
    buildings = [
        _building(name, entry)
        for part in ("tasks", "buildings")
        for name, entry in stored[part].items()
    ]
    rules = [_rule(name, entry) for name, entry in stored["rules"].items()]
    overlaps = [_overlap(name, entry) for name, entry in stored["overlap"].items()]
    return f"{MADE}{HEAD}{_cards(buildings)}\n{OVERLAP_HEAD}{chr(10).join(overlaps)}\n\n{RULES_HEAD}{_cards(rules)}"


def _building(name: str, entry: Entry) -> str:
    title = name.replace("_", " ")
    return f"{_linked(name, title)} **{title}**: {_said(entry)}"


def _overlap(name: str, entry: Entry) -> str:
    said = f"In ticks {_said(entry['ticks'])}; asynchronously {_said(entry['concurrent'])}."
    return f"{_linked(name, 'a plan in ticks and asynchronously')} {said}"


def _linked(name: str, alternative: str) -> str:
    return f"[![{alternative}](gallery/films/{name}.png)](gallery/films/{name}.mp4)"


def _said(entry: Entry) -> str:
    return f"{entry['agree']}, {entry['simulated_s']:g} s, {entry['car_mm']:.2f} mm"


def _rule(name: str, entry: Entry) -> str:
    chance = "; with physics and noise as drawn in one trial" if entry["needs_its_draw"] else ""
    return f"![{name}](gallery/{name}.webp) **`{name}`**: {entry['sentence']}{chance}"


def _cards(cards: Sequence[str]) -> str:
    rows = [cards[i : i + COLUMNS] for i in range(0, len(cards), COLUMNS)]
    lines = [" | ".join([*row, *[""] * (COLUMNS - len(row))]) for row in rows]
    empty = " | ".join([""] * COLUMNS)
    return (
        "\n".join([f"| {empty} |", "| --- " * COLUMNS + "|", *(f"| {line} |" for line in lines)])
        + "\n"
    )


if __name__ == "__main__":
    main()

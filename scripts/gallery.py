"""Make the films of the gallery and its page: ``scripts/gallery.py WORKERS AUDIT ...``.

AUDIT is the folder of an audit of the published rules, whose replay bundles show what is unsound. Each task of the
paper is built in physics, and each unsound rule is shown in the smallest world in which it fails. What the page says is
in docs/gallery/gallery.json; without arguments the page is written from there.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from craftsim.checking.episode import Recipe, Step, do, start
from craftsim.checking.setup import SEED_0, Seed, Setup
from craftsim.cli import main as craftsim_command
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.tasks import TASK_NAMES
from craftsim.experiments.bundle import read_bundle
from craftsim.rendering.film import FilmOptions
from craftsim.rendering.render import render
from craftsim.rendering.trajectory import Recorder, Trajectory
from craftsim.storage.writing import write_whole
from craftsim.validation.minimize import NotReproducibleError, Smallest, failing_actions, minimize
from craftsim.validation.validation import record_once
from craftsim.workers.pool import Pool, answered

ROOT: Final = Path(__file__).parents[1]
GALLERY: Final = ROOT / "docs" / "gallery"
PAGE: Final = ROOT / "docs" / "gallery.md"
STORED: Final = GALLERY / "gallery.json"
FILMS: Final = GALLERY / "films"
MADE: Final = "<!-- Made by `make gallery`; do not edit. -->\n\n"
HEAD: Final = """# Gallery

Each picture links to its film: the paper's six tasks, built in contact physics by the shipped plans, and two buildings
that were planned from a design and built by eight cars with the reduced drive.

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
RULE_LOOK: Final = FilmOptions(
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
    found: dict[str, dict[str, Entry]] = {"tasks": {}, "buildings": {}, "rules": {}}
    with Pool(workers) as pool:
        for number, (_, answer) in enumerate(pool.map_unordered(_make, jobs)):
            part, name, entry = answered(answer)
            if entry is not None:
                found[part][name] = entry
            print(f"{number + 1} of {len(jobs)}", flush=True)
    for path in (*GALLERY.iterdir(), *FILMS.iterdir()):
        if path.stat().st_size > BUDGET_BYTES:
            raise SystemExit(f"{path} has {path.stat().st_size} bytes; allowed: {BUDGET_BYTES}")
    order = {"tasks": [*TASK_NAMES], "buildings": [*BUILDINGS], "rules": [*flags]}
    kept = {
        part: {name: found[part][name] for name in names if name in found[part]}
        for part, names in order.items()
    }
    write_whole(STORED, json.dumps(kept, indent=1) + "\n")
    write_page()


def _make(job: tuple[str, tuple[Path, ...]]) -> tuple[str, str, Entry | None]:
    name, bundles = job
    if bundles:
        return "rules", name, _make_rule(name, bundles)
    if name in BUILDINGS:
        return "buildings", name, _make_building(name)
    return "tasks", name, _make_task(name)


def _make_task(task: str) -> Entry:
    trajectory = record_once(task, Setup(), 0)
    title = task.replace("_", " ")
    look = replace(TASK_LOOK, title=title)
    render(trajectory, FILMS / f"{task}.mp4", look)
    last = float(trajectory.time[-1])
    render(trajectory, FILMS / f"{task}.png", replace(look, captions=False), at=(last,))
    if task == HERO:
        render(trajectory, GALLERY / f"{task}.webp", replace(HERO_LOOK, title=title))
    return _metrics(trajectory)


def _make_building(name: str) -> Entry:
    folder = ROOT / "out" / "gallery" / name
    start, goal = folder / "start.yaml", folder / "goal.yaml"
    design = ["design", *BUILDINGS[name], "--out", str(folder)]
    options = "--plan auto --drive reduced --attempts 6 --timeout 3600 --trials 1 --randomize none"
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
        if craftsim_command(command):
            raise SystemExit(f"craftsim {' '.join(command)} failed")
    (file,) = (folder / "build" / "trajectories").glob("*.npz")
    trajectory = Trajectory.read(file)
    look = replace(BUILDING_LOOK, title=name)
    render(trajectory, FILMS / f"{name}.mp4", look)
    render(trajectory, FILMS / f"{name}.png", replace(look, captions=False), at=(float(trajectory.time[-1]),))
    return _metrics(trajectory)


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
        for row in json.loads((audit / "report.json").read_text(encoding="utf-8"))["figures"]["audit"]["rows"]
    ]
    found: dict[str, list[Path]] = {}
    # Those first that a single flag corrects: they show that flag and no other.
    for row, audit in sorted(rows, key=lambda pair: len(pair[0]["corrections"])):
        if row["verdict"] == "unsound" and row["bundles"]:
            for flag in row["corrections"]:
                found.setdefault(flag, []).append(audit / row["bundles"][0])
    return found


def _make_rule(flag: str, bundles: Sequence[Path]) -> Entry | None:
    found = _smallest(bundles[:TRIES])
    if found is None:
        return None
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


def write_page() -> None:
    """Write docs/gallery.md from what is stored."""
    write_whole(PAGE, page_text(json.loads(STORED.read_text(encoding="utf-8"))))


def page_text(stored: dict[str, dict[str, Entry]]) -> str:
    """Return the page of thumbnails: a film behind each picture, and each unsound rule as an animation."""
    buildings = [
        _building(name, entry) for part in ("tasks", "buildings") for name, entry in stored[part].items()
    ]
    rules = [_rule(name, entry) for name, entry in stored["rules"].items()]
    return f"{MADE}{HEAD}{_cards(buildings)}\n{RULES_HEAD}{_cards(rules)}"


def _building(name: str, entry: Entry) -> str:
    film, picture, title = f"gallery/films/{name}.mp4", f"gallery/films/{name}.png", name.replace("_", " ")
    said = f"{entry['agree']} actions as predicted, {entry['simulated_s']:g} s, cars within {entry['car_mm']:.2f} mm"
    return f"[![the finished building: {title}]({picture})]({film}) **{title}**: {said}"


def _rule(name: str, entry: Entry) -> str:
    chance = "; with physics and noise as drawn in one trial" if entry["needs_its_draw"] else ""
    return f"![the film of {name}](gallery/{name}.webp) **`{name}`**: {entry['sentence']}{chance}"


def _cards(cards: Sequence[str]) -> str:
    rows = [cards[i : i + COLUMNS] for i in range(0, len(cards), COLUMNS)]
    lines = [" | ".join([*row, *[""] * (COLUMNS - len(row))]) for row in rows]
    empty = " | ".join([""] * COLUMNS)
    return "\n".join([f"| {empty} |", "| --- " * COLUMNS + "|", *(f"| {line} |" for line in lines)]) + "\n"


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main([Path(word) for word in sys.argv[2:]], int(sys.argv[1]))
    else:
        write_page()

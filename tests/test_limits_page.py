"""docs/limits.md says what craftsim/storage/limits.py holds."""

from pathlib import Path

from craftsim.storage import limits
from craftsim.storage.limits import Limits, Range, size_text

PAGE = (Path(__file__).parents[1] / "docs" / "limits.md").read_text(encoding="utf-8")


def _row(file: Limits) -> str:
    unpacked = file.content_bytes != file.file_bytes
    cells = [size_text(file.file_bytes), size_text(file.content_bytes) if unpacked else ""]
    cells.append(size_text(file.line_bytes) if file.line_bytes else "")
    return f"| {file.what} | " + " | ".join(cells).replace("|  |", "| |").rstrip() + " |"


def test_every_file_has_its_row():
    missing = [row for row in map(_row, limits.ALL) if row not in PAGE]
    assert missing == []


PHRASES = {
    "JSON_VALUES": "holds up to {} values, no unknown",
    "YAML_VALUES": "or noise: {} values",
    "DESIGN_CELLS": "A design has up to {} cells.",
    "MESH_PIECES": "is divided into up to\n{} pieces",
    "YAML_DEPTH": "nested {} levels deep, without anchors",
    "PHYSICS_CELLS": "| a world in physics | {} cells",
    "PHYSICS_CARS": "cells, {} cars, ",
    "PHYSICS_PARTS": "{} parts (cars",
    "PHYSICS_GOALS": "{} marked cells",
    "PHYSICS_STEPS": "| a replay | {} physics steps",
    "SHRINK_S": "| {} s of simulated time |",
    "STEP_ACTIONS": "of them {} in one step",
    "RECIPE_ACTIONS": "| the actions of a recipe | {}, of them",
    "ACTIONS_WITHOUT_TIME": "in one step; {} more than there are control periods",
    "MAX_ERROR_CHARACTERS": "is cut to {} characters",
    "POLICY_HEAD_BYTES": "a policy says up to {}",
    "PICKLE_BYTES": "contents of a run file has {}",
    "PICKLE_STEPS": "and {} values. A learning",
    "CURVE_POINTS": "learning curve has {} points",
    "LARGEST_WEIGHT": "a weight is {} at most",
    "START_WORLDS": "a file of starts\n{} worlds",
    "RECORDS": "has up to {} records",
    "RECORDED_CELLS": "with {} cells together",
    "RECORDED_CARS": "of worlds of {} cars",
    "RECORDED_DEPTH": "plans of depth {} and",
    "RECORDED_TICKS": "episodes of {} ticks",
    "SEED": "| `--seed` | {} |",
    "TRIAL_COUNT": "| `--trials`, and all runs of a campaign together | {} |",
    "RUNS": "all runs of a campaign together | {} |",
    "STAGES": "| the stages of a training run | {} tasks |",
    "STUDY_RUNS": "| a study | {} runs (tasks times algorithms times seeds)",
    "STUDY_TASKS": "seeds), {} tasks that are trained on or played",
    "STUDY_SEEDS": "or played, {} seeds",
    "TITLE_CHARACTERS": "seeds, {} characters of title |",
    "WORKERS": "| `--workers` | {} |",
    "PORTS": "| `view --port` | {} |",
    "DELAY_MS": "| `robot`: delay and jitter, pace, patience | {} ms,",
    "PACE": "pace, patience | 0 to 10000 ms, {},",
    "PATIENCE_S": "0 to 10000 ms, 0.01 to 100, {} s |",
    "ROBOT_CONNECTIONS": "| connections to robots | {} |",
    "PAGE_CONNECTIONS": "| connections to the viewer | {} |",
    "PAGE_BYTES": "| a message of a page of the viewer | {} |",
    "MESSAGE_BYTES": "| a message to or from robots | {} |",
    "TIMEOUT_S": "| `--timeout` | {} s |",
    "CARS": "| `--cars`, `--blocks` | {},",
    "BLOCKS": "| `--cars`, `--blocks` | 0 to 256, {} |",
    "DESIGN_SIDE": "| `design`: size and area, spare blocks and slopes, difficulty | {},",
    "EPISODE_TICKS": "| `--max-steps` | {} |",
    "REPLANS": "| `build --replans`, rounds, `plan --time` | {},",
    "PLAN_ROUNDS": "`plan --time` | 0 to 1000, {},",
    "PLAN_TIME_S": "0 to 1000, 1 to 1000000, {} s |",
    "BATCH": "| `bench`: worlds | {} |",
    "BENCH_S": "| `bench`: seconds | {} |",
    "SHOWN": "| `conformance --show` | {} |",
    "FRAME_PIXELS": "| a frame of a film | {} pixels",
    "IMAGE_PIXELS": "| an image for learning | {} pixels",
    "FRAME_RATE": "| `render`: fps, speed, at | {},",
    "FILM_SPEED": "| `render`: fps, speed, at | 1 to 120, {},",
    "MOMENT_S": "1 to 120, 0.01 to 1000, {} s |",
    "TRAIN_STEPS": "| `train`: steps, episodes, worlds | {},",
    "TRAIN_EPISODES": "| 1 to 1000000000000, {}, 1 to 100000 |",
    "EXCITE_S": "| `excite`: time, length and width | {} s,",
    "EXCITE_M": "10 to 3600 s, {} m |",
    "LOGGED_CARS": "| `identify --car` | {} |",
    "BAG_MESSAGES": "A bag has up to {} messages on each",
    "BAG_MESSAGE_BYTES": "that are read, of {} each",
    "BAG_CHUNK_BYTES": "in chunks of {},",
    "BAG_RECORDS": "and {} records in all",
    "IDENTIFIED_S": "are identified from {} s",
    "SHARE": "| `train`: until, novelty | {},",
    "BONUS": "| `train`: until, novelty | 0 to 1, {} |",
    "EXPLORED_TICKS": "| `train`: explore, imitate, helper depth | {},",
    "IMITATED_PLANS": "imitate, helper depth | 0 to 10000000, {},",
    "HELPER_DEPTH": "helper depth | 0 to 10000000, 0 to 50000, {} |",
    "NETWORK_WIDTH": "width is {}.",
}
"""How the page says each number."""


def _text(name: str, value: float | Range) -> str:
    if isinstance(value, Range):
        return str(value)
    return size_text(int(value)) if name.endswith("_BYTES") else f"{value:,.0f}"


def test_every_other_number_is_on_the_page():
    numbers = {
        name: value
        for name, value in vars(limits).items()
        if name.isupper() and isinstance(value, int | float | Range) and name not in ("KIB", "MIB")
    }
    assert numbers.keys() == PHRASES.keys()
    said = {name: PHRASES[name].format(_text(name, value)) for name, value in numbers.items()}
    assert [phrase for phrase in said.values() if phrase not in PAGE] == []

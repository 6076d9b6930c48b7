"""docs/limits.md says what craftsim/storage/limits.py holds, and all tables of the pages follow from types."""

import runpy
from pathlib import Path

import pytest

from craftsim.storage import limits
from craftsim.storage.limits import size_text

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "limits.md").read_text(encoding="utf-8")
TABLES = runpy.run_path(str(ROOT / "scripts" / "tables.py"))


@pytest.mark.parametrize(
    ("page", "tables"), [("limits.md", ["files", "options"]), ("training.md", ["settings"])]
)
def test_the_tables_of_a_page_are_those_of_the_types(page, tables):
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    assert [found[2] for found in TABLES["MARKED"].finditer(text)] == tables
    assert TABLES["renewed"](text) == text, "make tables writes them anew"
    row = "| `--trials` |" if "options" in tables else "| `coma` |"
    assert TABLES["renewed"](text.replace(row, "| gone |")) == text


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
    "STAGES": "| the stages of a training run | {} tasks |",
    "TITLE_CHARACTERS": "seeds, {} characters of title |",
    "ROBOT_CONNECTIONS": "| connections to robots | {} |",
    "PAGE_CONNECTIONS": "| connections to the viewer | {} |",
    "PAGE_BYTES": "| a message of a page of the viewer | {} |",
    "MESSAGE_BYTES": "| a message to or from robots | {} |",
    "FRAME_PIXELS": "| a frame of a film | {} pixels",
    "IMAGE_PIXELS": "| an image for learning | {} pixels",
    "BAG_MESSAGES": "A bag has up to {} messages on each",
    "BAG_MESSAGE_BYTES": "that are read, of {} each",
    "BAG_CHUNK_BYTES": "in chunks of {},",
    "BAG_RECORDS": "and {} records in all",
    "IDENTIFIED_S": "are identified from {} s",
}
"""How the page says each number that is in no table."""


def test_every_other_number_is_on_the_page():
    numbers = {
        name: value
        for name, value in vars(limits).items()
        if name.isupper() and isinstance(value, int | float) and name not in ("KIB", "MIB")
    }
    assert numbers.keys() == PHRASES.keys()
    said = {
        name: PHRASES[name].format(size_text(value) if name.endswith("_BYTES") else f"{value:,.0f}")
        for name, value in numbers.items()
    }
    assert [phrase for phrase in said.values() if phrase not in PAGE] == []

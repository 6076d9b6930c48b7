"""Every reason has examples, worlds in which it forbids an action, and is said in the same words as ever."""

import json
import re
from pathlib import Path

import generated

from craftsim.discrete.kernel import batch
from craftsim.discrete.kernel import codes as code
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import REASONS, RULE_SETS, Rules

from .conftest import recorded_world

EXAMPLES = [
    json.loads(line)
    for line in (Path(__file__).parents[1] / "data" / "reasons.jsonl").read_text().splitlines()
]


def test_every_reason_has_words_and_examples():
    assert sorted(REASONS) == list(range(1, code.UNDER_THING_AT_END + 1))
    assert {getattr(code, example["reason"]) for example in EXAMPLES} == set(REASONS)


def test_the_rules_give_the_reasons():
    for example in EXAMPLES:
        grid, rules, action = (
            recorded_world(example),
            Rules(example["rules"]),
            Action[example["action"]],
        )
        corrections = int(RULE_SETS[example["rules"]])
        found = batch.reason(*grid.world(corrections), example["car"], int(action))
        assert found & ((1 << code.DETAIL_BITS) - 1) == getattr(code, example["reason"]), example[
            "says"
        ]
        assert str(rules.explain(grid, example["car"], action)) == example["says"]
        assert not rules.mask(grid)[example["car"], action], example["says"]


def _shown(words):
    """Return a reason's words as the documentation shows them."""
    words = re.sub(r"\{[\w ]+:if any\}", "", words)
    words = re.sub(r"\{[\w ]+:[\w ]+\}", "*object*", words)
    words = words.replace("{car}", "*n*").replace("{load}", "*load*")
    return re.sub(r"\{[\w ]+\}", "*cell*", words)


def test_the_documentation_lists_every_reason_with_its_correction():
    page = (Path(__file__).parents[2] / "docs" / "rules.md").read_text(encoding="utf-8")
    assert "```{generated} reasons" in page
    shown = generated.TABLES["reasons"]()
    for reason in REASONS.values():
        named = (
            "" if reason.correction is None else f"[`{reason.correction.name}`](#{reason.heading})"
        )
        assert f"| {_shown(reason.words)} | {named} |" in shown

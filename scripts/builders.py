"""Let builders that read a world and answer in words build 30 fixed designs: the protocol for language models.

    python scripts/builders.py random mine:answer --each 1     # one design of each difficulty
    python scripts/builders.py random mine:answer

A builder is ``module:function``, from two texts to an answer, or random, planner or designs, a shipped policy. The
designs are held-out starts of ``designs@test``, the first one of each shape; the budget of turns is twice the ticks of
the plan that is stored with each. Physics is under mild randomization.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from running import options, publish

from craftsim.envs.parallel import Observations
from craftsim.envs.planner import PlannerPolicy
from craftsim.envs.text import (
    ANSWER_MARK,
    AnswerFunction,
    TextConstruction,
    answer_text,
    converse,
)
from craftsim.envs.text_designs import (
    DIFFICULTIES,
    EACH,
    chosen_rows,
    design_task,
    design_world,
    score,
)
from craftsim.experiments.experiment import Experiment, Result, RunOptions, Trial, TrialRecord
from craftsim.experiments.intervals import (
    Estimate,
    Proportion,
    least_detectable_of_pairs,
    mean_of,
    paired_difference,
)
from craftsim.experiments.report_parts import measurement_headline
from craftsim.experiments.session import run_experiment
from craftsim.learning.policies import PLANNER, RANDOM, make_policy, policy_digest
from craftsim.learning.settings import BackendChoice
from craftsim.reports.json_file import document
from craftsim.reports.report import Column, DataTable, Report, Section, numbers
from craftsim.storage.limits import Range
from craftsim.tasks.registry import DESIGNS
from craftsim.tasks.starts import read_split

BASELINES: Final = (RANDOM, PLANNER, DESIGNS)
ANSWER_S: Final = 300.0
"""Mean time of an answer in seconds, for the time limit."""
_KEPT: Final = 1000
"""Number of last characters of an answer in a record."""
_ALL: Final = "all"


@dataclass(frozen=True)
class BuilderCase:
    """A design for a builder."""

    builder: str
    """``planner``, what :func:`make_policy` knows, or ``module:function`` of a function from two texts to an answer."""
    backend: BackendChoice
    row: int
    seed: int

    def world(self) -> TextConstruction:
        """Return the environment."""
        return design_world(self.row, self.backend)


def build(case: BuilderCase) -> Result:
    """Let a builder build a design; ``attempts`` are its turns."""
    env = case.world()
    try:
        talk = converse(env, _answers(case, env), seed=case.seed)
        figures = score(env, talk.turns, talk.success)
    finally:
        env.close()
    turns = [
        {
            "answer": turn.answer.rpartition(ANSWER_MARK)[2][-_KEPT:]
            if isinstance(turn.answer, str)
            else "",
            "unreadable": turn.unreadable,
            "feedback": list(map(str, turn.feedback)),
        }
        for turn in talk.turns
    ]
    figures["simulated_s"] = round(talk.duration_s, 3)
    return Result(agrees=talk.success, attempts=turns, extra=figures)


def _answers(case: BuilderCase, env: TextConstruction) -> AnswerFunction:
    """Return what answers for a builder; a policy's actions are put into words. Raises InputError without one."""
    core = env.core
    if case.builder == PLANNER:
        policy: Any = PlannerPolicy(env)
    else:
        policy = make_policy(case.builder, case.seed, core.task, core.options.rule_set)
        if ":" in case.builder:
            return policy

    def answer(instructions: str, text: str) -> str:
        seen = enumerate(zip(core.vectors(), core.masks, strict=True))
        observed = {
            f"car_{car}": {"observation": row, "action_mask": mask} for car, (row, mask) in seen
        }
        return answer_text(policy(Observations(observed, core.task, bool(core.episodes.t[0] == 0))))

    return answer


def builders_report(
    builders: Sequence[str], each: int, seed: int, out: Path, options: RunOptions
) -> Report:
    """Let builders build so many designs of each difficulty, and return the report.

    Random play, the planner and trained policies also build on the grid. Of a run that was cut off in the folder, what
    is done is kept. Raises InputError for a builder that there is not.
    """
    Range(1, EACH).check("--each", each)
    rows = {name: rows[:each] for name, rows in chosen_rows().items()}
    numbered = [(name, row) for name, found in rows.items() for row in found]
    items = []
    for builder in dict.fromkeys(builders):
        backends: tuple[BackendChoice, ...] = (
            ("physics",) if ":" in builder else ("grid", "physics")
        )
        for backend in backends:
            cases = [BuilderCase(builder, backend, row, seed + row) for _, row in numbered]
            _answers(cases[0], replace(cases[0], backend="grid").world())
            for (difficulty, row), case in zip(numbered, cases, strict=True):
                items.append(
                    Trial(f"{builder}, {backend}, design {row}", difficulty, case.seed, case)
                )
    starts, _ = read_split(DESIGNS, "test")
    digests = hashlib.sha256(
        b"".join(starts.take(np.array([row for _, row in numbered])).digests())
    )
    config = {
        "builders": {
            name: PLANNER if name == PLANNER else policy_digest(name) for name in builders
        },
        "designs": {"each": each, "digest": digests.hexdigest()},
    }
    most = max(design_task(item.job.row).max_steps + 2 for item in items)
    experiment = Experiment("builders", seed, config, items, build, timeout_s=most * ANSWER_S)
    records = list(run_experiment(experiment, out, options))
    found: dict[str, dict[str, list[TrialRecord]]] = {}
    for item, record in zip(items, records, strict=True):
        found.setdefault(item.job.builder, {}).setdefault(item.job.backend, []).append(record)
    figures = {
        "builders": {
            builder: {
                backend: {
                    name: builder_figures(some)
                    for name in (*DIFFICULTIES, _ALL)
                    if (some := [one for one in every if name in (one["group"], _ALL)])
                }
                for backend, every in of.items()
            }
            for builder, of in found.items()
        },
        "differences": {
            builder: _difference(found[builders[0]]["physics"], found[builder]["physics"])
            for builder in [*found][1:]
        },
        "errors": sum(record["error"] is not None for record in records),
    }
    return _report(figures, seed, config, len(numbered))


def builder_figures(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what a builder comes to on some designs; of those without a result nothing is in place."""
    kept = [record["extra"] for record in records if record["error"] is None]
    names = ("predicted", "allowed", "acted", "unreadable", "turns")
    predicted, allowed, acted, unreadable, turns = (
        sum(one[name] for one in kept) for name in names
    )
    place = mean_of([one["in_place"] for one in kept] + [0.0] * (len(records) - len(kept)))
    if place.low is not None and place.high is not None:
        place = Estimate(place.value, max(0.0, place.low), min(1.0, place.high))
    return {
        "built": Proportion.of(sum(one["built"] for one in kept), len(records)),
        "in_place": place,
        "as_predicted": Proportion.of(predicted, allowed),
        "forbidden": acted - allowed,
        "acted": acted,
        "unreadable": unreadable,
        "turns": turns,
        "errors": len(records) - len(kept),
    }


def _difference(first: Sequence[TrialRecord], second: Sequence[TrialRecord]) -> dict[str, Any]:
    """Return how much more of the designs the second builds, and the least difference that would be found."""
    pairs = [(one["agrees"], other["agrees"]) for one, other in zip(first, second, strict=True)]
    counts = pairs.count((True, False)), pairs.count((False, True)), len(pairs)
    return {
        "built": paired_difference(*counts),
        "least_detectable": least_detectable_of_pairs(*counts),
    }


def _report(figures: dict[str, Any], seed: int, config: dict[str, Any], n_designs: int) -> Report:
    heads = (
        "designs",
        "built",
        "95 %",
        "in place, %",
        "95 %",
        "as predicted",
        "forbidden",
        "unreadable",
    )
    columns = (Column("builder"), Column("on"), *numbers(*heads))
    rows = [
        (builder, backend, difficulty, *_cells(one))
        for builder, of in figures["builders"].items()
        for backend, parts in of.items()
        for difficulty, one in parts.items()
    ]
    note = (
        "built, and in place at the end: by design, with the interval over designs; as predicted: of the actions that "
        "the rules allow, stop aside; forbidden: of all actions; unreadable: answers"
    )
    tables = [DataTable(columns, rows, "Builders", note)]
    if pairs := figures["differences"]:
        first = next(iter(figures["builders"]))
        others = [
            (
                name,
                *(f"{share:+.2f}" for share in astuple(one["built"])),
                f"{one['least_detectable']:.2f}",
            )
            for name, one in pairs.items()
        ]
        head = numbers("builder", "more built", "from", "to", "detectable")
        tables.append(
            DataTable(head, others, f"Compared with {first}, in physics, paired by design")
        )
    return Report(
        "Builders that answer in words",
        f"{n_designs} designs",
        measurement_headline(f"{n_designs} designs for each builder", figures["errors"]),
        sections=[
            Section(
                "builders", "Builders", "Turns: twice the ticks of a plan.", tables, terminal=True
            )
        ],
        document=document(figures, command="builders", seed=seed, config=config),
    )


def _cells(one: Mapping[str, Any]) -> tuple[str, ...]:
    built, place, predicted = one["built"], one["in_place"], one["as_predicted"]
    interval = "" if place.low is None else f"{100 * place.low:.0f}-{100 * place.high:.0f}"
    return (
        f"{built.successes} of {built.trials}",
        f"{built.low:.2f}-{built.high:.2f}",
        f"{100 * place.value:.0f}",
        interval,
        f"{predicted.successes:,} of {predicted.trials:,}",
        f"{one['forbidden']:,} of {one['acted']:,}",
        f"{one['unreadable']:,} of {one['turns']:,}",
    )


def main(words: Sequence[str] | None = None) -> int:
    """Let the builders build."""
    parser = options(__doc__, "builders")
    parser.add_argument(
        "builders", nargs="*", metavar="BUILDER", help=f"default: {' '.join(BASELINES)}"
    )
    parser.add_argument(
        "--each", type=int, default=EACH, metavar="N", help="designs of each difficulty"
    )
    asked = parser.parse_args(words)
    builders = asked.builders or BASELINES
    return publish(
        asked,
        "designs",
        lambda run: builders_report(builders, asked.each, asked.seed, asked.out, run),
    )


if __name__ == "__main__":
    sys.exit(main())

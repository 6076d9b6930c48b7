"""What choosing on a cheaper model costs: policies, plans and gains chosen there, and their values on the reference.

    OMP_NUM_THREADS=1 python scripts/cheaper.py    # half an hour of CPU time; goes on after the last finished model

Cheaper models are the grid (which has no gains) and the drive ``wheels``, under mild and strong randomization; the
reference is the drive ``rollers`` under strong randomization. Their seeds differ, and all candidates of a set have the
same trials. The best on the reference is chosen on a random half of its trials and valued on the other, beside what is
chosen on a cheaper model, and the other way round. Intervals resample trials, and choose again each time. Writes
docs/results/cheaper.json.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from measure_results import revision
from numpy.typing import NDArray
from scipy.stats import spearmanr

from craftsim import parallel_env
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.experiments.intervals import (
    CONFIDENCE,
    Proportion,
    least_detectable_of_pairs,
    mean_maximum_rank_violation,
)
from craftsim.learning.policies import make_policy
from craftsim.planning import NoPlanError, plan_building
from craftsim.planning.plan_file import read_plan, write_plan
from craftsim.reports.json_file import json_value, versions
from craftsim.skills.gains import Gains, load_gains
from craftsim.tasks import make_task
from craftsim.tuning.tunable import tunable_gains, values_at, with_values
from craftsim.validation.validation import validate

ROOT: Final = Path(__file__).parents[1]
STORED: Final = ROOT / "docs" / "results" / "cheaper.json"
SEED: Final = 1
RESAMPLES: Final = 2000
TRAINED: Final = ((2560, 0), (2560, 1), (5120, 0), (5120, 1), (20480, 0))
"""Joint steps and seeds of the policies that are trained."""
TRAINING: Final = (
    "--network relative --imitate 2000 --worlds 32 --until 1 --acting varied --episodes 20"
)
PLAN_SEARCHES: Final[Sequence[tuple[Any, Any, int, int]]] = (
    ("physical", "makespan", 1, 0),
    ("physical", "makespan", 16, 0),
    ("physical", "makespan", 16, 1),
    ("physical", "makespan", 16, 3),
    ("physical", "work", 1, 0),
    ("physical", "work", 1, 1),
    ("physical", "work", 16, 0),
    ("published", "makespan", 1, 0),
    ("published", "makespan", 16, 1),
    ("published", "work", 4, 0),
    ("published", "work", 16, 2),
)
"""Rules, objective, attempts and seed."""
DRAWN_GAINS: Final = 6
GAINS_SPREAD: Final = 0.25
"""Standard deviation of drawn gains on the logarithmic scale of ``craftsim tune``, as of its first candidates."""
GRID: Final = "grid"
REFERENCE: Final = "rollers, strong"
PHYSICS: Final[Mapping[str, Mapping[str, Any]]] = {
    "wheels, mild": {"drive": "wheels", "randomize": "mild", "seed": SEED, "trials": 16},
    "wheels, strong": {"drive": "wheels", "randomize": "strong", "seed": SEED, "trials": 16},
    REFERENCE: {"drive": "rollers", "randomize": "strong", "seed": SEED + 1, "trials": 40},
}
GRID_TRIALS: Final = 100

Floats = NDArray[np.float64]
Options = Mapping[str, Any]
"""Of ``craftsim.validate``: they say which candidate is tried."""


@dataclass(frozen=True)
class Candidates:
    """A set of candidates, of which one is to be chosen."""

    kind: str
    world: str
    options: Callable[[str, Path], Mapping[str, Options]]
    """Given the task and a folder, returns the options of each candidate by its name."""
    on_grid: Callable[[str, Options], list[list[float]]] | None
    """Returns its trials on the grid, as rows of success and makespan; None where the grid cannot try it."""

    @property
    def task(self) -> str:
        """Name of the task, without its part of the starts."""
        return self.world.removesuffix("@test")


def policies(task: str, out: Path) -> dict[str, Options]:
    """Train what is missing, and return the policies of a task: trained, shipped, greedy and random ones."""
    from craftsim.learning.checkpoint import read_policy, save_policy
    from craftsim.learning.policy_files import policy_file

    head, net = read_policy(policy_file(task))
    greedy = out / "greedy.safetensors"
    save_policy(greedy, replace(head, config=replace(head.config, acting="greedy")), net)
    found = {"random": "random", "shipped": task, "shipped, greedy": str(greedy)}
    for steps, seed in TRAINED:
        folder = out / f"{steps}-{seed}"
        if not (folder / "report.json").exists():
            words = ["train", task, *TRAINING.split(), "--steps", str(steps), "--seed", str(seed)]
            words += ["--evaluate-every", str(steps), "--resume", "--out", str(folder)]
            subprocess.run([sys.executable, "-P", "-m", "craftsim", *words], cwd=ROOT, check=True)
        found[f"{steps} steps, seed {seed}"] = str(folder)
    return {name: {"policy": policy} for name, policy in found.items()}


def plans(task_name: str, out: Path) -> dict[str, Options]:
    """Return the different plans that several searches find."""
    task = make_task(task_name)
    start = task.draw(np.random.default_rng(0))
    found: dict[str, Any] = {}
    for rules, objective, attempts, seed in PLAN_SEARCHES:
        try:
            plan = plan_building(
                start,
                task,
                Rules(rules),
                objective=objective,
                rounds=attempts,
                seed=seed,
                exact=False,
            )
        except NoPlanError:
            continue
        if plan.ticks not in found.values():
            found[f"{rules}, {objective}, {attempts} attempts, seed {seed}"] = plan.ticks
    options: dict[str, Options] = {}
    for number, (name, ticks) in enumerate(found.items()):
        path = out / f"{number}.plan"
        write_plan(ticks, path)
        options[name] = {"plan": str(path)}
    return options


def gains(task: str, out: Path) -> dict[str, Options]:
    """Return the presets and gains drawn around ``robust``."""
    start = load_gains()
    tunable = tunable_gains("drive", start)
    found: dict[str, Gains | str] = {"robust": "robust", "fast": "fast"}
    for number in range(DRAWN_GAINS):
        rng = np.random.default_rng([SEED, number])
        positions = rng.normal(0.0, GAINS_SPREAD, len(tunable))
        found[f"drawn {number}"] = with_values(start, tunable, values_at(tunable, positions))
    return {name: {"gains": chosen} for name, chosen in found.items()}


def policy_on_grid(world: str, options: Options) -> list[list[float]]:
    """Return success and makespan of a policy's episodes on the grid."""
    env = parallel_env(world, GRID)
    rows = []
    for number in range(GRID_TRIALS):
        seed = 1000 * SEED + number
        policy = make_policy(options["policy"], seed)
        observations, _ = env.reset(seed=seed)
        makespan_s = 0.0
        success = False
        while env.agents:
            observations, _, _, _, infos = env.step(policy(observations))
            info = next(iter(infos.values()))
            makespan_s += info["duration_s"]
            success = bool(info["success"])
        rows.append([float(success), makespan_s])
    return rows


def plan_on_grid(task_name: str, options: Options) -> list[list[float]]:
    """Return success and makespan of a plan by the rules: one row, for nothing is drawn."""
    task = make_task(task_name)
    start = task.draw(np.random.default_rng(0))
    plan = read_plan(Path(options["plan"]), start.n_cars)
    schedule = make_schedule(start, plan.ticks, Rules("physical"))
    is_built = not schedule.forbidden and task.succeeded(schedule.final)
    return [[float(is_built), schedule.makespan()]]


SETS: Final = (
    Candidates("gains", "simple_two_story", gains, None),
    Candidates("plans", "breaking_barrier", plans, plan_on_grid),
    Candidates("policies", "random_strip@test", policies, policy_on_grid),
)


def in_physics(candidates: Candidates, model: str, options: Options) -> list[list[float]]:
    """Return success and makespan of a candidate's trials in physics.

    A policy succeeds where it reaches the goal, plans and gains where every action is as predicted.
    """
    rows = []
    for record in validate(candidates.world, **PHYSICS[model], **options).records:
        if record["error"] is not None:
            rows.append([0.0, 0.0])
            continue
        success = record["agrees"]
        if candidates.kind == "policies":
            success = bool(record["extra"]["physics_success"])
        rows.append([float(success), float(record["extra"]["makespan_s"])])
    return rows


def tried(candidates: Candidates, out: Path) -> dict[str, Any]:
    """Try all candidates on each model, once; return their trials and CPU seconds of a trial, by model."""
    folder = out / f"{candidates.kind}-{candidates.task}"
    folder.mkdir(parents=True, exist_ok=True)
    stored = folder / "trials.json"
    result: dict[str, Any] = {"revision": revision(), "trials": {}, "cpu_s": {}}
    if stored.exists():
        result = json.loads(stored.read_text(encoding="utf-8"))
    models = list(PHYSICS)
    if candidates.on_grid is not None:
        models.insert(0, GRID)
    missing = [model for model in models if model not in result["trials"]]
    options: Mapping[str, Options] = {}
    if missing:
        options = candidates.options(candidates.task, folder)
    for model in missing:
        before_s = used_s()
        trials = {}
        for name, option in options.items():
            print(candidates.kind, candidates.task, model, name, flush=True)
            if model == GRID and candidates.on_grid is not None:
                trials[name] = candidates.on_grid(candidates.world, option)
            else:
                trials[name] = in_physics(candidates, model, option)
        result["trials"][model] = trials
        result["cpu_s"][model] = (used_s() - before_s) / sum(map(len, trials.values()))
        stored.write_text(json.dumps(result), encoding="utf-8")
    result["trials"] = {model: result["trials"][model] for model in models}
    return result


def used_s() -> float:
    """Return the CPU seconds of this process and of those that it has waited for."""
    total_s = 0.0
    for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN):
        usage = resource.getrusage(who)
        total_s += usage.ru_utime + usage.ru_stime
    return total_s


# Trials of the candidates on a model are of shape (candidates, trials, 2): success and makespan.


def shares(trials: Floats) -> Floats:
    """Return the share of successes of each candidate."""
    return trials[:, :, 0].mean(axis=1)


def makespans_s(trials: Floats) -> Floats:
    """Return the mean makespan of each candidate's successes; infinite without one."""
    success = trials[:, :, 0]
    n = success.sum(axis=1)
    total_s = (success * trials[:, :, 1]).sum(axis=1)
    return np.where(n > 0, total_s / np.maximum(n, 1), np.inf)


def ranks(trials: Floats) -> Floats:
    """Return the rank of each candidate, higher is better: by success, and by makespan where it ties."""
    scores = np.stack([shares(trials), -makespans_s(trials)], axis=1)
    positions = np.unique(scores, axis=0, return_inverse=True)[1]
    return np.asarray(positions, float).ravel()


def chosen_on(trials: Floats) -> int:
    """Return the best candidate, the first of equal ones."""
    return int(ranks(trials).argmax())


def success_regret(there: Floats, first: Floats, second: Floats) -> float:
    """Return by how much the best on the reference succeeds more often than what is chosen there.

    It is chosen on one half, and both are valued on the other; the mean of both ways.
    """
    regrets = []
    for half, fresh in ((first, second), (second, first)):
        share = shares(fresh)
        regrets.append(share[chosen_on(half)] - share[chosen_on(there)])
    return float(np.mean(regrets))


def makespan_regret(there: Floats, first: Floats, second: Floats) -> float:
    """Return by what share it takes longer, in the same way; NaN where one of them never succeeds."""
    regrets = []
    for half, fresh in ((first, second), (second, first)):
        mean_s = makespans_s(fresh)
        pair_s = mean_s[[chosen_on(half), chosen_on(there)]]
        if not np.isfinite(pair_s).all():
            return float("nan")
        regrets.append(pair_s[1] / pair_s[0] - 1)
    return float(np.mean(regrets))


def rank_correlation(there: Floats, *reference: Floats) -> float:
    """Return Spearman's correlation of the ranks; NaN where all are equal."""
    both = (ranks(there), ranks(np.concatenate(reference, axis=1)))
    if min(map(np.ptp, both)) == 0:
        return float("nan")
    return float(spearmanr(*both).statistic)


def violation(there: Floats, *reference: Floats) -> float:
    """Return the mean maximum rank violation of the shares of success."""
    return mean_maximum_rank_violation(shares(there), shares(np.concatenate(reference, axis=1)))


REGRETS: Final = {"success_regret": success_regret, "makespan_regret": makespan_regret}
AGREEMENT: Final = {"spearman": rank_correlation, "violation": violation}


def estimated(
    measures: Mapping[str, Callable[..., float]], reference: Floats, *there: Floats
) -> dict[str, list[float] | None]:
    """Return measures of trials on a model and in halves of the reference, each with the ends of its interval.

    They are means over random halves. For the interval trials are resampled in each half, for all candidates together,
    and choices made again. None where a measure is not defined.
    """
    estimates: dict[str, list[float] | None] = {}
    half = reference.shape[1] // 2
    for name, measure in measures.items():
        rng = np.random.default_rng(SEED)
        values = []
        resampled_values = []
        for _ in range(RESAMPLES):
            order = rng.permutation(reference.shape[1])
            models = [*there, reference[:, order[:half]], reference[:, order[half:]]]
            values.append(measure(*models))
            resampled = []
            for trials in models:
                n = trials.shape[1]
                resampled.append(trials[:, rng.integers(n, size=n)])
            resampled_values.append(measure(*resampled))
        estimates[name] = None
        if np.isfinite(values).any():
            tail = (1 - CONFIDENCE) / 2
            low, high = np.nanquantile(resampled_values, (tail, 1 - tail))
            estimates[name] = [float(np.nanmean(values)), float(low), float(high)]
    return estimates


def compared(candidates: Candidates, result: Mapping[str, Any]) -> dict[str, Any]:
    """Return what choosing on each cheaper model costs, for a set of candidates."""
    names = list(result["trials"][REFERENCE])
    models = {}
    for model, by_name in result["trials"].items():
        models[model] = np.array(list(by_name.values()), float)
    reference = models[REFERENCE]
    rows = []
    for model, trials in models.items():
        chosen = chosen_on(trials)
        success = reference[chosen, :, 0]
        row = {
            "model": model,
            "trials": trials.shape[1],
            "cpu_s": result["cpu_s"][model],
            "chosen": names[chosen],
            "success": Proportion.of(int(success.sum()), len(success)),
        }
        if model == REFERENCE:
            # The control arm: nothing is changed but the seeds of the trials.
            row |= {"least_detectable": least_detectable(reference)}
            row |= estimated(AGREEMENT, reference)
        else:
            row |= estimated(REGRETS | AGREEMENT, reference, trials)
        rows.append(row)
    return {
        "kind": candidates.kind,
        "task": candidates.task,
        "revision": result["revision"],
        "rows": rows,
        "candidates": {
            name: {
                model: [
                    float(trials[number, :, 0].sum()),
                    trials.shape[1],
                    makespans_s(trials)[number],
                ]
                for model, trials in models.items()
            }
            for number, name in enumerate(names)
        },
    }


def least_detectable(reference: Floats) -> float:
    """Return the least difference of success that the reference can find between its two best candidates."""
    second, best = ranks(reference).argsort()[-2:]
    difference = reference[best, :, 0] - reference[second, :, 0]
    return least_detectable_of_pairs(
        int((difference > 0).sum()), int((difference < 0).sum()), len(difference)
    )


HEAD: Final = (
    "candidates",
    "chosen on",
    "CPU s",
    "succeeds",
    "regret, points",
    "makespan, %",
    "ranks",
)


def table_of(stored: Mapping[str, Any]) -> list[Sequence[object]]:
    """Return the table of a stored result, the head first."""
    rows: list[Sequence[object]] = [HEAD]
    for compared_set in stored["sets"]:
        title = f"{compared_set['kind']}, `{compared_set['task']}`"
        for row in compared_set["rows"]:
            success = row["success"]
            bounds = f"{success['wilson_low']:.2f}..{success['wilson_high']:.2f}"
            regrets = [_text(row.get(name), 100, 1) for name in REGRETS]
            if row["model"] == REFERENCE:
                regrets = [f"finds {100 * row['least_detectable']:.0f}", ""]
            cells = (
                title,
                row["model"],
                f"{row['cpu_s']:.1f}",
                f"{success['successes']}/{success['trials']} ({bounds})",
                *regrets,
                _text(row["spearman"], 1, 2),
            )
            rows.append(cells)
            title = ""
    return rows


def _text(estimate: Sequence[float] | None, factor: int, decimals: int) -> str:
    """Return a value with its interval."""
    if estimate is None:
        return "-"
    value, low, high = (f"{factor * number + 0.0:.{decimals}f}" for number in estimate)
    return f"{value} ({low}..{high})"


def main() -> None:
    """Try what is missing, compare, and store."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "cheaper")
    out: Path = parser.parse_args().out.resolve()
    sets = []
    for candidates in SETS:
        sets.append(compared(candidates, tried(candidates, out)))
    stored = {
        "command": "python scripts/cheaper.py",
        "seed": SEED,
        "versions": versions(),
        "sets": sets,
    }
    STORED.write_text(json.dumps(json_value(stored), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

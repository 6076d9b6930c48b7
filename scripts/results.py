"""Write the tables and plots of docs/results from the reports that are stored there.

    python scripts/results.py                       # from the stored reports
    python scripts/results.py --measure [NAME ...]  # run the commands again first, all of them or some

Everything that a page says in numbers comes from here. ``docs/results/earlier.yaml`` has what earlier versions came to,
whose reports were not kept.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from statistics import mean, median
from typing import Any, Final

import engines
import yaml
from scipy.stats import ttest_1samp

from craftsim.experiments.intervals import Proportion
from craftsim.studies.results import plot_results
from craftsim.studies.study import read_study

ROOT: Final = Path(__file__).parents[1]
README: Final = ROOT / "README.md"
SIX: Final = re.compile(r"(<!-- results: [^\n]* -->\n)\n.*?(<!-- end of results -->)", re.DOTALL)
"""Where README has its table."""
RESULTS: Final = ROOT / "docs" / "results"
RUNS: Final = RESULTS / "runs"
TRAINING: Final = RESULTS / "training"
OUT: Final = ROOT / "out" / "results"

LATE, BIASED, LAGGING = "docs/results/late.yaml", "docs/results/biased.yaml", "docs/results/lagging.yaml"
BUILT: Final = "--plan auto --attempts 8 --drive reduced --trials 5 --seed 1"
MEASURED: Final = {
    "demo": "demo --randomize none --no-video",
    "heavier_car": "demo --randomize none --machines examples/heavier_car.yaml --no-video",
    "conformance": "conformance tests/data/traces.jsonl.gz",
    "late": f"validate --randomize none --noise {LATE} --trials 2",
    "biased": f"validate --randomize none --noise {BIASED} --trials 2",
    "lagging": f"validate --randomize none --noise {LAGGING} --trials 2",
    "strong": "validate --order concurrent --randomize strong --trials 4",
    "lab_floor": "validate simple_two_story --randomize lab_floor --trials 8",
    "workshop_floor": "validate simple_two_story --randomize workshop_floor --trials 8",
    "random": "validate random --randomize none --trials 20 --seed 3232",
    "large_tower_4": f"validate large_tower_4 --randomize none {BUILT}",
    "large_tower_4_mild": f"validate large_tower_4 --randomize mild {BUILT}",
    "large_tower_8_mild": f"validate large_tower_8 --randomize mild {BUILT}",
    "audit_physical": "audit --quick --rules physical --drive reduced",
    "audit_published": "audit --quick --drive reduced",
    "margins": "audit margins --quick",
    "execution_plans": "bench execution --worlds 100",
    "execution_policies": "bench execution random_strip random_block random_simple_two_story random_breaking_barrier",
    "builders": "bench builders",
}
"""What is measured, each in less than four minutes of CPU time but for execution."""
STUDIES: Final = {
    "paper_ippo": (),
    "paper": ("curves.png", "profiles.png"),
    "random": ("curves.png",),
    "random_complex": ("curves.png",),
    "designs": ("curves.png",),
}
"""The stored studies, and which of their plots are shown."""
LARGE_STEPS, PROCESSORS = 100_000_000, 200
"""Of a run on a cluster, as the table of the large tasks works it out."""
EVALUATIONS: Final = ("designs_greedy", "designs_cars3", "designs_cars4", "designs_zero")


def main() -> None:
    """Write all tables; measure before if asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--measure", nargs="*", choices=MEASURED, metavar="NAME")
    asked = parser.parse_args().measure
    for name in MEASURED if asked == [] else asked or ():
        measure(name)
    for name, text in tables().items():
        (RESULTS / f"{name}.md").write_text(text, encoding="utf-8")
    readme = README.read_text(encoding="utf-8")
    README.write_text(
        SIX.sub(lambda found: f"{found[1]}\n{six_results()}\n{found[2]}", readme), encoding="utf-8"
    )
    plot()


def measure(name: str) -> None:
    """Run a command, and store what its report says."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    out = OUT / name
    command = [sys.executable, "-P", "-m", "craftsim", *MEASURED[name].split(), "--out", str(out)]
    print(" ".join(command[3:]), flush=True)
    subprocess.run(command, cwd=ROOT, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    store(name, out, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)


def store(name: str, out: Path, cpu_s: float | None) -> None:
    """Store of a report what a table says, with command and revision; a resumed run has no CPU time."""
    revision = subprocess.run(
        ["git", "rev-parse", "--short=8", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    kept = {
        "command": MEASURED[name],
        "revision": revision.stdout.strip(),
        "cpu_s": None if cpu_s is None else round(cpu_s, 1),
        "versions": report["versions"],
        "figures": {key: _without_lists(value) for key, value in report["figures"].items()},
    }
    RUNS.mkdir(parents=True, exist_ok=True)
    (RUNS / f"{name}.json").write_text(json.dumps(kept, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def _without_lists(value: Any) -> Any:
    """Leave out what is listed by row, group or action: a table has none of it."""
    if isinstance(value, dict):
        left_out = (
            "by_group",
            "by_verb",
            "durations",
            "survival",
            "drift",
            "coverage",
            "rows",
            "suspects",
            "hypotheses",
            "at_once",
        )
        return {key: _without_lists(one) for key, one in value.items() if key not in left_out}
    return [] if isinstance(value, list) and len(value) > 8 and isinstance(value[0], dict) else value


def tables() -> dict[str, str]:
    """Return all tables in Markdown, by the name of their file."""
    return {
        "physics": physics_table(),
        "margins": margins_table(),
        "execution": execution_table(),
        "execution_trained": trained_table(),
        "builders": builders_table(),
        "engines": table(*engines.table_of(_read(engines.STORED))),
        "floors": floors_table(_read(engines.STORED)),
        "earlier": earlier_table(),
        **{
            f"speed_{what}": rates_table(_read(RESULTS / f"speed_{what}.json"))
            for what in ("rules", "env", "physics")
        },
        "benchmarks": benchmark_tables(_read(RESULTS / "benchmarks.json")),
        "large": large_table(_read(RESULTS / "large.json")),
        "structures": structures_table(_read(RESULTS / "structures.json")),
        "paper": algorithms_table(_read(TRAINING / "paper.json")),
        "qmix": qmix_table(),
        "studies": studies_table(),
        "evaluations": evaluations_table(),
        "policies_in_physics": policies_table(),
        "training_in_physics": training_in_physics_table(),
        "shipped_policies": shipped_table(),
    }


def _read(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def table(*rows: Iterable[object]) -> str:
    """Return rows as a table in Markdown; the first is the head."""
    head, *body = ([str(cell).replace("|", "\\|") for cell in row] for row in rows)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *body)) + "\n"


def physics_table() -> str:
    """Return what the commands of :data:`MEASURED` came to."""
    rows: list[tuple[str, ...]] = []
    for name in MEASURED:
        if (path := RUNS / f"{name}.json").exists():
            run = _read(path)
            rows.append(
                (
                    f"`craftsim {run['command']}`",
                    _said(run["figures"]),
                    "" if run["cpu_s"] is None else f"{run['cpu_s']:.0f} s",
                    run["revision"],
                )
            )
    return table(("command", "result", "CPU time", "revision"), *rows)


def _said(figures: dict[str, Any]) -> str:
    """Return in words what a report holds."""
    sayings: dict[str, Callable[[dict[str, Any]], str]] = {
        "total_checks": _conformance,
        "margins": _margins,
        "audit": _audit,
        "validation": _validation,
        "agree": _demo,
        "concurrent_by": _orders,
        "modes": lambda figures: f"{len(figures['modes'])} policies, below",
        "builders": _builders,
    }
    return next(say(figures) for key, say in sayings.items() if figures.get(key) is not None)


def _demo(figures: dict[str, Any]) -> str:
    return (
        f"{figures['agree']} of {figures['total']} actions agree; cars within {figures['max_car_error_mm']:.2f} mm and "
        f"{figures['max_car_heading_error_mrad']:.2f} mrad, objects set down within "
        f"{figures['max_placed_error_mm']:.2f} mm, bystanders within "
        f"{figures['max_bystander_displacement_mm']:.2f} mm; {figures['simulated_s']:.1f} s simulated"
    )


def _validation(figures: dict[str, Any]) -> str:
    found = figures["validation"]
    actions, runs, errors = found["all"]["actions"], found["all"]["runs"], found["precision"]["car_error_mm"]
    return (
        f"{actions['successes']:,} of {actions['trials']:,} actions as predicted ({_interval(actions)}), "
        f"{runs['successes']} of {runs['trials']} runs; 99 % of cars within {errors['p99']:.2f} mm"
    )


def _orders(figures: dict[str, Any]) -> str:
    compared = figures["concurrent_by"] | {"predicted": figures["executed_by_predicted"]["concurrent"]}
    said = [
        f"{one['value']:.2f} ({one['low']:.2f}-{one['high']:.2f}) times {name}"
        for name, one in compared.items()
    ]
    planned = figures["as_predicted"]["ticks"]["trials"]
    return (
        f"{figures['compared']} of {planned} plans as predicted in all orders; makespans, asynchronously: "
        f"{', '.join(said)}"
    )


def execution_table() -> str:
    """Return how often policies succeed in each mode of execution, and how long that takes."""
    found = _read(RUNS / "execution_policies.json")["figures"]["modes"]
    modes = list(next(iter(found.values())))
    rows = [
        (
            f"`{policy}`",
            *(f"{of[mode]['success']['rate']:.2f}, {of[mode]['makespan_s']:.1f} s" for mode in modes),
        )
        for policy, of in found.items()
    ]
    starts = next(iter(found.values()))[modes[0]]["success"]["trials"]
    return f"Success over {starts} starts, and makespan.\n\n" + table(("policy", *modes), *rows)


def trained_table() -> str:
    """Return the success of policies trained in ticks and asynchronously, over seeds of training, in each mode."""
    rates: dict[tuple[str, str], dict[str, list[float]]] = {}
    starts = 0
    for path in sorted(RUNS.glob("execution_trained_*.json")):
        for policy, modes in _read(path)["figures"]["modes"].items():
            task, how, _ = policy.rsplit("-", 2)
            for mode, one in modes.items():
                rates.setdefault((task, how), {}).setdefault(mode, []).append(one["success"]["rate"])
                starts = one["success"]["trials"]
    modes = list(next(iter(rates.values())))
    rows = [
        (f"`{task}`", how, len(found[modes[0]]), *(_over_seeds(found[mode]) for mode in modes))
        for (task, how), found in sorted(rates.items())
    ]
    return f"{starts} starts a policy, the same for all.\n\n" + table(
        ("task", "trained", "seeds", *modes), *rows
    )


def _over_seeds(rates: list[float]) -> str:
    """Return the mean with its t interval, cut off at 0 and 1."""
    estimate = mean(rates)
    if len(set(rates)) < 2:
        return f"{estimate:.2f}"
    low, high = ttest_1samp(rates, 0.0).confidence_interval(0.95)
    return f"{estimate:.2f} ({max(0.0, low):.2f}-{min(1.0, high):.2f})"


def _builders(figures: dict[str, Any]) -> str:
    built = {name: found["physics"]["all"]["built"] for name, found in figures["builders"].items()}
    return "; ".join(f"{name} built {one['successes']} of {one['trials']}" for name, one in built.items())


def builders_table() -> str:
    """Return how much of the designs the baselines build that answer in words."""
    designs = ("one level", "with a ramp", "two levels", "all")
    rows = [
        (
            f"`{builder}`",
            backend,
            *(f"{parts[name]['built']['successes']} of {parts[name]['built']['trials']}" for name in designs),
            "{wilson_low:.2f}-{wilson_high:.2f}".format(**parts["all"]["built"]),
            f"{100 * parts['all']['in_place']['value']:.0f} %",
            f"{parts['all']['as_predicted']['successes']} of {parts['all']['as_predicted']['trials']}",
            parts["all"]["forbidden"],
        )
        for builder, of in _read(RUNS / "builders.json")["figures"]["builders"].items()
        for backend, parts in of.items()
    ]
    head = ("builder", "on", *designs, "95 %", "in place", "as predicted", "forbidden")
    return table(head, *rows)


def floors_table(stored: dict[str, Any]) -> str:
    """Return of each of the six tasks how many actions fail at most, as far as the reference of the engines shows."""
    tasks = stored["found"][stored["reference"]]["tasks"]["by_task"]
    rows = []
    for task, one in tasks.items():
        share = Proportion.of(one["good"], one["actions"])
        most = "" if share.wilson_low is None else f"{100 * (1 - share.wilson_low):.1f} %"
        rows.append((f"`{task}`", f"{share.successes}/{share.trials}", most))
    return table(("task", "actions as predicted", "failures, at most (95 %)"), *rows)


def _interval(share: dict[str, float]) -> str:
    return f"{100 * share['wilson_low']:.1f}-{100 * share['wilson_high']:.1f} %"


def _audit(figures: dict[str, Any]) -> str:
    verdicts, trials = figures["audit"]["verdicts"], figures["validation"]["all"]["actions"]["trials"]
    legal = verdicts["sound"] + verdicts["unsound"]
    return (
        f"{verdicts['unsound']} of {legal} rows that the rules allow are unsound; "
        f"{verdicts['conservative']} forbidden ones work, {verdicts['rightly forbidden']} do not; "
        f"{trials} actions, mostly one trial a row: provisional"
    )


def _conformance(figures: dict[str, Any]) -> str:
    checks = f"{figures['total_checks']:,} checks, {figures['total_mismatches']} mismatches"
    return f"{figures['records']:,} records, {checks}"


def _margins(figures: dict[str, Any]) -> str:
    weakest = figures["margins"]["weakest"]
    return f"margins of {len(weakest)} actions, below"


def margins_table() -> str:
    """Return the margin of the weakest situation of each action."""
    weakest = _read(RUNS / "margins.json")["figures"]["margins"]["weakest"]
    imperfections = [*dict.fromkeys(name for found in weakest.values() for name in found)]
    rows = [
        (action, *(found.get(name, {}).get("text", "") for name in imperfections))
        for action, found in weakest.items()
    ]
    return table(("action", *imperfections), *rows)


def six_results() -> str:
    """Return the table of README."""
    late, strong, workshop, published, conformance = (
        _read(RUNS / f"{name}.json")["figures"]
        for name in ("late", "strong", "workshop_floor", "audit_published", "conformance")
    )
    delayed, drawn, floor = (_counts(one) for one in (late, strong, workshop))
    verdicts = published["audit"]["verdicts"]
    legal = verdicts["sound"] + verdicts["unsound"]
    shipped = next(row for row in _policy_rows([TRAINING / "physics_random_strip.json"]) if row[1] == "mild")
    rates = _read(RESULTS / "speed_physics.json")["wall"]["rates"]["simple_two_story"]
    return table(
        ("what", "result"),
        ("six tasks, masses, friction, motors and sensors drawn (`strong`)", f"{drawn} actions as predicted"),
        ("six tasks, localisations late by 100 ms, unknown to the cars", f"{delayed} actions as predicted"),
        ("one task on a tiled workshop floor", f"{floor} actions as predicted"),
        (
            "CraftEnv's rules in a quick audit",
            f"{verdicts['unsound']} of {legal} kinds of situations that they allow fail in physics (one trial each)",
        ),
        (
            "rules `published` against recordings of CraftEnv",
            f"{conformance['total_mismatches']} mismatches in {conformance['total_checks']:,} checks",
        ),
        (
            "shipped policy `random_strip` on held-out starts",
            f"built {shipped[4]} of {shipped[2]} in physics, {shipped[3]} by the rules",
        ),
        (
            "joint steps of two cars in physics a CPU second",
            f"{_three_digits(rates['reduced']['steps_a_second'])} with the reduced drive, "
            f"{_three_digits(rates['rollers']['steps_a_second'])} on rollers",
        ),
    )


def _counts(figures: dict[str, Any]) -> str:
    actions = figures["validation"]["all"]["actions"]
    return f"{actions['successes']:,} of {actions['trials']:,}"


def earlier_table() -> str:
    """Return what earlier versions came to."""
    kept = yaml.safe_load((RESULTS / "earlier.yaml").read_text(encoding="utf-8"))
    return table(
        ("command", "result", "version"),
        *((f"`{one['command']}`", one["result"], one["version"]) for one in kept),
    )


def rates_table(report: dict[str, Any]) -> str:
    """Return the rates of ``craftsim bench`` beside those that CraftEnv is estimated to have."""
    rows = [
        (task, case, *(_three_digits(rate[key]) for key in ("steps_a_second", "reference_a_second", "times")))
        for task, cases in sorted(report["wall"]["rates"].items(), reverse=True)
        for case, rate in cases.items()
    ]
    return table(("task", "case", "steps a CPU second", "CraftEnv, estimated", "ratio"), *rows)


def _three_digits(value: float) -> str:
    return f"{value:,.{0 if value >= 100 else 1 if value >= 10 else 2}f}"


def benchmark_tables(report: dict[str, Any]) -> str:
    """Return a table for each benchmark function: a row a case, its last two parameters as columns where that fits."""
    functions: dict[str, list[dict[str, Any]]] = {}
    for one in report["benchmarks"]:
        functions.setdefault(one["fullname"].split("[")[0], []).append(one)
    parts = []
    for name, cases in functions.items():
        file, function = name.rsplit("/", 1)[-1].split("::")
        title = f"`{file}`, {function.removeprefix('test_').replace('_', ' ')}, median in ms:"
        parts.append(f"{title}\n\n{_benchmark(cases)}")
    return "\n".join(parts)


def _benchmark(cases: list[dict[str, Any]]) -> str:
    names = [*(cases[0]["params"] or {})]
    kept = names[:-2] if len(names) > 2 else names[:-1]
    rows: dict[tuple[str, ...], dict[str, str]] = {}
    for case in cases:
        params = {name: str(value) for name, value in (case["params"] or {}).items()}
        column = ", ".join(
            params[name] if name in ("what", "drive", "task", "quality") else f"{name} {params[name]}"
            for name in names[len(kept) :]
        )
        rows.setdefault(tuple(params[name] for name in kept), {})[column or "median"] = (
            f"{1e3 * case['stats']['median']:.4g}"
        )
    columns = [*dict.fromkeys(column for row in rows.values() for column in row)]
    return table(
        (*kept, *columns),
        *((*key, *(row.get(column, "") for column in columns)) for key, row in rows.items()),
    )


def large_table(report: dict[str, Any]) -> str:
    """Return what plans for the large tasks and MAPPO on them take, and what hundreds of processors would."""
    cases: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for one in report["benchmarks"]:
        what = one["params"].get("what") or one["name"].split("[")[0].removeprefix("test_")
        noted = one["extra_info"] | {"cpu_s": one["stats"]["median"]}
        cases.setdefault((one["params"]["name"], what), []).append(noted)
    rows = []
    for name, what in cases:
        if what != "random_play":
            continue
        plans, found = cases.get((name, "a_plan"), []), cases[name, what][0]
        rollout, update = (cases[name, part][0]["steps_per_s"] for part in ("rollout", "update"))
        first, ticks = (sorted(plan[key] for plan in plans) for key in ("first_s", "ticks"))
        rows.append(
            (
                f"`{name}`",
                f"{len(plans)}: {median(first):.1f} s, {first[-1]:.1f} s" if plans else "",
                f"{median(ticks):.0f}, {ticks[-1]}" if plans else "",
                f"{found['mean_return']:.2f}",
                _three_digits(found["steps_per_s"]),
                _three_digits(rollout),
                _three_digits(update),
                f"{LARGE_STEPS * (1 / rollout + 1 / update) / 3600:.1f} h",
                f"{LARGE_STEPS * (1 / (rollout * PROCESSORS) + 1 / update) / 3600:.1f} h",
                f"{LARGE_STEPS * (1 / rollout + 1 / update) / PROCESSORS / 60:.1f} min",
            )
        )
    head = (
        "task",
        "plans: first one after (median, longest)",
        "ticks of the best of 8 (median, longest)",
        "return of random play",
        "random play",
        "MAPPO's rollout",
        "MAPPO's update",
        "1 processor",
        f"{PROCESSORS} for rollouts",
        f"{PROCESSORS} for both",
    )
    return table(head, *rows)


def structures_table(stored: dict[str, Any]) -> str:
    """Return what scripts/structures.py found of each set: planned, and built in physics on a drive."""

    def share(one: dict[str, Any] | None) -> str:
        return (
            ""
            if one is None
            else "{successes:,} of {trials:,} ({wilson_low:.3f}-{wilson_high:.3f})".format(**one)
        )

    def spread(values: list[float]) -> str:
        return "-".join(f"{value:.1f}" if value < 10 else f"{value:.0f}" for value in dict.fromkeys(values))

    rows = [
        (
            f"{name}, {one['cars']} cars",
            spread(one["blocks"]),
            drive,
            share(one["planned"]),
            spread(one["plan_s"]),
            share(one.get("built")),
            share(one.get("as_predicted")),
            spread(one["executed_s"] if "built" in one else one["makespan_s"]),
            f"{one['blocks_per_hour']:.0f}" if one["blocks_per_hour"] else "",
            f"{one['mm3_per_minute_per_car'] / 1e6:.1f}" if one["blocks_per_hour"] else "",
        )
        for name, stages in stored.items()
        for drive, one in stages.items()
    ]
    head = (
        "structures",
        "blocks",
        "drive",
        "planned",
        "CPU s",
        "built",
        "actions as predicted",
        "makespan, s",
    )
    return table((*head, "blocks an hour", "1e6 mm³ a minute per car"), *rows)


def algorithms_table(report: dict[str, Any]) -> str:
    """Return the interquartile mean of success by task and algorithm, with its interval where there is one."""
    algos = [*dict.fromkeys(row["algo"] for row in report["figures"]["rows"])]
    tasks: dict[str, dict[str, str]] = {}
    for row in report["figures"]["rows"]:
        iqm, low, high = row["success"]["iqm"]
        cells = tasks.setdefault(row["task"], {"published": f"{row['published']:.2f}"})
        cells[row["algo"]] = f"{iqm:.2f}" if low == high else f"{iqm:.2f} ({low:.2f}-{high:.2f})"
    overall = {algo: f"{found['iqm'][0]:.2f}" for algo, found in report["figures"]["overall"].items()}
    rows = [(task, *(cells[key] for key in (*algos, "published"))) for task, cells in tasks.items()]
    return table(("task", *algos, "published"), *rows, ("all tasks", *(overall[algo] for algo in algos), ""))


def qmix_table() -> str:
    """Return the runs of QMIX on strip with the corrected mixer."""
    reports = [_read(path) for path in sorted(TRAINING.glob("qmix_strip_*.json"))]
    rows = [
        (
            one["config"]["seed"],
            f"{one['figures']['success']['rate']:.3f}",
            f"{one['figures']['steps'] // 1000} k",
        )
        for one in reports
    ]
    return table(("seed", "success", "steps"), *rows)


def studies_table() -> str:
    """Return success over seeds of the studies of one algorithm, with CPU times of a run."""
    rows = []
    for name in STUDIES:
        report = _read(TRAINING / f"{name}.json")
        if name == "paper":
            continue
        cpu = {key: seconds for key, seconds in report["wall"]["cpu_s"].items() if seconds is not None}
        for row in report["figures"]["rows"]:
            iqm, low, high = row["success"]["iqm"]
            times = [seconds for key, seconds in cpu.items() if key.startswith(f"{row['task']}/")] or [
                *cpu.values()
            ]
            rows.append(
                (
                    f"`{name}`",
                    row["played"],
                    row["seeds"],
                    f"{iqm:.3f} ({low:.3f}-{high:.3f})",
                    " ".join(f"{one:.3f}" for one in row["by_seed"]),
                    row["distinct_starts"],
                    f"{row['median_steps'] / 1000:,.0f} k",
                    f"{min(times) / 60:.1f}-{max(times) / 60:.1f}",
                    "" if row["published"] is None else f"{row['published']:.2f}",
                )
            )
    head = (
        "study",
        "task",
        "seeds",
        "IQM of success (95 %)",
        "by seed",
        "distinct starts",
        "steps",
        "CPU minutes a run",
        "published",
    )
    return table(head, *rows)


def evaluations_table() -> str:
    """Return what the policy for designs comes to elsewhere."""
    rows = []
    for name in EVALUATIONS:
        report = _read(TRAINING / f"{name}.json")
        for row in report["figures"]["evaluations"]:
            found = row["success"]
            success = f"{found['rate']:.3f} ({found['wilson_low']:.3f}-{found['wilson_high']:.3f})"
            rows.append(
                (
                    row["task"],
                    report["config"]["cars"] or "its own",
                    row["acting"],
                    success,
                    row["starts"]["distinct"],
                )
            )
    return table(("task", "cars", "actions", "success (95 %)", "distinct starts"), *rows)


def _policy_rows(paths: Iterable[Path]) -> list[tuple[str, ...]]:
    rows = []
    for path in paths:
        report = _read(path)
        found = report["figures"]["validation"]
        for policy in found["policies"]:
            actions = found["by_group"][policy["policy"]]["actions"]
            built = [str(round(policy[where] * policy["episodes"])) for where in ("grid", "physics")]
            good = f"{actions['successes']:,} of {actions['trials']:,}"
            rows.append(
                (policy["policy"], report["config"]["randomize"], str(policy["episodes"]), *built, good)
            )
    return rows


_POLICY_HEAD: Final = (
    "policy",
    "randomization",
    "episodes",
    "built by the rules",
    "built in physics",
    "actions as predicted",
)


def policies_table() -> str:
    """Return how the shipped policies do in physics."""
    paths = sorted(path for path in TRAINING.glob("physics_*.json") if path.stem != "physics_strong")
    return table(_POLICY_HEAD, *_policy_rows(paths))


def training_in_physics_table() -> str:
    """Return how policies do in strongly randomized physics that were trained there, or on the grid."""
    return table(_POLICY_HEAD, *_policy_rows([TRAINING / "physics_strong.json"]))


def shipped_table() -> str:
    """Return the policies that come with craftsim, and what their run of a study came to."""
    by_task = {
        row["task"]: row["by_seed"][0]
        for name in ("random", "random_complex", "designs")
        for row in _read(TRAINING / f"{name}.json")["figures"]["rows"]
    }
    rows = []
    for path in sorted((ROOT / "craftsim" / "data" / "policies").iterdir()):
        name = path.name.split(".")[0]
        if path.suffix == ".safetensors":
            built = f"{by_task[name]:.3f}" if name in by_task else "its one start"
            rows.append((f"`{name}`", built, f"{path.stat().st_size / 1e6:.1f} MB"))
    return table(("policy", "built of held-out starts", "size"), *rows)


def plot() -> None:
    """Draw what the page shows of each study."""
    for name, shown in STUDIES.items():
        if not shown:
            continue
        folder = TRAINING / name
        folder.mkdir(exist_ok=True)
        for path in plot_results(folder, read_study(name), _read(TRAINING / f"{name}.json")["figures"]):
            if path.name not in shown:
                path.unlink()


if __name__ == "__main__":
    main()

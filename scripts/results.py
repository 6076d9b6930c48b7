"""Write the tables and plots of docs/results from the reports that are stored there.

Everything that a page says in numbers comes from here.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from statistics import mean, median
from typing import Any, Final

import cheaper
import engines
import learned
import network_causes
import network_plans
import numpy as np
import paper_table
import plants
import released
from matplotlib.figure import Figure
from measure_results import (
    ELSEWHERE,
    FIRST,
    IN_PHYSICS,
    KEPT,
    MEASURED,
    NETWORK,
    OF_POLICIES,
    ON_GRID,
    SPEED,
    is_older,
)
from paper import HELD_OUT as PAPER_HELD_OUT
from paper import STORED as PAPER_RUNS
from scipy.stats import ttest_1samp

from craftsim.experiments.anytime import bounds, lower_bound
from craftsim.experiments.intervals import Proportion
from craftsim.learning.config import RELEASED_STEPS
from craftsim.learning.study import read_study
from craftsim.learning.study_results import plot_results

ROOT: Final = Path(__file__).parents[1]
README: Final = ROOT / "README.md"
IN_README: Final = r"(<!-- {name}: [^\n]* -->\n)\n.*?(<!-- end of {name} -->)"
"""Where README has a table."""
RESULTS: Final = ROOT / "docs" / "results"
RUNS: Final = RESULTS / "runs"
TRAINING: Final = RESULTS / "training"

STUDIES: Final = {
    "random": ("curves.png",),
    "random_complex": ("curves.png",),
    "designs": ("curves.png",),
    "further": (),
}
"""The studies in the table, and which of their plots are shown."""
LARGE_STEPS, PROCESSORS = 100_000_000, 200
"""Of a run on a cluster, as the table of the large tasks works it out."""


def main() -> None:
    """Write all tables and plots."""
    for name, text in tables().items():
        (RESULTS / f"{name}.md").write_text(text, encoding="utf-8")
    readme = README.read_text(encoding="utf-8")
    for name, text in readme_tables().items():
        place = re.compile(IN_README.format(name=name), re.DOTALL)
        readme = place.sub(rf"\1\n{text}\n\2", readme)
    README.write_text(readme, encoding="utf-8")
    plot()
    measured = dict.fromkeys(MEASURED, "scripts/measure_results.py") | KEPT
    older = [f"{name} ({by})" for name, by in measured.items() if is_older(name)]
    if older:
        print(f"older than the code, with what measures it again: {', '.join(older)}")


def tables() -> dict[str, str]:
    """Return all tables in Markdown, by the name of their file."""
    return {
        "physics": physics_table(),
        "margins": margins_table(),
        "execution_trained": trained_table(),
        "builders": builders_table(),
        "engines": table(*_merged(engines.table_of(_read(engines.STORED)))),
        "plants": table(*plants.matrix(plants.read_stored())),
        "workshop_floor": workshop_table(_read(RUNS / "workshop_floor.json")),
        **{name: rates_table(_read(RUNS / f"{name}.json")) for name in SPEED},
        "joint_steps": joint_steps_table(_read(RESULTS / "joint_steps.json")),
        "large": large_table(_read(RESULTS / "large.json")),
        "campaign": campaign_table(
            _read(RESULTS / "campaign.json"), _read(RUNS / "audit_legal.json")
        ),
        "structures": structures_table(_read(RESULTS / "structures.json")),
        **paper_tables(),
        "released": table(*released.table_rows(released.read_runs())),
        "released_beside": table(
            *released.beside_rows(released.read_runs(), released.read_independent())
        ),
        "studies": studies_table(),
        "evaluations": evaluations_table(),
        "policies_in_physics": policies_table(IN_PHYSICS),
        **network_tables(),
        "training_in_physics": policies_table(["training_in_physics"]),
        "shipped_policies": shipped_table(),
        "cheaper": table(*cheaper.table_of(_read(cheaper.STORED))),
        "learned": named(learned.table_rows(_read(learned.STORED))),
        "learned_corrections": named(learned.correction_rows(_read(learned.STORED))),
        "anytime": anytime_table(_read(RESULTS / "anytime.json")),
        "certificates": certificates_table(
            _read(RUNS / "certificates.json")["figures"]["certificates"]
        ),
        **reality_tables(_read(RUNS / "reality.json")["figures"]),
    }


def _read(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def table(*rows: Iterable[object]) -> str:
    """Return rows as a table in Markdown; the first is the head."""
    head, *body = ([str(cell).replace("|", "\\|") for cell in row] for row in rows)
    return (
        "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *body)) + "\n"
    )


def _merged(rows: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return rows with the names of equal ones, one after the other, in one row."""
    merged = [rows[0]]
    for name, *cells in rows[1:]:
        before, *equal = merged[-1]
        if cells == equal:
            merged[-1] = (f"{before}, {name}", *cells)
        else:
            merged.append((name, *cells))
    return merged


def named(rows: Iterable[Mapping[str, object]]) -> str:
    """Return rows as a table in Markdown, the names of whose columns they have as keys."""
    rows = list(rows)
    return table(rows[0], *(row.values() for row in rows))


def physics_table() -> str:
    """Return what the commands of :data:`measure_results.MEASURED` came to."""
    runs = [_read(path) for name in FIRST if (path := RUNS / f"{name}.json").exists()]
    return named(
        {
            "command": f"`{'python ' if run['command'].startswith('scripts/') else ''}{run['command']}`",
            "result": next(
                say(run["figures"])
                for key, say in SAYINGS.items()
                if run["figures"].get(key) is not None
            ),
            "CPU, s": "" if run["cpu_s"] is None else f"{run['cpu_s']:.0f}",
            "revision": run["revision"],
        }
        for run in runs
    )


_READINGS: Final = (
    "velocities of the whole flight",
    "the law against itself, starts as uncertain as recorded",
)
"""Of those in the report, what moves errors by more than their intervals or explains them."""


CERTAIN: Final = ("certificate_yes", "certificate_no")
WILSON: Final = ("wilson", "wilson_every_tenth_to_300")


def anytime_table(simulated: dict[str, Any]) -> str:
    """Return in how many simulated runs what is said of success rates and differences is ever wrong, in percent."""
    rows = [["truth", "interval", "yes", "no", "fixed", "fixed, every tenth trial to 300"]]
    for row in simulated["rates"]:
        shares = (row[name] for name in ("interval", *CERTAIN, *WILSON))
        rows.append([row["rate"], *(f"{100 * share:.1f}" for share in shares)])
    for row in simulated["differences"]:
        mcnemar = ""
        if "mcnemar" in row:
            mcnemar = f"{100 * row['mcnemar']:.1f}"
        pair = f"{row['only_first']:.2f}/{row['only_second']:.2f}"
        rows.append([pair, f"{100 * row['interval']:.1f}", "", "", mcnemar, ""])
    return table(*rows)


def certificates_table(certificates: Iterable[dict[str, Any]]) -> str:
    """Return what is certain of the shipped plans."""
    rows: list[tuple[str, ...]] = [
        ("plan", "answer", "as predicted", "1 run", "10 runs", "100 runs")
    ]
    for certificate in certificates:
        counts = f"{certificate['successes']}/{certificate['trials']}"
        repeated = (f"{p:.3f}" for p in certificate["repetitions"].values())
        world = certificate["subject"].partition(":")[0]
        rows.append((f"`{world}`", certificate["decision"], counts, *repeated))
    return table(*_merged(rows))


def reality_tables(figures: dict[str, Any]) -> dict[str, str]:
    """Return what recordings of a real cube and a real robot say of the contact law and the drives."""
    (law,) = figures["contact_law"]
    laws = [["law", "position, widths", "rotation, degrees"]]
    for row in [*law["laws"], *(row for row in law["checks"] if row["reading"] in _READINGS)]:
        name = row.get("law") or f"*{row['reading']}*"
        laws.append([name, _with_ends(row["position_widths"], 3), _with_ends(row["rotation_deg"])])
    driving = figures["driving"]
    windows = {"0.5_s": "0.5 s, mm", "2_s": "2 s, mm", "10_s": "10 s, mm"}
    drives = [["model", *windows.values(), "mm a metre", "degrees a turn"]]
    for row in driving["models"]:
        of_model = row["windows"]
        cells = [_with_ends(of_model[window]["position_mm"]) for window in windows]
        drives.append(
            [
                row["model"].replace(" kinematics", "").replace(" and lever fitted", ""),
                *cells,
                _with_ends(of_model["2_s"]["position_share"], 1, 1e3),
                _with_ends(of_model["2_s"]["heading_share"], 1, 360.0),
            ]
        )
    effective = driving["effective"]
    names = [row["drive"].split(".")[0] for row in effective["recording"]]
    radii = [["effective", *names]]
    for of, key, words, digits, factor in (
        ("recording", "forward_m", "radius forward, mm", 1, 1e3),
        ("recording", "turning", "radius over lever", 3, 1.0),
        ("recording", "sideways_over_forward", "sideways over forward", 3, 1.0),
        ("wheels", "sideways_over_forward", "`wheels`", 3, 1.0),
        ("rollers", "sideways_over_forward", "`rollers`", 3, 1.0),
    ):
        radii.append([words, *(_with_ends(row[key], digits, factor) for row in effective[of])])
    return {
        "reality_laws": table(*laws),
        "reality_drives": table(*drives),
        "reality_radii": table(*radii),
        "reality_fitted": _fitted_table(law, driving),
    }


def _fitted_table(law: dict[str, Any], driving: dict[str, Any]) -> str:
    """Return what was fitted to real tosses and drives beside what is declared or assumed."""
    measured = law["laws"][1]
    rows = [["figure", "before", "fitted"]]
    for name, words in (
        ("ground_friction", "friction of cube and board"),
        ("damping_ratio", "damping ratio"),
        ("time_constant_s", "time constant, s"),
    ):
        rows.append([words, f"{measured[name]:g}", _with_ends(law["fitted"][name], 4)])
    for key, estimate in driving["identified"]["estimates"].items():
        if key.startswith("mounting.marker"):
            continue
        fitted = f"{estimate['value']:.4f}"
        if estimate["range"] is not None:
            fitted = "{:.2f}-{:.2f} fit as well".format(*estimate["range"])
        elif estimate["half_width_95"] is not None:
            fitted += f" ± {estimate['half_width_95']:.4f}"
        rows.append([estimate["words"], f"{estimate['nominal']:g}", fitted])
    return table(*rows)


def _with_ends(estimate: dict[str, Any], digits: int = 1, factor: float = 1.0) -> str:
    """Return a value with the ends of its interval."""
    if estimate["value"] is None:
        return ""
    text = f"{factor * estimate['value']:.{digits}f}"
    if estimate["low"] is None:
        return text
    ends = (f"{factor * estimate[end]:.{digits}f}" for end in ("low", "high"))
    return f"{text} ({'-'.join(ends)})"


def _demo(figures: dict[str, Any]) -> str:
    return (
        f"{figures['agree']}/{figures['total']} actions; cars {figures['max_car_error_mm']:.2f} mm and "
        f"{figures['max_car_heading_error_mrad']:.2f} mrad, objects set down {figures['max_placed_error_mm']:.2f} mm, "
        f"bystanders {figures['max_bystander_displacement_mm']:.2f} mm; {figures['simulated_s']:.1f} s simulated"
    )


def _validation(figures: dict[str, Any]) -> str:
    """Return how many actions and runs were as predicted, with the interval of runs: actions of one fail together."""
    validation = figures["validation"]
    actions = validation["all"]["actions"]
    runs = validation["all"]["runs"]
    error_mm = validation["precision"]["car_error_mm"]["p99"]
    shares = f"{_counts(actions)} actions, {_counts(runs)} runs ({_interval(runs)})"
    return f"{shares}; cars {error_mm:.2f} mm{_paired(figures)}"


def _paired(figures: dict[str, Any]) -> str:
    """Return how a run compares with the one that it was paired with, in the row above."""
    if not figures["paired"]:
        return ""
    pairs = figures["paired"]["trials"]
    return f"; both {pairs['both']}/{pairs['pairs']} trials"


def _orders(figures: dict[str, Any]) -> str:
    compared = figures["concurrent_by"] | {
        "predicted": figures["executed_by_predicted"]["concurrent"]
    }
    said = [
        f"{one['value']:.2f} ({one['low']:.2f}-{one['high']:.2f}) times {name}"
        for name, one in compared.items()
    ]
    planned = figures["as_predicted"]["ticks"]["trials"]
    return (
        f"{figures['compared']} of {planned} plans as predicted in all orders; makespans, asynchronously: "
        f"{', '.join(said)}"
    )


def trained_table() -> str:
    """Return the success of policies trained in ticks and asynchronously, over seeds of training, in each mode."""
    found: dict[tuple[str, str], dict[str, list[dict[str, Any]]]] = {}
    for path in sorted(RUNS.glob("execution_trained_*.json")):
        for policy, by_mode in _read(path)["figures"]["modes"].items():
            task, how, _ = policy.rsplit("-", 2)
            for mode, one in by_mode.items():
                found.setdefault((task, how), {}).setdefault(mode, []).append(one)
    modes = [*dict.fromkeys(mode for by_mode in found.values() for mode in by_mode)]
    # In ticks physics does under mild randomization what the grid does.
    modes.remove("grid synchronous")
    starts = found[min(found)][modes[0]][0]["success"]["trials"]

    def cell(shares: list[dict[str, Any]]) -> str:
        """Return the mean over seeds, or, of policies that play few episodes, how many of how many succeed."""
        if all(share["trials"] == starts for share in shares):
            return _over_seeds([share["rate"] for share in shares]) if shares else ""
        return f"{sum(share['successes'] for share in shares)}/{sum(share['trials'] for share in shares)}"

    rows = []
    for (task, how), by_mode in sorted(found.items()):
        shares = [cell([one["success"] for one in by_mode.get(mode, ())]) for mode in modes]
        rows.append((f"`{task}`", how, *shares))
    head = ("task", "trained", *modes)
    return f"{starts} starts a policy, the same for all.\n\n" + table(head, *rows)


def _over_seeds(rates: list[float]) -> str:
    """Return the mean with its t interval, cut off at 0 and 1."""
    estimate = mean(rates)
    if len(set(rates)) < 2:
        return f"{estimate:.2f}"
    low, high = ttest_1samp(rates, 0.0).confidence_interval(0.95)
    return f"{estimate:.2f} ({max(0.0, low):.2f}-{min(1.0, high):.2f})"


def _builders(figures: dict[str, Any]) -> str:
    built = {name: found["physics"]["all"]["built"] for name, found in figures["builders"].items()}
    return "; ".join(f"{name} built {_counts(one)}" for name, one in built.items())


def builders_table() -> str:
    """Return how much of the designs the baselines build that answer in words."""
    designs = ("one level", "with a ramp", "two levels", "all")
    return named(
        {
            "builder": f"`{builder}`",
            "on": backend,
            **{name: _counts(parts[name]["built"]) for name in designs},
            "95 %": _limits(parts["all"]["built"], 2),
            "in place": f"{100 * parts['all']['in_place']['value']:.0f} %",
            "as predicted": _counts(parts["all"]["as_predicted"]),
            "forbidden": parts["all"]["forbidden"],
        }
        for builder, of in _read(RUNS / "builders.json")["figures"]["builders"].items()
        for backend, parts in of.items()
    )


def workshop_table(stored: dict[str, Any]) -> str:
    """Return how many actions and runs of each task were as predicted on a workshop floor."""
    rows = []
    for task, counts in stored["tasks"].items():
        share = counts["good"] / counts["actions"]
        least = lower_bound(counts["good_runs"], counts["runs"])
        rows.append(
            (
                f"`{task}`",
                f"{counts['good']}/{counts['actions']}",
                f"{100 * share:.1f} %",
                f"{counts['good_runs']}/{counts['runs']}",
                f"{100 * least:.0f} %",
            )
        )
    return table(("task", "actions as predicted", "share", "runs", "at least (95 %)"), *rows)


def _limits(share: dict[str, Any], digits: int = 3) -> str:
    low, high = bounds(share["successes"], share["trials"])
    return f"{low:.{digits}f}-{high:.{digits}f}"


def _interval(share: dict[str, Any]) -> str:
    low, high = bounds(share["successes"], share["trials"])
    return f"{100 * low:.1f}-{100 * high:.1f} %"


def _audit(figures: dict[str, Any]) -> str:
    audit, actions = figures["audit"], figures["validation"]["all"]["actions"]
    sound, unsound, works, forbidden = (
        audit["verdicts"][name]
        for name in ("sound", "unsound", "conservative", "rightly forbidden")
    )
    rows = f"{unsound} of {sound + unsound} legal rows are unsound"
    if not audit["provisional"]:
        return f"{rows}; {_counts(actions)} actions as predicted{_paired(figures)}"
    tried = f"{works} forbidden ones work, {forbidden} do not"
    return f"{rows}; {tried}; {actions['trials']} actions, mostly one trial a row: provisional"


def _conformance(figures: dict[str, Any]) -> str:
    checks = f"{figures['total_checks']:,} checks, {figures['total_mismatches']} mismatches"
    return f"{figures['records']:,} records, {checks}"


SAYINGS: Final[dict[str, Callable[[dict[str, Any]], str]]] = {
    "total_checks": _conformance,
    "margins": lambda figures: f"margins of {len(figures['margins']['weakest'])} actions, below",
    "audit": _audit,
    "validation": _validation,
    "agree": _demo,
    "concurrent_by": _orders,
    "modes": lambda figures: f"{len(figures['modes'])} policies, below",
    "builders": _builders,
}
"""What is said of a report, by the first key that it has."""


def margins_table() -> str:
    """Return the margin of the weakest situation of each action."""
    weakest = _read(RUNS / "margins.json")["figures"]["margins"]["weakest"]
    imperfections = [*dict.fromkeys(name for found in weakest.values() for name in found)]
    units: dict[str, str] = {}
    rows = []
    for action, found in weakest.items():
        cells = [action]
        for name in imperfections:
            text = found.get(name, {}).get("text", "")
            *value, unit = text.split(" ")
            if unit in ("ms", "mm", "mrad"):
                units[name] = unit
                text = " ".join(value)
            cells.append(text.replace("no effect", "-"))
        rows.append(cells)
    heads = [f"{name}, {units[name]}" if name in units else name for name in imperfections]
    return table(("action", *heads), *rows)


def readme_tables() -> dict[str, str]:
    """Return the tables of README, by the names of their places."""
    return {"results": headline_results(), "reality": compared_with_reality()}


HEADLINES: Final = {
    "six shipped plans, masses, friction, motors and sensors drawn (`mild`)": "{} runs as predicted",
    "six shipped plans, twice as much drawn (`strong`)": "{} runs as predicted, {} actions",
    "six tasks on a tiled workshop floor": "{} runs as predicted, {} actions",
    "shipped policy `random_strip` in physics, held-out starts": "{} built",
    "four shipped policies, asynchronously, on that floor behind a network": "{} built with recovery, {} without",
    "kinds of situations that rules allow and that fail in physics": "CraftEnv's rules {}, craftsim's {}",
}
"""The rows of README's table that are drawn, and what their counts say."""
NETWORK_AGAIN: Final = ("network_recovers_again", "network_waits_again")


def headline_results() -> str:
    """Return seven figures with their certificates or intervals, and six of them with another seed."""
    rows = []
    first, again = headline_counts(NETWORK), headline_counts(NETWORK_AGAIN, "_again")
    for row, (what, text) in enumerate(HEADLINES.items()):
        counts, interval = first[row]
        other_counts, other_interval = again[row]
        rows.append(
            (what, text.format(*counts), interval, f"{', '.join(other_counts)}; {other_interval}")
        )
    on_grid = _read(RUNS / "speed_env.json")["rates"]["simple_two_story"][
        "vector, 1000 worlds, helper no"
    ]
    in_physics = _read(RUNS / "speed_physics.json")["rates"]["simple_two_story"]["wheels"]
    speeds = f"{on_grid['steps_a_second']:,.0f} on the grid, {in_physics['steps_a_second']:.0f} in physics"
    return table(
        ("what", "result", "95 % interval or certificate", "with another seed"),
        *rows,
        ("joint steps of two cars a CPU second", speeds, "a single core", ""),
    )


def headline_counts(network: Iterable[str], suffix: str = "") -> list[tuple[tuple[str, ...], str]]:
    """Return the counts of each row of HEADLINES with their interval or certificate.

    They are those of the measurements whose names end with the suffix, and of those behind a network that are named.
    An interval is of runs, as actions of one run fail together.
    """
    strong, workshop, published, physical, certified = (
        _read(RUNS / f"{name}{suffix}.json")["figures"]
        for name in (
            "strong",
            "workshop_floor",
            "audit_published",
            "audit_physical",
            "certificates",
        )
    )
    drawn = strong["validation"]["all"]
    floor = workshop["validation"]["all"]
    certificates = certified["certificates"]
    n_yes = sum(certificate["decision"] == "yes" for certificate in certificates)
    share = 100 * certificates[0]["required_rate"]
    successes = sum(certificate["successes"] for certificate in certificates)
    runs = sum(certificate["trials"] for certificate in certificates)
    (shipped,) = _policy_rows([f"physics_random_strip{suffix}"])
    built = vars(Proportion.of(int(shipped[3]), int(shipped[1])))
    behind = [_read(RUNS / f"{name}.json")["figures"] for name in network]
    recovered = vars(network_causes.built_of(behind, recovers=True))
    alone = vars(network_causes.built_of(behind, recovers=False))
    certificate = f"{n_yes} of {len(certificates)} certified: at least {share:.0f} %"
    return [
        ((f"{successes:,}/{runs:,}",), certificate),
        ((_counts(drawn["runs"]), _counts(drawn["actions"])), _interval(drawn["runs"])),
        ((_counts(floor["runs"]), _counts(floor["actions"])), _interval(floor["runs"])),
        ((_counts(built),), _interval(built)),
        ((_counts(recovered), _counts(alone)), f"{_interval(recovered)}, {_interval(alone)}"),
        ((_unsound(published), _unsound(physical)), "one trial each"),
    ]


def _unsound(figures: dict[str, Any]) -> str:
    verdicts = figures["audit"]["verdicts"]
    return f"{verdicts['unsound']} of {verdicts['sound'] + verdicts['unsound']}"


def compared_with_reality() -> str:
    """Return what was compared with recordings of CraftEnv and of real motion."""
    conformance = _read(RUNS / "conformance.json")["figures"]
    reality = _read(RUNS / "reality.json")["figures"]
    (law,) = reality["contact_law"]
    widths = {row["law"]: _with_ends(row["position_widths"], 3) for row in law["laws"]}
    ahead = {}
    for row in reality["driving"]["models"]:
        ahead[row["model"]] = _with_ends(row["windows"]["10_s"]["position_mm"])
    ideal = "ideal kinematics, radius and lever fitted"
    return table(
        ("recording", "craftsim", "best model fitted to it"),
        (
            "CraftEnv's program, with the rules `published`",
            f"{conformance['total_mismatches']} mismatches in {conformance['total_checks']:,} checks",
            "",
        ),
        (
            "tosses of a real cube: position, in widths of the cube",
            f"{widths['craftsim, friction 0.18 as measured']}, friction as measured",
            widths["fitted"],
        ),
        (
            "a real robot on mecanum wheels: position 10 s ahead, mm",
            f"{ahead['wheels, identified']}, parameters identified",
            ahead[ideal],
        ),
        ("CraftEnv's cars, blocks, boards and slopes", "not compared", ""),
    )


def _counts(share: dict[str, Any]) -> str:
    return f"{share['successes']:,}/{share['trials']:,}"


def joint_steps_table(stored: dict[str, Any]) -> str:
    """Return what joint steps in physics cost, with MuJoCo's share of it, and what they cost in a large world."""
    rows = []
    for row in stored["rows"]:
        rows.append(
            (
                row["drive"],
                str(row["cars"]),
                str(row["blocks"]),
                f"{row['joint_step_ms']:.1f}",
                f"{row['share_of_mj_step']:.2f}",
                f"{row['times_without_blocks']:.2f}",
            )
        )
    heads = (
        "drive",
        "cars",
        "sleeping blocks",
        "joint step, ms",
        "`mj_step` alone",
        "times without blocks",
    )
    large = stored["large"]
    length, width, height = large["size"]
    sentence = (
        f"In {length} x {width} x {height} cells with {large['cars']} cars and {large['blocks']} blocks, compiling and "
        f"coming to rest take {large['start_s']:.2f} s, and a joint step of masked random play takes "
        f"{large['joint_step_s']:.2f} s (at most {large['longest_joint_step_s']:.2f} s)."
    )
    workers = stored["two_workers"]
    sentence += (
        f" {workers['worlds']} worlds of two cars play {workers['send_and_recv']:.2f} times as fast in two worker "
        f"processes as in one at their own pace, {workers['step']:.2f} times where each step waits for the slowest."
    )
    return f"{table(heads, *rows)}\n{sentence}\n"


def rates_table(report: dict[str, Any]) -> str:
    """Return the rates of ``benchmarks/reference.py`` beside those that CraftEnv is estimated to have."""
    rows = [
        (
            task,
            case.replace(", helper no", "").replace("helper yes", "helper"),
            *(
                _three_digits(rate[key])
                for key in ("steps_a_second", "reference_a_second", "times")
            ),
        )
        for task, cases in sorted(report["rates"].items(), reverse=True)
        for case, rate in cases.items()
    ]
    return table(("task", "case", "steps a CPU second", "CraftEnv, estimated", "ratio"), *rows)


def _three_digits(value: float) -> str:
    return f"{value:,.{0 if value >= 100 else 1 if value >= 10 else 2}f}"


def campaign_table(campaign: dict[str, Any], audit: dict[str, Any]) -> str:
    """Return what a campaign took on a cluster and in one process, and what a million trials of an audit would take."""
    trial_s = audit["cpu_s"] / audit["figures"]["validation"]["all"]["runs"]["trials"]
    rows = []
    for engine in ("ray", "local"):
        run = campaign[engine]
        million_h = 1e6 * (trial_s + run["overhead_s"] - campaign["local"]["overhead_s"]) / 3600
        rows.append(
            {
                "engine": engine,
                "trials": f"{campaign['trials']:,}",
                "lost": campaign["trials"] - campaign["distinct"],
                "CPU of a trial, ms": f"{1e3 * campaign['trial_s']:.1f}",
                "overhead, ms": f"{1e3 * run['overhead_s']:.1f}",
                "memory, MB": "{:.0f}/{:.0f}".format(*run["campaign_mb"]),
                "million audit trials, CPU h": f"{million_h:.0f}",
                f"on {PROCESSORS} processors": f"{60 * million_h / PROCESSORS:.0f} min",
            }
        )
    trained = campaign["training"]
    both = [
        {
            "training": engine,
            "steps": f"{trained['steps']:,}",
            "CPU time": f"{trained[engine]['cpu_s']:.0f} s",
        }
        for engine in ("ray", "local")
    ]
    return f"{named(rows)}\n{named(both)}"


def large_table(report: dict[str, Any]) -> str:
    """Return what plans for the large tasks and MAPPO on them take, and what hundreds of processors would."""
    noted: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for one in report["benchmarks"]:
        what = one["params"].get("what") or one["name"].split("[")[0].removeprefix("test_")
        noted.setdefault(one["params"]["name"], {}).setdefault(what, []).append(one["extra_info"])
    rows = []
    for name, cases in noted.items():
        if "random_play" not in cases:
            continue
        (played,), plans = cases["random_play"], cases.get("a_plan", [])
        rollout, update = (cases[part][0]["steps_per_s"] for part in ("rollout", "update"))
        first, ticks = (sorted(plan[key] for plan in plans) for key in ("first_s", "ticks"))
        waits = f"{len(plans)}: {median(first):.1f} s, {first[-1]:.1f} s" if plans else ""
        rollout_s, update_s = LARGE_STEPS / rollout, LARGE_STEPS / update
        rows.append(
            {
                "task": f"`{name}`",
                "plans: first one after (median, longest)": waits,
                "ticks of the best of 8 (median, longest)": f"{median(ticks):.0f}, {ticks[-1]}"
                if plans
                else "",
                "return of random play": f"{played['mean_return']:.2f}",
                "random play": _three_digits(played["steps_per_s"]),
                "MAPPO's rollout": _three_digits(rollout),
                "MAPPO's update": _three_digits(update),
                "1 processor": f"{(rollout_s + update_s) / 3600:.1f} h",
                f"{PROCESSORS} for rollouts": f"{(rollout_s / PROCESSORS + update_s) / 3600:.1f} h",
                f"{PROCESSORS} for both": f"{(rollout_s + update_s) / PROCESSORS / 60:.1f} min",
            }
        )
    return named(rows)


def structures_table(stored: dict[str, Any]) -> str:
    """Return what scripts/structures.py found of each set: planned, and built in physics on a drive."""

    def share(one: dict[str, Any] | None) -> str:
        return (
            ""
            if one is None
            else _counts(one) + (f" ({_limits(one)})" if one["trials"] > 1 else "")
        )

    def spread(values: list[float]) -> str:
        return "-".join(
            f"{value:.1f}" if value < 10 else f"{value:.0f}" for value in dict.fromkeys(values)
        )

    return named(
        {
            "structures": f"{name}, {one['cars']} cars",
            "blocks": spread(one["blocks"]),
            "drive": drive,
            "planned": share(one["planned"]),
            "CPU s": spread(one["plan_s"]),
            "built": share(one.get("built")),
            "actions as predicted": share(one.get("as_predicted")),
            "makespan, s": spread(one["executed_s"] if "built" in one else one["makespan_s"]),
            "blocks an hour": f"{one['blocks_per_hour']:.0f}" if one["blocks_per_hour"] else "",
            "1e6 mm³ a minute per car": f"{one['mm3_per_minute_per_car'] / 1e6:.1f}"
            if one["blocks_per_hour"]
            else "",
        }
        for name, stages in stored.items()
        for drive, one in stages.items()
        if drive != "plan" or len(stages) == 1 or one["planned"]["trials"] > 1
    )


def paper_tables() -> dict[str, str]:
    """Return the tables of CraftEnv's paper: cells, verdicts, its own rule, and held-out seeds."""
    runs = paper_table.read_runs(PAPER_RUNS)
    held_out = json.loads(PAPER_HELD_OUT.read_text(encoding="utf-8"))
    return {
        "paper": table(*paper_table.table_rows(runs, RELEASED_STEPS)),
        "paper_verdicts": table(*paper_table.verdict_rows(runs, RELEASED_STEPS)),
        "paper_explored": table(*paper_table.explored_rows(_read(TRAINING / "paper_ippo.json"))),
        "paper_rule": table(*paper_table.rule_rows()),
        "paper_held_out": table(*paper_table.held_out_rows(held_out)),
    }


def studies_table() -> str:
    """Return success over seeds of the studies of one algorithm, with CPU times of a run."""
    rows = []
    for name in STUDIES:
        report = _read(TRAINING / f"{name}.json")
        cpu = {
            key: seconds for key, seconds in report["wall"]["cpu_s"].items() if seconds is not None
        }
        for row in report["figures"]["rows"]:
            iqm, low, high = row["success"]["iqm"]
            times = [
                seconds for key, seconds in cpu.items() if key.startswith(f"{row['task']}/")
            ] or [*cpu.values()]
            rows.append(
                {
                    "study": f"`{name}`",
                    "task": row["played"],
                    "IQM of success (95 %)": f"{iqm:.3f} ({low:.3f}-{high:.3f})",
                    "steps, k": f"{row['median_steps'] / 1000:,.0f}",
                    "CPU minutes a run": f"{min(times) / 60:.1f}-{max(times) / 60:.1f}",
                }
            )
    return named(rows)


def evaluations_table() -> str:
    """Return what the policy for designs comes to elsewhere."""
    rows = []
    for name in ELSEWHERE:
        for row in _read(RUNS / f"{name}.json")["figures"]["evaluations"]:
            found = row["success"]
            success, cars = (
                f"{found['rate']:.3f} ({_limits(found)})",
                _word(name, "--cars") or "own",
            )
            rows.append((row["task"], cars, row["acting"], success, row["starts"]["distinct"]))
    return table(("task", "cars", "actions", "success (95 %)", "distinct starts"), *rows)


def _word(name: str, option: str) -> str:
    """Return the value of an option in the command of a result; empty without the option."""
    words = MEASURED[name].split()
    return words[words.index(option) + 1] if option in words else ""


def _policy_rows(names: Iterable[str]) -> list[tuple[str, ...]]:
    rows = []
    for name in names:
        stored = _read(RUNS / f"{name}.json")
        for policy in stored["policies"]:
            built = [
                str(round(policy[where] * policy["episodes"])) for where in ("grid", "physics")
            ]
            drawn, episodes = _word(name, "--randomize") or "strong", str(policy["episodes"])
            title = Path(policy["policy"]).name
            if drawn == "workshop_floor":
                title += f", {drawn}"
            rows.append(
                (
                    title,
                    episodes,
                    *built,
                    _counts(policy["actions"]),
                    stored["revision"],
                )
            )
    return rows


def policies_table(names: Iterable[str]) -> str:
    """Return how policies do in physics."""
    head = (
        "policy",
        "episodes",
        "built by the rules",
        "built in physics",
        "actions as predicted",
        "revision",
    )
    return table(head, *_policy_rows(names))


def network_tables() -> dict[str, str]:
    """Return the tables of policies that play asynchronously on a floor and behind a network."""
    stored = [_read(RUNS / f"{name}.json")["figures"] for name in NETWORK]
    trained = []
    for path in (RUNS / f"{name}.json" for name in OF_POLICIES):
        if path.exists():
            trained.append(_read(path)["figures"])
    return {
        "network_causes": table(*network_causes.causes_rows(stored)),
        "network_recovery": table(*network_causes.recovery_rows([*stored, *trained])),
        "network_plans": table(
            *network_plans.table_rows(_read(RUNS / "network_plans.json")["figures"])
        ),
    }


def shipped_table() -> str:
    """Return the policies that come with craftsim, and how they play held-out starts."""
    rows = []
    for path in sorted((ROOT / "craftsim" / "data" / "policies").iterdir()):
        name = path.name.split(".")[0]
        if path.suffix == ".safetensors":
            built = "its one start"
            if f"shipped_{name}" in ON_GRID:
                (found,) = _read(RUNS / f"shipped_{name}.json")["figures"]["evaluations"]
                built = f"{found['success']['rate']:.3f} ({_limits(found['success'])})"
            rows.append((f"`{name}`", built, f"{path.stat().st_size / 1e6:.1f}"))
    return table(("policy", "built of held-out starts (95 %)", "MB"), *rows)


def plot() -> None:
    """Draw what the page shows of each study."""
    for name, shown in STUDIES.items():
        if not shown:
            continue
        folder = TRAINING / name
        folder.mkdir(exist_ok=True)
        for path in plot_results(
            folder, read_study(name), _read(TRAINING / f"{name}.json")["figures"]
        ):
            if path.name not in shown:
                path.unlink()
    paper_table.plot(
        paper_table.read_runs(PAPER_RUNS), [*RELEASED_STEPS], TRAINING / "paper_curves.png"
    )
    curves = json.loads((TRAINING / "execution_curves.json").read_text(encoding="utf-8"))
    plot_curves(curves, "trained", TRAINING / "execution_curves.png")
    plot_agreement(RESULTS / "agreement.png")


_PLOTTED: Final = {
    "strong": "six tasks, strong",
    "strong_rollers": "six tasks, strong, on rollers",
    "lab_floor": "six tasks, laboratory floor",
    "lab_floor_rollers": "six tasks, laboratory floor, on rollers",
    "workshop_floor": "six tasks, workshop floor",
    "random": "random play, mild",
    "random_rollers": "random play, mild, on rollers",
    "play": "random play of 12 cars, no randomization",
    "large_tower_4_mild": "tower by 4 cars, mild, replanned",
    "large_tower_8_mild": "tower by 8 cars, mild, replanned",
}
"""Runs of :func:`plot_agreement`, with their names there."""


def plot_agreement(path: Path) -> None:
    """Draw the share of runs that went as predicted, with its interval, for each validation in physics."""
    figure = Figure((8.4, 3.6), layout="constrained")
    axes = figure.subplots()
    for row, name in enumerate(_PLOTTED):
        share = _read(RUNS / f"{name}.json")["figures"]["validation"]["all"]["runs"]
        low, high = bounds(share["successes"], share["trials"])
        axes.plot(
            (100 * low, 100 * high), (row, row), color="C0", lw=4, alpha=0.4, solid_capstyle="butt"
        )
        axes.plot(100 * share["successes"] / share["trials"], row, "o", color="C0")
    axes.set_yticks(range(len(_PLOTTED)), [*_PLOTTED.values()])
    axes.invert_yaxis()
    axes.grid(axis="x", alpha=0.4)
    axes.set_xlabel("runs as predicted, %, with 95 % intervals")
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    figure.savefig(path, dpi=110)


def plot_curves(runs: list[dict[str, Any]], key: str, path: Path) -> None:
    """Draw learning curves, the mean over seeds, a panel a task and a line for each value of a key.

    A run that has ended counts on with its last evaluation.
    """
    tasks, lines = (sorted({run[name] for run in runs}) for name in ("task", key))
    figure = Figure((3.6 * len(tasks), 3.2), layout="constrained")
    panels = figure.subplots(1, len(tasks), sharey=True, squeeze=False)[0]
    for panel, task in zip(panels, tasks, strict=True):
        for number, line in enumerate(lines):
            curves = [
                np.array(run["curve"]).T for run in runs if (run["task"], run[key]) == (task, line)
            ]
            if curves:
                at = np.unique(np.concatenate([steps for steps, _ in curves]))
                at = at[at >= max(steps[0] for steps, _ in curves)]
                success = np.mean([np.interp(at, *curve) for curve in curves], axis=0)
                panel.plot(at / 1000, success, color=f"C{number}", label=line)
        panel.set_title(task)
        panel.set_xlabel("1000 steps")
    panels[0].set_ylabel("success in evaluations")
    max(panels, key=lambda panel: len(panel.lines)).legend(fontsize="small")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()

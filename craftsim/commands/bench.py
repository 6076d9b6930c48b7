"""Measure how fast rules, environments, physics, workers and films are, and how long actions take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final, Literal

import tyro

from craftsim.discrete.rules import RuleSet
from craftsim.mjcf.parameters import Drive
from craftsim.storage.folders import owning
from craftsim.storage.limits import BATCH, BENCH_RUNS, BENCH_S, BENCH_TICKS, SEED

TASKS: Final = ("simple_two_story", "complex_two_story")
"""Those with two and with four cars."""

DEPTH: Final = 20
"""The search depth of CraftEnv's published training settings, the costlier of the two."""


@owning
def bench(
    what: tyro.conf.Positional[
        Literal[
            "rules", "env", "physics", "steps", "trials", "workers", "render", "plans", "train", "durations"
        ]
    ],
    rules: RuleSet = "published",
    worlds: Annotated[int, BATCH] = 1000,
    seconds: Annotated[float, BENCH_S] = 2.0,
    memory_worlds: Annotated[int, BATCH] = 10_000,
    episode: Annotated[int, BENCH_TICKS] = 20,
    runs: Annotated[int, BENCH_RUNS] = 40,
    contexts: Annotated[int, BENCH_RUNS] = 60,
    drive: Drive = "rollers",
    seed: Annotated[int, SEED] = 0,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
) -> int:
    """Measure how fast the grid rules, the environments and worker processes are, or how long actions take.

    rules: steps a CPU second, and the memory of many worlds. A step is one tick of one world, with reward,
    end of episode and reset, and the masks of all cars for the next one; "helper" adds the helper's search to masks
    and moves, and the global observation of every car. Drawing actions from the masks is part of the time.
    A fixed calibration work in plain Python is timed in turns with it: "per unit" is steps in the time of one unit of
    that work, "CraftEnv" what CraftEnv would do here and now by an estimate from the calibration, "times" the ratio.

    env: the same through PettingZoo and in batches; and in physics, the CPU time of a step against that of MuJoCo's
    steps alone under the same commands.

    physics: joint steps a CPU second against CraftEnv's; with growing numbers of cars that drive and of blocks that
    rest against MuJoCo's steps alone under the same commands ("x bare"; "us" is what one of these takes, "units"
    what a joint step costs in units of the calibration work); resets; many worlds with one worker process and with two.

    steps: how verdicts, errors, durations and forces depend on the physics step, over contexts of the audit.

    trials: the CPU time of a trial of the audit, stage by stage, over contexts taken evenly from all that it tries.

    workers: two worker processes against one, building a task again and again, their start included; what a single
    run costs in a campaign, apart from such starts; and what processes and actors of Ray cost beyond their work, on a
    cluster of this machine alone that is started for it, where Ray is installed.

    render: frames a second of a film with its captions, encoded, beside a bare loop over MuJoCo's renderer; two
    processes against one; what recording a run adds to its CPU time.

    plans: the makespan of the planner's plans for the paper's tasks beside that of the shipped ones; how many random
    designs it plans; and what four cars gain over one.

    train: steps of IPPO a CPU second on one thread, rollouts and updates apart, beside the grid alone.

    durations: how long actions take in physics, as craftsim/data/durations.yaml holds it for the grid environments.

    Args:
        what: what to measure.
        rules: the rule set to run; rules only.
        worlds: how many worlds a batch has.
        seconds: how long each measurement on the grid runs, each play of a task in physics, and each search for a plan.
        memory_worlds: how many worlds to make for the memory figure; rules only.
        episode: ticks of the episode that is timed in physics, 2 or more; env only.
        runs: how often the task is built, how many random designs are planned, or rollouts learnt from;
            workers, plans and train only.
        contexts: how many contexts of the audit are tried; steps and trials only.
        drive: of the cars; steps and trials only.
        seed: decides starts, actions and orders.
        out: folder for report.json; for the tables in rules.md, env.md or physics.md, and physics.png, too.
    """
    from craftsim.commands.terminal import Terminal
    from craftsim.report import write_report

    console = Terminal(highlight=False)
    figures: dict[str, Any] = {}
    wall: dict[str, Any] = {}
    config: dict[str, Any] = {"what": what}
    match what:
        case "rules":
            from craftsim.commands.bench_rules import bench_rules

            config |= {"rules": rules, "worlds": worlds, "depth": DEPTH}
            figures, wall = bench_rules(
                console, TASKS, DEPTH, rules, worlds, seconds, memory_worlds, seed, out
            )
        case "env":
            from craftsim.commands.bench_env import bench_env

            config |= {"worlds": worlds, "depth": DEPTH, "episode": episode}
            wall = bench_env(console, TASKS, DEPTH, worlds, seconds, episode, seed, out)
        case "physics":
            from craftsim.commands.bench_physics import bench_physics

            config |= {"seconds": seconds}
            wall = bench_physics(console, TASKS, seconds, seed, out)
        case "steps":
            from craftsim.commands.bench_steps import bench_steps

            config |= {"contexts": contexts, "drive": drive}
            figures = bench_steps(console, drive, contexts, seed)
        case "trials":
            from craftsim.commands.bench_trials import bench_trials

            config |= {"contexts": contexts, "drive": drive}
            wall = bench_trials(console, drive, contexts, seed)
        case "workers":
            from craftsim.commands.bench_workers import bench_workers

            config |= {"runs": runs}
            wall = bench_workers(console, TASKS[0], runs, seed)
        case "render":
            from craftsim.commands.bench_render import bench_render

            wall = bench_render(console, seed, out)
        case "plans":
            from craftsim.commands.bench_plans import bench_plans

            config |= {"runs": runs, "seconds": seconds}
            wall = bench_plans(console, seconds, runs, seed, out)
        case "train":
            from craftsim.commands.bench_train import bench_train

            config |= {"runs": runs}
            wall = bench_train(console, runs, seed, out)
        case "durations":
            import yaml

            from craftsim.commands.bench_durations import measure_durations

            figures = measure_durations()
            console.print(yaml.safe_dump(figures, sort_keys=False), end="")
    if out is not None:
        write_report(out, figures, command="bench", seed=seed, config=config, wall=wall)
    return 0

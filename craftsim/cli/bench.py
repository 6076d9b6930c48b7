"""Measure how fast the rules, the environments and the physics are here, beside an estimate of CraftEnv's speed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from craftsim.choices import RuleSet
from craftsim.cli.options import OptionalDir
from craftsim.options import number
from craftsim.storage.folders import output_directory, owning
from craftsim.storage.limits import BATCH, BENCH_S, DESIGNS, SEED, WORKERS
from craftsim.storage.writing import write_whole

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from craftsim.envs.parallel import ParallelConstruction

TASKS: Final = ("simple_two_story", "complex_two_story")
"""Those with two and with four cars."""
DEPTH: Final = 20
"""The search depth of CraftEnv's published training settings, the costlier of the two."""

Step = Callable[[], None]
Case = tuple[str, int, bool, Step]
"""What is timed: its name, steps a call, whether CraftEnv's helper counts in the estimate, and the call."""


@owning
def bench(
    what: Literal["rules", "env", "physics", "execution"],
    *,
    rules: RuleSet = "published",
    worlds: Annotated[int, number(BATCH)] = 1000,
    seconds: Annotated[float, number(BENCH_S)] = 2.0,
    designs: Annotated[int, number(DESIGNS)] = 0,
    workers: Annotated[int, number(WORKERS)] = 1,
    seed: Annotated[int, number(SEED)] = 0,
    out: OptionalDir = None,
) -> int:
    """Measure how fast the grid rules, the environments or the physics are on this machine, or how plans are executed.

    Speeds are steps a CPU second of masked random play, resets included; a step is one tick of one world, with the
    masks of all cars for the next one. A calibration in plain Python is timed in turns with each: "CraftEnv" is an
    estimate from it of what CraftEnv would do here and now, "times" the ratio. The repository has more benchmarks:
    `make bench`.

    rules: the rules alone; "helper" adds the action helper's search and the global observation of every car.

    env: the grid through PettingZoo and in batches.

    physics: joint steps through PettingZoo on either drive.

    execution: makespans of plans in physics, of the six tasks and of random designs: one action after the other, tick
    after tick, and each action as early as those that it depends on have ended, beside the predicted makespans. Reduced
    drive, mild randomization, paired starts.

    Args:
        what: what to measure.
        rules: the rule set to run; rules only.
        worlds: how many worlds a batch has; rules and env only.
        seconds: how long each measurement runs.
        designs: how many random designs are planned and built besides the six tasks; execution only.
        workers: processes to share the work; execution only.
        seed: decides starts and actions.
        out: folder for report.json, and for the table in Markdown.
    """
    from craftsim.cli.calibration import COLUMNS, measure
    from craftsim.reports.json_file import document
    from craftsim.reports.report import Column, DataTable, Headline, Report, Section, Tone
    from craftsim.reports.terminal import Terminal

    if what == "execution":
        from craftsim.checking.setup import setup_of
        from craftsim.cli.execution import execution_report

        setup = setup_of("mild", drive="reduced")
        terms = {"what": what, "designs": designs, "setup": setup}
        return execution_report(designs, seed, setup, workers, terms).publish(out, Terminal())
    cases = {
        "rules": lambda task: rule_cases(task, rules, worlds, seed),
        "env": lambda task: grid_cases(task, worlds, seed),
        "physics": lambda task: physics_cases(task, seed),
    }[what]
    rates: dict[str, dict[str, Any]] = {}
    rows = []
    for task in TASKS:
        rates[task] = {}
        for name, n, helper, step in cases(task):
            rate = measure(step, n, seconds, task, helper)
            rates[task][name] = rate.as_dict()
            rows.append((task, name, *rate.cells()))
    columns = (Column("task"), Column("case"), *(Column(name, "number") for name in COLUMNS))
    table = DataTable(columns, rows, f"Steps a CPU second, {what}")
    config = {"what": what, "rules": rules, "worlds": worlds, "seconds": seconds, "depth": DEPTH}
    report = Report(
        "Speed",
        f"{what}, on this machine",
        Headline(
            "Measured", Tone.PLAIN, "CraftEnv's steps are estimated from the calibration, not measured."
        ),
        sections=[Section("speed", "Speed", "In CPU seconds, resets included.", [table], terminal=True)],
        document=document({}, command="bench", seed=seed, config=config, wall={"rates": rates}),
    )
    if out is not None:
        write_whole(output_directory(out) / f"{what}.md", f"{table.as_markdown()}\n")
    return report.publish(out, Terminal())


def rule_cases(task: str, rules: RuleSet, worlds: int, seed: int) -> Iterator[Case]:
    """Yield what is timed of the rules alone."""
    import numpy as np

    from craftsim.discrete.tasks import make_task
    from craftsim.discrete.tasks.episodes import Episodes

    made = make_task(task, reward="published_code")
    for depth, n in ((None, worlds), (DEPTH, worlds), (DEPTH, 1)):
        rng = np.random.default_rng(seed)
        name = f"{'primitive' if depth is None else 'helper'}, {n} world{'s' if n > 1 else ''}"
        yield name, n, depth is not None, _rule_step(Episodes(made, rng, n, rules, depth), rng)


def grid_cases(task: str, worlds: int, seed: int) -> Iterator[Case]:
    """Yield what is timed of the environments on the grid."""
    from craftsim.envs import parallel_env, vector_env

    for depth in (DEPTH, None):
        helper = f"helper {'no' if depth is None else 'yes'}"
        yield f"PettingZoo, {helper}", 1, True, play(parallel_env(task, "grid", helper_depth=depth), seed)
        envs = vector_env(task, worlds, helper_depth=depth)
        yield f"vector, {worlds} worlds, {helper}", worlds, True, play_worlds(envs, seed)


def physics_cases(task: str, seed: int) -> Iterator[Case]:
    """Yield what is timed of the environments in physics."""
    from craftsim.envs import parallel_env
    from craftsim.mjcf.parameters import DRIVES

    for drive in DRIVES:
        yield drive, 1, True, play(parallel_env(task, "physics", drive=drive), seed)


def pick(rng: np.random.Generator, mask: NDArray[Any]) -> NDArray[np.int64]:
    """Return for each car one of its allowed actions, uniformly; 0 where there is none."""
    import numpy as np

    picked: NDArray[np.int64] = (rng.random(mask.shape, dtype=np.float32) * mask).argmax(-1)
    return picked


def _rule_step(episodes: Any, rng: np.random.Generator) -> Step:
    helper = episodes.depth is not None
    masks = [episodes.offered()]

    def step() -> None:
        done = episodes.step(pick(rng, masks[0])).done
        if done.any():
            episodes.reset(done.nonzero()[0])
        masks[0] = episodes.offered()
        if helper:
            episodes.vectors()

    return step


def play(env: ParallelConstruction, seed: int) -> Step:
    """Return a function that takes one step of masked random play, resets included."""
    import numpy as np

    rng = np.random.default_rng(seed)
    observations = env.reset(seed=seed)[0]

    def step() -> None:
        nonlocal observations
        masks = np.stack([seen["action_mask"] for seen in observations.values()])
        actions = dict(zip(observations, pick(rng, masks).tolist(), strict=True))
        observations = env.step(actions)[0] if actions else {}
        if not env.agents:
            observations = env.reset()[0]

    return step


def play_worlds(envs: Any, seed: int) -> Step:
    """Return a function that takes one step of masked random play in all worlds of a vector environment."""
    import numpy as np

    rng = np.random.default_rng(seed)
    observations = envs.reset(seed=seed)[0]

    def step() -> None:
        nonlocal observations
        observations = envs.step(pick(rng, observations["action_mask"]))[0]

    return step

"""This machine: ``craftsim doctor`` and ``bench``."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from importlib.resources import files
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, NamedTuple

from craftsim.cli.options import OptionalDir
from craftsim.cli.progress import working
from craftsim.cli.text import print_safe
from craftsim.discrete.ranges import BATCH
from craftsim.errors import RenderingUnavailable, refused_variables
from craftsim.rendering.offscreen import INSTALL_COMMAND, choose_backend, run_apart
from craftsim.reports.publishing import publish
from craftsim.reports.report import (
    Column,
    DataTable,
    Headline,
    Report,
    Section,
    TableCell,
    Tone,
    Value,
    numbers,
)
from craftsim.storage.extras import install_mujoco, mujoco_release, why_mujoco_refused
from craftsim.storage.folders import output_directory, owning
from craftsim.storage.limits import Range
from craftsim.storage.writing import write_whole
from craftsim.validation.options import RulesName, Seeded, number
from craftsim.workers.modules import PLUG_INS, plug_ins
from craftsim.workers.pool import usable_processors

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from craftsim.envs.parallel import ParallelConstruction


TASKS: Final = ("simple_two_story", "complex_two_story")
"""Tasks with two and with four cars."""
_DURATION_S: Final = Range(0.001, 3600)
WORLDS: Final = 1000
"""Default size of a batch."""
DEPTH: Final = 20
"""The search depth of CraftEnv's published training settings, the costlier of the two."""

_Case = tuple[str, int, Iterator[None]]
"""A benchmark: name, worlds, and the play of which a step is timed."""


@owning
def bench(
    subject: Literal["rules", "env", "physics"],
    *,
    rules: RulesName = "published",
    worlds: Annotated[int, number(BATCH)] = WORLDS,
    seconds: Annotated[float, number(_DURATION_S)] = 2.0,
    chance: Seeded = Seeded(),  # noqa: B008
    out: OptionalDir = None,
) -> int:
    """Benchmark the rules, the environments or the physics on this machine.

    Speeds are steps per CPU second of masked random play, including resets; a step is one tick of one world, with the
    masks of all cars for the next one. `make bench` runs more benchmarks.

    rules: the rules alone; "helper" adds the action helper's search and the global observation of every car.

    env: the grid through PettingZoo and in batches.

    physics: joint steps through PettingZoo with either drive.

    Args:
        subject: what to measure.
        rules: rule set; for rules only.
        worlds: size of a batch.
        seconds: duration of each measurement.
        out: folder for report.json and the table in Markdown.
    """
    from craftsim.reports.json_file import document

    seed = chance.seed
    rates: dict[str, dict[str, float]] = {task: {} for task in TASKS}
    rows = []
    for task in TASKS:
        for name, n, play in cases(subject, task, rules, worlds, seed):
            with working(f"bench {subject}: {task}, {name}"):
                next(play)  # what it compiles does not count
                n_calls, spent_s = repeat(partial(next, play), seconds)
            rates[task][name] = n * n_calls / spent_s
            rows.append((task, name, three_digits(rates[task][name])))
    table = DataTable(
        (Column("task"), *numbers("case", "steps/s")), rows, f"Steps a CPU second, {subject}"
    )
    config = {"what": subject, "rules": rules, "worlds": worlds, "seconds": seconds, "depth": DEPTH}
    if out is not None:
        write_whole(output_directory(out) / f"{subject}.md", f"{table.as_markdown()}\n")
    report = Report(
        "Speed",
        f"{subject}, on this machine",
        Headline("Measured", Tone.PLAIN, "Steps a CPU second."),
        sections=[
            Section("speed", "Speed", "In CPU seconds, resets included.", [table], terminal=True)
        ],
        document=document({}, command="bench", seed=seed, config=config, wall={"rates": rates}),
    )
    return publish(report, out)


def cases(subject: str, task: str, rules: str, worlds: int, seed: int) -> Iterator[_Case]:
    """Yield what is timed of a task: of the rules alone, of environments on the grid, or of those in physics."""
    import numpy as np

    from craftsim.envs import parallel_env, vector_env
    from craftsim.mjcf.drives import DRIVES
    from craftsim.tasks import make_task
    from craftsim.tasks.episodes import Episodes

    rng = partial(np.random.default_rng, seed)
    if subject == "rules":
        published = make_task(task, reward="published_code")
        for depth, n in ((None, worlds), (DEPTH, worlds), (DEPTH, 1)):
            name = f"{'primitive' if depth is None else 'helper'}, {n} world{'s' if n > 1 else ''}"
            shared_rng = rng()
            episodes = Episodes(published, shared_rng, n, rules, depth)
            yield name, n, _play_rules(episodes, shared_rng)
    elif subject == "env":
        for depth in (DEPTH, None):
            helper = f"helper {'no' if depth is None else 'yes'}"
            env = parallel_env(task, "grid", helper_depth=depth)
            yield f"PettingZoo, {helper}", 1, _play_env(env, rng(), seed)
            envs = vector_env(task, worlds, helper_depth=depth)
            yield f"vector, {worlds} worlds, {helper}", worlds, _play_worlds(envs, rng(), seed)
    elif subject == "physics":
        for drive in DRIVES:
            yield drive, 1, _play_env(parallel_env(task, "physics", drive=drive), rng(), seed)
    else:
        raise ValueError(f"nothing is timed of '{subject}'")


def repeat(work: Callable[[], object], seconds: float) -> tuple[int, float]:
    """Return how often something was done within so many CPU seconds, once at least, and the time that it took."""
    begin_s = time.process_time()
    n_calls = 0
    while True:
        work()
        n_calls += 1
        spent_s = time.process_time() - begin_s
        if spent_s >= seconds and spent_s > 0:
            return n_calls, spent_s


def three_digits(value: float) -> str:
    """Return a number with three digits or more."""
    if value >= 100:
        return f"{value:,.0f}"
    if value >= 10:
        return f"{value:.1f}"
    return f"{value:.2f}"


def pick(rng: np.random.Generator, mask: NDArray[Any]) -> NDArray[np.int64]:
    """Return for each car one of its allowed actions, uniformly; 0 where there is none."""
    import numpy as np

    picked: NDArray[np.int64] = (rng.random(mask.shape, dtype=np.float32) * mask).argmax(-1)
    return picked


# Masked random play, resets included, a step at a time.


def _play_rules(episodes: Any, rng: np.random.Generator) -> Iterator[None]:
    while True:
        done = episodes.step(pick(rng, episodes.offered())).done
        if done.any():
            episodes.reset(done.nonzero()[0])
        if episodes.depth is not None:
            episodes.vectors()
        yield


def _play_env(env: ParallelConstruction, rng: np.random.Generator, seed: int) -> Iterator[None]:
    import numpy as np

    observations = env.reset(seed=seed)[0]
    while True:
        masks = np.stack([observation["action_mask"] for observation in observations.values()])
        actions = dict(zip(observations, pick(rng, masks).tolist(), strict=True))
        observations = {}
        if actions:
            observations = env.step(actions)[0]
        if not env.agents:
            observations = env.reset()[0]
        yield


def _play_worlds(envs: Any, rng: np.random.Generator, seed: int) -> Iterator[None]:
    observations = envs.reset(seed=seed)[0]
    while True:
        observations = envs.step(pick(rng, observations["action_mask"]))[0]
        yield


_FALLING_BALL: Final = """
import mujoco
model = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><geom type="plane" size="1 1 1"/>'
    '<body pos="0 0 0.2"><freejoint/><geom size="0.1"/></body></worldbody></mujoco>'
)
data = mujoco.MjData(model)
while data.time < 1:
    mujoco.mj_step(model, data)
if abs(data.qpos[2] - 0.1) > 0.001:
    raise SystemExit(f"a ball of radius 0.1 m came to rest at {data.qpos[2]:.4f} m")
"""


class Check(NamedTuple):
    """One thing that was tried: for what, if it works, what was found or why not, and the command that fixes it."""

    what: str
    works: bool
    found: str
    remedy: str = ""


@owning
def doctor(*, out: OptionalDir = None) -> int:
    """Check physics, rendering and packages on this machine, and print the commands that fix problems.

    Physics and rendering are tried in separate processes. Exit status: 0 if physics works, even without rendering, 2 if
    not.

    Args:
        out: folder for report.json.
    """
    from craftsim.reports.json_file import versions, write_report
    from craftsim.reports.terminal import Terminal, print_table

    physics = _physics()
    processors = usable_processors()
    versions_here = versions()
    audited = _audited(versions_here["mujoco"])
    compiler = _loads("compiler (Numba)", "numba")
    checks = [
        physics,
        compiler,
        _rendering(),
        _encoder(),
        _loads("figures (Matplotlib)", "matplotlib"),
    ]
    cache = None
    if compiler.works:
        cache = _compiled_code()
    if cache is not None:
        checks.append(cache)
    facts = {**versions_here, "processors": str(processors), "MuJoCo's audit": audited}
    for kind in PLUG_INS:
        installed = plug_ins(kind)
        if installed:
            facts[f"installed {kind}"] = ", ".join(installed)
    rows: list[tuple[Value, ...]] = [("", name, text) for name, text in facts.items()]
    for check in checks:
        if check.works:
            result = TableCell("ok", Tone.GOOD)
        else:
            result = TableCell("no", Tone.BAD)
        rows.append((result, check.what, check.found))
    columns = (Column(""), Column("what"), Column("found", "wide"))
    print_table(Terminal(), DataTable(columns, rows, "craftsim doctor"))
    for check in checks:
        if check.remedy:
            print_safe(f"{check.what}: run this to fix it:\n    {check.remedy}")
    if out is not None:
        figures = {
            "checks": [check._asdict() for check in checks],
            "processors": processors,
            "audited": audited,
        }
        print_safe(f"Report: {write_report(out, figures, command='doctor')}")
    if not (physics.works and compiler.works):
        print_safe("Physics does not run.")
        return 2
    draws = all(check.works for check in checks if check is not cache)
    if not draws:
        print_safe("Physics runs; films or figures cannot be made yet.")
    elif cache is not None and not cache.works:
        print_safe("Physics runs, but each command compiles anew.")
    else:
        print_safe("All well.")
    return 0


def _physics() -> Check:
    purpose = "physics (MuJoCo)"
    release = mujoco_release()
    if release is None:
        return Check(purpose, False, "MuJoCo is not installed", install_mujoco())
    refused = why_mujoco_refused(release)
    if refused:
        return Check(purpose, False, refused, install_mujoco())
    reason = run_apart(_FALLING_BALL, "rest")
    if reason:
        # A backend that cannot load makes the import of MuJoCo itself fail.
        return Check(purpose, False, reason, _unset_backend_or(install_mujoco()))
    return Check(purpose, True, f"{release}, a dropped ball comes to rest")


def _loads(purpose: str, package: str) -> Check:
    """Return whether a package that everything of a kind needs can be imported."""
    try:
        module = import_module(package)
    # Whatever it is, it would end the commands that need the package.
    except Exception as error:
        refused = refused_variables(error)
        remedy = f"{sys.executable} -m pip install --force-reinstall {package}"
        if refused:
            remedy = f"unset {' '.join(refused)}"
        return Check(purpose, False, f"{type(error).__name__}: {error}", remedy)
    return Check(purpose, True, f"{module.__version__}, loads")


def _compiled_code() -> Check:
    from craftsim.compiled.code_cache import kept_in

    purpose = "compiled code is kept"
    place, reason = kept_in()
    if reason:
        return Check(
            purpose,
            False,
            f"no: {reason}; each command compiles anew",
            "export NUMBA_CACHE_DIR=FOLDER",
        )
    return Check(purpose, True, str(place))


def _audited(installed: str) -> str:
    """Return how this release of MuJoCo did where the others were audited (scripts/engines.py)."""
    stored = json.loads(files("craftsim.data").joinpath("engines.json").read_text(encoding="utf-8"))
    audits = {}
    for name, engine in stored["found"].items():
        if name[0].isdigit() and "audit" in engine and "tasks" in engine:
            audits[name] = engine
    if installed not in audits:
        return f"{installed} was not audited; {', '.join(audits)} were (scripts/engines.py)"
    verdicts = audits[installed]["audit"]["verdicts"]
    unsound = verdicts["unsound"]
    rows = unsound + verdicts["sound"]
    differing = sum(run["differing"] for run in audits[installed].get("against", {}).values())
    return (
        f"{unsound} of {rows} rows unsound with {installed}; {differing} verdicts unlike those of "
        f"{stored['reference']}"
    )


def _rendering() -> Check:
    purpose = "off-screen rendering"
    try:
        return Check(purpose, True, f"{choose_backend()}, renders a frame")
    except RenderingUnavailable as error:
        return Check(purpose, False, str(error), _unset_backend_or(INSTALL_COMMAND))


def _unset_backend_or(remedy: str) -> str:
    if os.environ.get("MUJOCO_GL"):
        return "unset MUJOCO_GL"
    return remedy


def _encoder() -> Check:
    purpose = "film encoder (H.264)"
    install = f"{sys.executable} -m pip install --force-reinstall --only-binary av av"
    try:
        import av
    except (ImportError, OSError) as error:
        return Check(purpose, False, f"PyAV does not load: {error}", install)
    try:
        av.Codec("libx264", "w")
    except ValueError:
        return Check(purpose, False, f"PyAV {av.__version__} has no libx264", install)
    return Check(purpose, True, f"libx264 in PyAV {av.__version__}")

"""Episodes of a plan, the planner or a policy as a Minari dataset: validate --record minari."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from craftsim.choices import Backend
from craftsim.cli.text import say
from craftsim.errors import InputError
from craftsim.options import Physics, Rollouts, Trials

if TYPE_CHECKING:
    from craftsim.envs.datasets import MakeAct
    from craftsim.envs.parallel import ParallelConstruction

_PLANNER: Final = "planner"


def write_episodes(
    task: str,
    what: Rollouts,
    physics: Physics,
    campaign: Trials,
    backend: Backend,
    name: str | None,
    out: Path,
) -> int:
    """Play episodes and write them as a dataset for offline learning, which minari.load_dataset reads.

    It needs the extra 'minari'. Episode i has the seed i after the first, and is the same whatever else is exported.
    Physics is nominal. Return the exit status, 0 however the episodes went.

    Args:
        task: name of a task, a file, or 'module:factory'.
        what: a plan, or a policy; the planner if neither.
        physics: its rules and its seed, of the first episode.
        campaign: its trials, which are the episodes.
        backend: where they are played.
        name: of the dataset, with a version; craftsim/TASK/POLICY-v0 if None.
        out: folder of datasets, for MINARI_DATASETS_PATH; report.json lies with the dataset.
    """
    from craftsim.cli.progress import counting
    from craftsim.discrete.tasks import as_task
    from craftsim.envs import parallel_env
    from craftsim.envs.datasets import need_minari, write_dataset
    from craftsim.experiments.intervals import Proportion
    from craftsim.reports.json_file import write_report
    from craftsim.reports.terminal import Terminal

    need_minari()
    if len(what.policy) > 1 or what.actions is not None:
        raise InputError("a dataset is of one --plan or one --policy")
    plan = None if what.plan is None else Path(str(what.plan))
    policy = str(what.policy[0]) if what.policy else _PLANNER
    episodes, seed, rules = campaign.trials, physics.seed, physics.rules
    played = as_task(task)
    env = parallel_env(played, backend, rule_set=rules)
    player = policy if plan is None else "plan"
    if plan is not None and what.policy:
        raise InputError("--plan and --policy both say what is played; give one of them")
    make_act = _player(env, policy, plan)
    name = name or f"craftsim/{_word(played.name)}/{_word(Path(player).name)}-v0"
    begun = time.perf_counter()
    with counting(Terminal(), "episodes", episodes, bool) as count:
        written = write_dataset(env, make_act, out, name, episodes, seed, player, count)
    env.close()
    success = Proportion.of(written.successes, written.episodes)
    figures = {"episodes": written.episodes, "steps": written.steps, "success": success}
    asked = {"task": task, "policy": policy, "plan": plan, "episodes": episodes, "backend": backend}
    asked |= {"rules": rules, "name": name, "task_digest": played.digest}
    wall = {"playing_s": time.perf_counter() - begun}
    report = write_report(written.path, figures, command="export", seed=seed, config=asked, wall=wall)
    say(f"{name}: {written.episodes} episodes, {written.steps} steps, {written.successes} reach the goal.")
    say(f"Report: {report}")
    say(f"To load it: MINARI_DATASETS_PATH={out.resolve()}, then minari.load_dataset('{name}')")
    return 0


def _player(env: ParallelConstruction, policy: str, plan: Path | None) -> MakeAct:
    """Return what makes the policy of each episode; raise InputError where there is none, or not for this task."""
    from craftsim.discrete.files.plan import read_plan
    from craftsim.envs.planner import PlannerPolicy, PlanPolicy
    from craftsim.validation.policies import make_policy

    if plan is not None:
        read = read_plan(plan, env.core.n_cars)
        return lambda seed: PlanPolicy(env, read)
    if policy == _PLANNER:
        PlannerPolicy(env)  # refuses a task without a goal before anything is written
        return lambda seed: PlannerPolicy(env)
    make_policy(policy, 0, env.core.task)  # refuses one of another task before anything is written
    return lambda seed: make_policy(policy, seed, env.core.task)


def _word(text: str) -> str:
    """Return a text with a dash for whatever a dataset's name cannot hold."""
    return re.sub(r"[^\w-]+", "-", text) or "policy"

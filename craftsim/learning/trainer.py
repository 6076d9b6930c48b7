"""The training loop: rollout, update, evaluation now and then, checkpoints."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import asdict
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
import torch
from torch import Tensor

from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kinds import Execution, PlanTick
from craftsim.discrete.rules import RuleSet
from craftsim.envs.physics_vector import PhysicsVectorEnv
from craftsim.errors import InputError
from craftsim.learning.algorithms import ALGORITHMS, with_trait
from craftsim.learning.checkpoint import (
    ENCODER_TABLE,
    RUN_FILE,
    PolicyHead,
    RunHead,
    naming,
    read_policy,
    read_run_file,
    save_policy,
    save_run,
)
from craftsim.learning.config import TrainConfig, settings_of
from craftsim.learning.curve import CURVE_FILE, CurvePoint, EvaluationResult, write_curve
from craftsim.learning.evaluation import evaluate, evaluate_in_physics
from craftsim.learning.features import RelativeEncoder
from craftsim.learning.learner import Learner, learner_class
from craftsim.learning.networks import Bounds, CarNet, first_net, restore
from craftsim.learning.policy import PACKAGES
from craftsim.learning.policy_files import POLICY_FILE, policy_file
from craftsim.learning.policy_gradient import PPOLearner, imitate
from craftsim.learning.rollouts import Rollout
from craftsim.learning.settings import Device
from craftsim.learning.shape import Shape, TaskIdentity, check_stage, starts_digest
from craftsim.learning.starts import (
    Guidance,
    ProgressDisplay,
    check_guidance,
    guidance_of,
    plans_of_arrays,
    silent,
    tensors_of_plans,
)
from craftsim.learning.worlds import GridWorlds, Novelty, PhysicsWorlds, WorldBatch, play_rollout
from craftsim.reports.json_file import versions
from craftsim.tasks import Task
from craftsim.workers.interrupts import defer_interrupts
from craftsim.workers.pool import Engine

_EVALUATION_INTERVAL: Final = 10
"""Iterations from one evaluation to the next, unless its configuration says after how many ticks."""
SAVE_EVERY_S: Final = 30.0
"""Time after which a run is saved although nothing was evaluated."""
_ROLLOUT, _EVALUATION, _FINAL, _GUIDANCE = range(4)


class Trainer:
    """A training run. After each iteration it is where another run of the same configuration would be, bit for bit."""

    def __init__(
        self,
        config: TrainConfig,
        starts: Task | None = None,
        task: Task | None = None,
        workers: int | None = None,
        engine: Engine = "local",
        progress: ProgressDisplay = silent,
        stages: Sequence[Task] | None = None,
        device: Device = "cpu",
    ) -> None:
        """Prepare a run; close it when it is done with. Raises InputError where there is no such task.

        ``starts`` is the task with other starts to train from, where they are not its own. ``task`` and the tasks of
        the ``stages`` are looked up by their names in the configuration unless given. That may come from a file, so
        that nothing is imported for a name in it: what Python code makes has to be given. ``workers`` and ``engine``
        share the worlds in physics, as those of :class:`craftsim.envs.options.BatchOptions`. ``device`` is where
        networks are; runs are repeated bit for bit on the cpu alone, and what is saved is the same.
        """
        self.config = config
        self._shared = {"workers": workers, "engine": engine}
        self.device = _known_device(device)
        self.task = task or config.find_task(config.task)
        self.identity = TaskIdentity.of(self.task, config.rules)
        # digest of the other starts
        if starts is None:
            self.starts = ""
        else:
            self.starts = starts_digest(starts)
        check_guidance(config, self.task, starts)
        self._given = starts
        self._progress = progress
        self._planned: list[
            tuple[PlanTick, ...]
        ] = []  # of the demonstrations, as far as they are made
        self._saved_s = time.perf_counter()
        self.under_way = False
        """Whether an iteration is under way, so that the run is nothing to go on from."""
        self._own_starts = starts is None and not config.explore and not config.imitate
        algorithm = ALGORITHMS[config.algo]
        of_policy = {
            "layer_norm": not algorithm.learns_probabilities and config.network != "linear",
            "recurrent": config.recurrent,
            "last_action": config.last_action,
        }
        shown_ticks = self.task.max_steps + 2 if config.shows_hidden else 0
        self.shape = Shape.of(self.task, config.width, config.network, shown_ticks, **of_policy)
        if stages is None:
            self._stages = [config.find_task(name) for name in config.stages]
        else:
            self._stages = list(stages)
        for stage in self._stages:
            check_stage(stage, self.shape)
        self._made: tuple[int, WorldBatch] | None = None
        self.curve: list[CurvePoint] = []
        self.iteration = 0
        self.wall_s = 0.0
        self.cpu_s = 0.0
        with torch.random.fork_rng():
            torch.manual_seed(config.seed)
            # Where cars decide one by one, most events are a single car's.
            turns = 1
            if config.execution == "asynchronous":
                turns = self.task.layout.n_cars
            ticks = (self.task.max_steps + 2) * turns
            settings = settings_of(config.algo, config.hyperparameters)
            self.learner: Learner = learner_class(config.algo)(self.shape, ticks, settings)
            digest = ""
            if config.pretrained:
                digest = _begin_as_pretrained(self.learner.net, self.shape, config)
            self.pretrained = digest  # digest of the policy that it began with
            self.learner.to(
                self.device
            )  # after its first weights, which are the same on any device
        if not config.novelty:
            self.novelty = None
        else:
            self.novelty = Novelty(config.novelty, self.shape)

    @cached_property
    def guidance(self) -> Guidance:
        """What it has beside its task, found when it is first needed; :meth:`prepare` saves meanwhile."""
        words = np.random.SeedSequence([self.config.seed, _GUIDANCE, 0])
        rng = np.random.default_rng(int(words.generate_state(1)[0]))
        return guidance_of(self.config, self.task, self._given, rng, self._progress, self._planned)

    def prepare(self, folder: Path) -> None:
        """Make the plans that it imitates, and save them now and then."""
        progress = self._progress

        @contextmanager
        def saving(total: int) -> Iterator[Callable[[bool], None]]:
            with progress(total) as tell:

                def made(good: bool) -> None:
                    tell(good)
                    if time.perf_counter() - self._saved_s >= SAVE_EVERY_S:
                        self.save(folder)

                yield made

        self._progress = saving
        try:
            _ = self.guidance
        finally:
            self._progress = progress

    @property
    def stage(self) -> int:
        """Which of the tasks it learns on, the stages of its configuration first."""
        stages = self.config.stages
        steps = self.config.stage_steps
        if stages:
            return min(self.steps // steps, len(stages))
        return 0

    @property
    def worlds(self) -> WorldBatch:
        """The worlds of rollouts, made when they are first needed, and anew for each stage."""
        if self._made is None or self._made[0] != self.stage:
            self.close()
            task = [*self._stages, self.guidance.starts or self.task][self.stage]
            n = self.config.n_worlds
            on_grid = self.config.backend == "grid"
            worlds: WorldBatch
            if on_grid:
                worlds = GridWorlds(
                    task, n, *self._how, self.config.queue_survives, self.config.shows_hidden
                )
            else:
                worlds = PhysicsWorlds(task, n, **self._physics)
            self._made = self.stage, worlds
        return self._made[1]

    @property
    def _how(self) -> tuple[RuleSet, int | None, Execution]:
        """How episodes on the grid go."""
        return self.config.rules, self.config.helper_depth, self.config.execution

    @property
    def _physics(self) -> dict[str, Any]:
        """Options of worlds in physics."""
        return {**self._shared, "drive": self.config.drive, "randomization": self.config.randomize}

    @property
    def steps(self) -> int:
        """Ticks learnt from so far, all worlds together."""
        return self.iteration * self.steps_an_iteration

    @property
    def steps_an_iteration(self) -> int:
        """Ticks played between two updates, all worlds together."""
        return self.learner.ticks * self.config.n_worlds

    def run(self, steps: int, until: float) -> Iterator[bool]:
        """Train for so many steps in all, or until an evaluation has that success.

        Yields after each iteration whether the curve has a new point. An interrupt takes effect between two iterations,
        a second one at once: then the iteration is lost, and :attr:`under_way`.
        """
        while self.steps < steps and not (self.curve and self.curve[-1].success >= until):
            begin_s = time.perf_counter()
            cpu_begun = time.process_time()
            with defer_interrupts():
                self.under_way = True
                self._iterate()
                # What was imitated may be all that there is to learn.
                imitated = self.iteration == 1 and self.guidance.demonstrations is not None
                interval = (
                    self.config.evaluate_every or _EVALUATION_INTERVAL * self.steps_an_iteration
                )
                before = self.steps - self.steps_an_iteration
                evaluates = imitated or self.steps // interval > before // interval
                if evaluates:
                    played = self.evaluate(self.config.n_evaluation_episodes, _EVALUATION)
                    self.curve.append(CurvePoint(**asdict(played), steps=self.steps))
                self.wall_s += time.perf_counter() - begin_s
                self.cpu_s += time.process_time() - cpu_begun
                self.under_way = False
            yield evaluates

    def run_and_save(self, folder: Path, steps: int, until: float) -> Iterator[bool]:
        """Train as :meth:`run` does; save after each evaluation, now and then between them, and in the end."""
        for evaluated in self.run(steps, until):
            if evaluated or time.perf_counter() - self._saved_s >= SAVE_EVERY_S:
                self.save(folder)
            yield evaluated
        self.save(folder)

    def _on_device(self) -> AbstractContextManager[object]:
        """Return a context in which tensors are made on the device; they are on the cpu without, which is faster."""
        if self.device.type == "cpu":
            return nullcontext()
        return self.device

    def evaluate(
        self, episodes: int, purpose: int = _FINAL, record: Path | None = None
    ) -> EvaluationResult:
        """Evaluate the policy as it is on fresh episodes; in physics ``record`` is a folder for their trajectories."""
        with self._on_device():
            return self._evaluate(episodes, purpose, record)

    def _evaluate(self, episodes: int, purpose: int, record: Path | None) -> EvaluationResult:
        net = self.learner.net
        seed = self._seed(purpose)
        config = self.config
        if config.backend == "grid":
            rules, depth, execution = self._how
            return evaluate(net, self.task, episodes, seed, rules, depth, config.acting, execution)
        last = self.stage == len(self._stages)
        if self._own_starts and last and record is None and isinstance(self.worlds, PhysicsWorlds):
            return evaluate_in_physics(net, self.worlds.envs, episodes, seed, config.acting)
        with closing(
            PhysicsVectorEnv(self.task, config.n_worlds, record=record, **self._physics)
        ) as worlds:
            return evaluate_in_physics(net, worlds, episodes, seed, config.acting)

    def close(self) -> None:
        """End the processes that hold worlds in physics."""
        if self._made is not None:
            self._made[1].close()
            self._made = None

    def play(self, seed: int) -> Rollout:
        """Return a rollout, after seeding worlds and torch's default generator."""
        torch.manual_seed(seed)
        self.worlds.reset(seed)
        with self._on_device():
            return play_rollout(self.worlds, self.learner, self.novelty)

    def _iterate(self) -> None:
        seed = self._seed(_ROLLOUT)
        with torch.random.fork_rng(), self._on_device():
            demonstrations = self.guidance.demonstrations
            if (
                self.iteration == 0
                and demonstrations is not None
                and isinstance(self.learner, PPOLearner)
            ):
                torch.manual_seed(seed)
                imitate(
                    self.learner,
                    self.task,
                    demonstrations,
                    self.config.rules,
                    self.config.helper_depth,
                )
            self.learner.learnt = self.steps
            self.learner.update(self.play(seed))
        if not all(weight.isfinite().all() for weight in self.learner.net.parameters()):
            raise InputError(
                f"training has diverged in iteration {self.iteration}: weights are no longer finite. What was saved "
                "before stands; try another --seed or --algo"
            )
        self.iteration += 1

    def _seed(self, purpose: int) -> int:
        words = np.random.SeedSequence([self.config.seed, purpose, self.iteration]).generate_state(
            1
        )
        return int(words[0])

    def save(self, folder: Path) -> None:
        """Write all that is needed to go on, the policy, and the learning curve."""
        made_with = training_versions()
        so_far = self.iteration, self.wall_s, self.cpu_s, self.curve
        run = RunHead(self.config, self.identity, self.starts, made_with, *so_far)
        plans = {}
        if self._planned:
            plans = tensors_of_plans(self._planned)
        # Before the policy, so that there is no policy without its run, whenever this is cut off.
        save_run(folder / RUN_FILE, run, self._tensors()[0] | plans)
        head = PolicyHead(self.config, self.identity, self.shape, made_with)
        save_policy(folder / POLICY_FILE, head, self.learner.net)
        write_curve(folder / CURVE_FILE, self.curve)
        self._saved_s = time.perf_counter()

    def _tensors(self) -> tuple[dict[str, Tensor], dict[str, Bounds]]:
        """Return all tensors of the run, and bounds of those that are no weights."""
        tensors, bounds = self.learner.tensors()
        if self.novelty is not None:
            tensors["novelty"] = torch.from_numpy(self.novelty.counts)
            bounds["novelty"] = (0, 2**30)
        if self.config.queue_survives and isinstance(self.worlds, GridWorlds):
            tensors["queue"] = torch.from_numpy(self.worlds.episodes.queue)
            bounds["queue"] = (-1, N_ACTIONS - 1)
        return tensors, bounds

    @classmethod
    def resume(
        cls,
        folder: Path,
        starts: Task | None = None,
        config: TrainConfig | None = None,
        **arguments: Any,
    ) -> Trainer:
        """Return the run that a folder holds, as it was when it was saved; ``given`` is as of the constructor.

        Raises InputError for a file that is none or damaged, and where the task, the other starts or, if it is given,
        the configuration are not those that the run was begun with.
        """
        path = folder / RUN_FILE
        head, arrays = read_run_file(path)
        with naming(path):
            options = asdict(config or head.config)
            for name, was in asdict(head.config).items():
                if was != options[name]:
                    raise InputError(
                        f"it was begun with {name}={was!r}, not {options[name]!r}; use the same "
                        "options, or another --out"
                    )
            trainer = cls(head.config, starts, **arguments)
            if head.task.digest != trainer.identity.digest:
                raise InputError(
                    f"the task '{trainer.task.name}' has changed since the run was begun"
                )
            if head.starts != trainer.starts:
                if head.starts:
                    starts_words = "other starts"
                else:
                    starts_words = "no other starts"
                raise InputError(
                    f"the run was begun with {starts_words} than these; give those of then with --starts"
                )
            trainer._planned = plans_of_arrays(
                arrays, head.config.imitate, trainer.task.layout.n_cars
            )
            tensors, bounds = trainer._tensors()
            restore(tensors, arrays, bounds)
            trainer.iteration = head.iteration
            trainer.curve = head.curve
            trainer.wall_s = head.wall_s
            trainer.cpu_s = head.cpu_s
        return trainer


def _begin_as_pretrained(net: CarNet, shape: Shape, config: TrainConfig) -> str:
    """Let a network begin as the policy that a configuration names; return the digest (SHA-256) of its file.

    What that one has not learnt stays as it is. Networks that look from a car may be for areas of different sizes,
    others are for the same one. Raises InputError for a policy of which nothing can be taken over.
    """
    path = policy_file(config.pretrained)
    head, trained_net = read_policy(path)
    pretrained = head.config
    trained_shape = head.shape
    if not ALGORITHMS[pretrained.algo].learns_probabilities:
        raise InputError(
            f"{path}: trained by {pretrained.algo}, which rates actions by value; "
            f"allowed: {', '.join(with_trait('learns_probabilities'))}"
        )
    learnt = (
        trained_net.encoder.table.weight
        != first_net(trained_shape, pretrained.seed).encoder.table.weight
    ).any(-1)
    if trained_shape.fits(shape):
        table = torch.where(
            learnt[:, None], trained_net.encoder.table.weight, net.encoder.table.weight
        )
        net.load_state_dict({**trained_net.state_dict(), ENCODER_TABLE: table})
    elif (
        isinstance(net.encoder, RelativeEncoder)
        and isinstance(trained_net.encoder, RelativeEncoder)
        and trained_shape.width == shape.width
    ):
        net.encoder.take_over(trained_net.encoder, learnt)
        net.head.load_state_dict(trained_net.head.state_dict())
    else:
        raise InputError(
            f"{path}: its network is for {trained_shape}, the one to train for {shape}; take the same network and "
            "width, and with 'map' the same area and number of cars"
        )
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _known_device(name: str) -> torch.device:
    """Return a device; within it as a context tensors are made there. Raises InputError where there is none."""
    if name not in get_args(Device):
        raise InputError(f"device is {name!r}; allowed: {', '.join(get_args(Device))}")
    if name == "cuda" and not torch.cuda.is_available():
        raise InputError(
            f"device is 'cuda', but torch {torch.__version__} finds no GPU here; allowed: cpu. A GPU needs its driver "
            "and a build of torch for CUDA"
        )
    return torch.device(name)


def training_versions() -> dict[str, str]:
    """Return the versions that decide what a run learns."""
    return {**versions(), **{name: version(name) for name in PACKAGES}}

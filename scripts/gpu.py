"""Step worlds of the reduced drive with MuJoCo Warp on a GPU: the same verdicts as with MuJoCo, and how fast.

    python scripts/gpu.py                                        # verdicts and rates on cuda, in minutes
    python scripts/gpu.py verdicts --device cpu --tasks strip --trials 1

*verdicts*: trials of ``craftsim validate`` of the six tasks with mild randomization, once with MuJoCo and once with
MuJoCo Warp in place of ``mj_step``; sensors, control laws and judge are the same code. The worlds of a task step
together, a control period at a time. Each starts where MuJoCo has let it come to rest. *rates*: the commands and motor
limits of a trial are recorded with MuJoCo and replayed in many worlds at once: physics alone. MuJoCo Warp computes in
single precision. Nothing sleeps on either side. ``--store`` writes docs/results/gpu.json, for docs/explanation/drives.md.
"""

from __future__ import annotations

import argparse
import copy
import json
import multiprocessing
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import mujoco
import numpy as np

from craftsim.checking.attempt import Verdict
from craftsim.checking.judge import Judge
from craftsim.checking.setup import Setup, set_up, setup_of
from craftsim.discrete.readback import read_grid
from craftsim.discrete.tasks import TASK_NAMES
from craftsim.errors import InputError
from craftsim.experiments.compare import alike, compare_paired
from craftsim.models.effects import IDEAL, effects_of
from craftsim.models.world import PhysicsWorld
from craftsim.reports.json_file import document, plain, versions
from craftsim.reports.report import DataTable, Headline, Report, Section, Tone, numbers
from craftsim.validation.policies import PLANNER
from craftsim.validation.rollout import Run, do_run, read_building
from craftsim.validation.validation import items_of, policy_source, rollout_worlds

try:
    import mujoco_warp as mjw
    import warp as wp
except ModuleNotFoundError:
    mjw = wp = None

ROOT: Final = Path(__file__).parents[1]
STORED: Final = ROOT / "docs" / "results" / "gpu.json"
PIP: Final = "pip install mujoco-warp==3.17.0 warp-lang==1.19.0"
RATED: Final = ("simple_two_story", "complex_two_story")
"""Tasks of two and of four cars."""
WHOLE: Final = 1024
"""Most worlds that replay the whole trial; more of them begin at moments spread over it, and replay PART steps."""
PART: Final = 200
VARIED: Final = (
    *("geom_friction", "pair_friction", "body_mass", "body_subtreemass", "body_inertia", "body_invweight0"),
    *("dof_frictionloss", "dof_damping", "dof_invweight0", "actuator_gainprm", "actuator_biasprm"),
    *("actuator_acc0", "actuator_forcerange", "actuator_gear"),
)
"""What mild randomization, the wheels' grip and turned motors make differ among worlds, beside gravity."""
STATE: Final = ("qpos", "qvel", "act", "qacc_warmstart")
READ: Final = (*STATE, "qacc", "actuator_velocity", "actuator_force", "xmat")
"""What sensors, motors' limits and judge read of MjData, beside contacts."""


@cache
def kernels() -> SimpleNamespace:
    """Return the kernels that are not MuJoCo Warp's. Raises InputError where it is missing."""
    if wp is None:
        raise InputError(f"MuJoCo Warp is not installed; {PIP}")

    @wp.kernel
    def turn(
        qpos: wp.array2d(dtype=float),
        places: wp.array(dtype=int),
        motors: wp.array(dtype=wp.vec2i),
        own: wp.array(dtype=wp.vec3),
        gear: wp.array2d(dtype=wp.spatial_vector),
    ):  # type: ignore[valid-type]
        """Do what craftsim.models.effects.turn_motors does, for gears without backlash."""
        world, wheel = wp.tid()
        at = places[wheel]
        turned = wp.quat(
            qpos[world, at + 4], qpos[world, at + 5], qpos[world, at + 6], qpos[world, at + 3]
        )
        push = wp.quat_rotate(turned, wp.vec3(own[wheel][0], own[wheel][1], 0.0))
        row = wp.spatial_vector(push[0], push[1], push[2], 0.0, 0.0, own[wheel][2])
        gear[world, motors[wheel][0]] = row
        gear[world, motors[wheel][1]] = row

    @wp.kernel
    def count(
        iterations: wp.array(dtype=int),
        limit: int,
        capped: wp.array(dtype=int),
        most: wp.array(dtype=int),
    ):  # type: ignore[valid-type]
        world = wp.tid()
        most[world] = wp.max(most[world], iterations[world])
        if iterations[world] >= limit:
            capped[world] += 1

    @wp.kernel
    def command(
        number: wp.array(dtype=int),
        start: wp.array(dtype=int),
        commands: wp.array2d(dtype=float),
        limits: wp.array2d(dtype=wp.vec2),
        ctrl: wp.array2d(dtype=float),
        forcerange: wp.array2d(dtype=wp.vec2),
    ):  # type: ignore[valid-type]
        world, motor = wp.tid()
        now = start[world] + number[0]
        ctrl[world, motor] = commands[now, motor]
        forcerange[world, motor] = limits[now, motor]

    @wp.kernel
    def tick(number: wp.array(dtype=int)):  # type: ignore[valid-type]
        number[0] += 1

    return SimpleNamespace(turn=turn, count=count, command=command, tick=tick)


class DeviceWorlds:
    """Worlds of equal models on a device, which step together."""

    def __init__(self, physics: Sequence[PhysicsWorld], n_worlds: int, contacts: int, rows: int) -> None:
        """Take parameters and state of each, or of the one for all, with room for contacts and solver rows in each."""
        first, n = physics[0], n_worlds
        policies = first.model.tree_sleep_policy.copy()
        # MuJoCo Warp takes no other policy, and nothing sleeps.
        first.model.tree_sleep_policy[:] = mujoco.mjtSleepPolicy.mjSLEEP_AUTO_ALLOWED
        self.model = mjw.put_model(first.model, batch_sizes=dict.fromkeys(VARIED, n))
        self.model.opt.warn_overflow = 0  # overflows() says it
        # Of a copy, into which it writes.
        self.data = mjw.put_data(first.model, copy.copy(first.data), n, nconmax=contacts, njmax=rows)
        first.model.tree_sleep_policy[:] = policies
        for name in (*VARIED, "gravity"):
            values = [getattr(one.model.opt if name == "gravity" else one.model, name) for one in physics]
            place = self.model.opt if name == "gravity" else self.model
            setattr(place, name, _array(values, n, getattr(place, name).dtype))
        _, (_, places, wheels, _) = effects_of(first, IDEAL)
        pairs = np.column_stack([wheels["motor"], wheels["gear"]])
        own = np.ascontiguousarray(wheels["own_gear"][:, [0, 1, 5]])
        self._turn = wp.array(places, dtype=int), wp.array(pairs, dtype=wp.vec2i), wp.array(own, dtype=wp.vec3)
        self.capped, self.most = wp.zeros(n, dtype=int), wp.zeros(n, dtype=int)
        self._graphs: dict[Any, Any] = {}
        # Kernels are loaded before a graph is captured.
        self.step()
        for name in STATE:
            self.put(name, [getattr(one.data, name) for one in physics])
        for counted in (self.capped, self.most, self.data.overflow):
            counted.zero_()

    def put(self, name: str, values: Any) -> None:
        """Write an array of the state, (n or 1, size)."""
        array = getattr(self.data, name)
        array.assign(_array(values, len(array), array.dtype))

    def step(self) -> None:
        """Run one physics step."""
        own, model, data = kernels(), self.model, self.data
        places, motors, gears = self._turn
        wp.launch(
            own.turn, (data.nworld, len(places)), [data.qpos, places, motors, gears, model.actuator_gear]
        )
        mjw.step(model, data)
        limit = model.opt.iterations
        wp.launch(own.count, data.nworld, [data.solver_niter, limit, self.capped, self.most])

    def run(self, work: Callable[[], None]) -> None:
        """Do work that launches kernels, the same each time: on a GPU as a graph that is captured at first."""
        if not wp.get_device().is_cuda:
            work()
            return
        if work not in self._graphs:
            with wp.ScopedCapture() as capture:
                work()
            self._graphs[work] = capture.graph
        wp.capture_launch(self._graphs[work])

    def figures(self) -> dict[str, Any]:
        """Return what did not fit in any step, or was not solved, and how many iterations a step needed at most."""
        found = int(np.bitwise_or.reduce(self.data.overflow.numpy()))
        return {
            "overflows": [flag.name for flag in mjw.OverflowType if flag & found and flag.name != "ALL"],
            "capped": int(self.capped.numpy().sum()),
            "most_iterations": int(self.most.numpy().max()),
        }


def _array(values: Any, n: int, dtype: Any) -> Any:
    """Return (n, ...) on the device."""
    values = np.asarray(values)
    shape = n, *values.shape[1:]
    return wp.array(np.ascontiguousarray(np.broadcast_to(values, shape), dtype=np.float32), dtype=dtype)


class Lockstep:
    """Trials in threads, whose worlds step together on a device once all are set up."""

    def __init__(self, jobs: Sequence[Run], note: Callable[[Run, Any], None]) -> None:
        """Begin the trials; ``note`` is called with what each comes to, or with the exception."""
        self._requests: queue.Queue[tuple[int, int]] = queue.Queue()
        self._answers = [threading.Event() for _ in jobs]
        self._worlds: list[PhysicsWorld | None] = [None] * len(jobs)
        self._stopped = False
        self._threads = [
            threading.Thread(target=self._try, args=(place, job, note), daemon=True)
            for place, job in enumerate(jobs)
        ]

    def _try(self, place: int, job: Run, note: Callable[[Run, Any], None]) -> None:
        def where(*terms: Any) -> Judge:
            judge = set_up(*terms)
            self._worlds[place] = judge.physics
            self._ask(place, 0)
            judge.physics._stepping = SimpleNamespace(run=lambda n: self._step(place, n))
            return judge

        try:
            note(job, do_run(replace(job, set_up=where)))
        except Exception as error:
            note(job, error)
        self._requests.put((place, -1))

    def _ask(self, place: int, n_steps: int) -> None:
        self._answers[place].clear()
        self._requests.put((place, n_steps))
        self._answers[place].wait()
        if self._stopped:
            raise TimeoutError("out of time")

    def _step(self, place: int, n_steps: int) -> int:
        """Do what craftsim.models.stepping.Stepping.run does."""
        if not n_steps:
            return 0
        self._ask(place, n_steps)
        return self._take(place, n_steps)

    def serve(self, until: float) -> dict[str, Any]:
        """Step until all trials have ended, or it is that time; return figures of the steps."""
        for thread in self._threads:
            thread.start()
        left: dict[int, int] = {}
        live, device, n_steps, spent_s = len(self._threads), None, 0, 0.0
        while live:
            place, wanted = self._requests.get()
            if wanted < 0:
                live -= 1
            else:
                left[place] = wanted
            if not live or len(left) < live:
                continue
            if time.time() > until:
                self._stopped = True
            elif device is None:
                worlds = [world for world in self._worlds if world is not None]
                self._device = device = _Mirror(worlds)
                self._rows = {id(world): row for row, world in enumerate(worlds)}
            else:
                number = min(left.values())
                began = time.perf_counter()
                device.advance(number)
                spent_s += time.perf_counter() - began
                n_steps += number
                left = {place: wanted - number for place, wanted in left.items()}
            done = [place for place, wanted in left.items() if self._stopped or not wanted]
            for place in done:
                del left[place]
                self._answers[place].set()
        found = {"steps": n_steps, "device_s": spent_s}
        return found if device is None else found | device.worlds.figures()

    def _take(self, place: int, n_steps: int) -> int:
        world = self._worlds[place]
        assert world is not None
        return self._device.show(self._rows[id(world)], world, n_steps)


class _Mirror:
    """Worlds on a device, and what is read of them in MuJoCo's own data."""

    def __init__(self, worlds: Sequence[PhysicsWorld]) -> None:
        contacts, rows = (2 * max(getattr(one.data, name) for one in worlds) for name in ("ncon", "nefc"))
        self.worlds, self._physics = DeviceWorlds(worlds, len(worlds), contacts + 40, rows + 100), worlds
        data, pinned = self.worlds.data, wp.get_device().is_cuda
        self._read = [getattr(data, name) for name in READ]
        contact = data.contact
        self._read += [contact.worldid, contact.type, contact.geom, contact.frame, contact.dist]
        self._read += [contact.efc_address, data.efc.force, data.nacon, self.worlds.capped]
        self._host = [wp.empty_like(array, device="cpu", pinned=pinned) for array in self._read]
        self._seen = [array.numpy() for array in self._host]
        self._capped = np.zeros(len(worlds), int)

    def advance(self, n_steps: int) -> None:
        """Take motors' commands and limits of all worlds, step, and read."""
        ctrl = np.array([one.data.ctrl for one in self._physics], np.float32)
        limits = np.array([one.model.actuator_forcerange for one in self._physics], np.float32)
        self.worlds.data.ctrl.assign(ctrl)
        self.worlds.model.actuator_forcerange.assign(limits)
        for _ in range(n_steps):
            self.worlds.run(self.worlds.step)
        for own, array in zip(self._host, self._read, strict=True):
            wp.copy(own, array)
        wp.synchronize_device()

    def show(self, row: int, physics: PhysicsWorld, n_steps: int) -> int:
        """Write what was read of a world into its MjData; return in how many steps the solver gave up."""
        data, seen = physics.data, self._seen
        for name, values in zip(READ, seen, strict=False):
            own = getattr(data, name)
            own[:] = values[row].reshape(own.shape)
        worlds, kinds, geoms, frames, distances, addresses, forces, count, capped = seen[len(READ) :]
        n_found = min(int(count[0]), len(worlds))
        mine = np.flatnonzero((worlds[:n_found] == row) & (kinds[:n_found] & 1 > 0))
        touching = addresses[mine, 0]
        # Of a contact's rows that of its normal force is enough.
        mujoco._functions._realloc_con_efc(data, ncon=len(mine), nefc=len(mine), nJ=0)
        data.ncon = len(mine)
        contact = data.contact
        contact.geom[:], contact.frame[:] = geoms[mine], frames[mine].reshape(-1, 9)
        contact.dist[:] = distances[mine]
        contact.exclude[:] = 0
        contact.efc_address[:] = np.where(touching >= 0, np.arange(len(mine)), -1)
        data.efc_force[:] = np.where(touching >= 0, forces[row, np.maximum(touching, 0)], 0.0)
        for _ in range(n_steps):
            data.time += physics.model.opt.timestep
        if not np.isfinite(data.qacc).all():
            data.warning.number[int(mujoco.mjtWarning.mjWARN_BADQACC)] += 1
        more = int(capped[row]) - self._capped[row]
        self._capped[row] += more
        return more


def own_setup() -> Setup:
    """Return the setup of all trials: mild randomization, reduced drive, nothing sleeps."""
    setup = setup_of("mild", drive="reduced")
    return replace(setup, simulation=replace(setup.simulation, sleep=False))


def jobs_of(task: str, trials: int, setup: Setup) -> list[Run]:
    """Return the trials of ``craftsim validate TASK --seed 0``."""
    worlds = rollout_worlds([task])
    sources = [policy_source(PLANNER, worlds, "concurrent")]
    return [one.job for one in items_of(worlds, sources, trials, 0, setup)]


class Recording:
    """What a trial with MuJoCo commands in each physics step, and the states in which these begin."""

    def __init__(self, task: str, setup: Setup) -> None:
        """Carry out the shipped plan of a task."""
        steps: list[tuple[Any, ...]] = []

        def where(*terms: Any) -> Judge:
            judge = set_up(*terms)
            self.physics = physics = judge.physics
            self.first, self.stepping = copy.copy(physics.data), physics._stepping
            physics._stepping = SimpleNamespace(run=record)
            return judge

        def record(n_steps: int) -> int:
            data = self.physics.data
            if n_steps:
                assert n_steps == 1, "the judge looks at each"
                state = (getattr(data, name).copy() for name in STATE)
                limits = self.physics.model.actuator_forcerange.copy()
                steps.append((data.ctrl.copy(), limits, *state, data.ncon, data.nefc))
            return self.stepping.run(n_steps)

        (job,) = jobs_of(task, 1, setup)
        self.joint_steps = do_run(replace(job, set_up=where)).extra["ticks"]
        self.physics._stepping = self.stepping
        self.ctrl, self.limits, *states, contacts, rows = map(np.array, zip(*steps, strict=True))
        self.states = dict(zip(STATE, states, strict=True))
        self.last = self.physics.data.qpos.copy()
        self.n_steps, self.contacts, self.rows = len(steps), int(contacts.max()), int(rows.max())

    def mujoco_rate(self, seconds: float) -> float:
        """Replay on one core for so long, the whole trial again and again; return physics steps a CPU second."""
        physics, rounds, began = self.physics, 0, time.process_time()
        per_period = physics.config.steps_per_period
        commands = self.ctrl[::per_period], self.limits[::per_period]
        while not rounds or time.process_time() - began < seconds:
            mujoco.mj_copyData(physics.data, physics.model, self.first)
            for ctrl, limits in zip(*commands, strict=True):
                physics.data.ctrl[:], physics.model.actuator_forcerange[:] = ctrl, limits
                physics.run(per_period)
            rounds += 1
        rate = rounds * self.n_steps / (time.process_time() - began)
        if not physics.config.sleep and (physics.data.qpos != self.last).any():
            raise RuntimeError("MuJoCo's replay ends otherwise than the trial")
        return rate

    def grid(self, qpos: Any) -> Any:
        """Return what positions read as, and what cannot be read."""
        physics = self.physics
        physics.data.qpos[:] = qpos
        return read_grid(physics.poses(), physics.size, physics.walls)


def replay(recording: Recording, n_worlds: int, n_steps: int) -> dict[str, Any]:
    """Replay so many steps of a trial in many worlds on the device; return figures."""
    physics = recording.physics
    mujoco.mj_copyData(physics.data, physics.model, recording.first)
    worlds = DeviceWorlds([physics], n_worlds, recording.contacts + 12, recording.rows + 40)
    starts = np.linspace(0, recording.n_steps - n_steps, n_worlds).astype(int)
    commands = wp.array(recording.ctrl.astype(np.float32), dtype=float)
    limits = wp.array(recording.limits.astype(np.float32), dtype=wp.vec2)
    at, number = wp.array(starts, dtype=int), wp.zeros(1, dtype=int)
    given = [number, at, commands, limits, worlds.data.ctrl, worlds.model.actuator_forcerange]

    def step() -> None:
        wp.launch(kernels().command, (n_worlds, commands.shape[1]), given)
        worlds.step()
        wp.launch(kernels().tick, 1, [number])

    worlds.run(step)
    for name in STATE:
        worlds.put(name, recording.states[name][starts])
    for counted in (number, worlds.capped, worlds.most, worlds.data.overflow):
        counted.zero_()
    wp.synchronize_device()
    began = time.perf_counter()
    for _ in range(n_steps):
        worlds.run(step)
    wp.synchronize_device()
    took_s = time.perf_counter() - began
    qpos = worlds.data.qpos.numpy()
    found = {
        "worlds": n_worlds,
        "steps": n_steps,
        "seconds": took_s,
        "steps_a_second": n_worlds * n_steps / took_s,
        "finite": bool(np.isfinite(qpos).all()),
        **worlds.figures(),
    }
    if n_steps == recording.n_steps:
        wanted, far = recording.grid(recording.last), np.abs(qpos - recording.last)[:, physics.pose_places[:, :3]]
        read = [recording.grid(row) for row in qpos]
        same = [not one.problems and one.grid.same_visible(wanted.grid) for one in read]
        found |= {"equal": sum(same), "median_furthest_m": float(np.median(far.max(axis=(1, 2))))}
    return found


def rates(task: str, worlds: Iterable[int], device: str, until: float, out: Path) -> dict[str, Any]:
    """Return how fast a trial's physics is on one core with MuJoCo, and on the device."""
    setup = own_setup()
    asleep = replace(setup, simulation=replace(setup.simulation, sleep=True))
    recording = Recording(task, setup)
    found: dict[str, Any] = {
        "cars": len(recording.physics.cars),
        "steps": recording.n_steps,
        "joint_steps": recording.joint_steps,
        "contacts": recording.contacts,
        "rows": recording.rows,
        "mujoco_a_second": recording.mujoco_rate(2.0),
        "mujoco_asleep_a_second": Recording(task, asleep).mujoco_rate(2.0),
        "replays": [],
    }
    file = out / f"rates_{task}.json"
    for n in worlds:
        if time.time() > until:
            found["why"] = f"no time for {n} worlds"
            break
        with wp.ScopedDevice(device):
            try:
                found["replays"].append(replay(recording, n, recording.n_steps if n <= WHOLE else PART))
            except RuntimeError as error:
                found["why"] = f"{n} worlds: {error}"
        print(task, found["replays"][-1:], found.get("why", ""), flush=True)
        file.write_text(json.dumps(plain(found)), encoding="utf-8")
    return found


def with_mujoco(task: str, trials: int, out: Path) -> None:
    """Carry out the trials of a task with MuJoCo, a line for each in a file."""
    for job in jobs_of(task, trials, own_setup()):
        _note(out / f"mujoco_{task}.jsonl", job, do_run(job))


def with_warp(task: str, trials: int, device: str, until: float, out: Path) -> None:
    """Do so with MuJoCo Warp, all at once."""
    began = time.perf_counter()
    file = out / f"warp_{task}.jsonl"
    with wp.ScopedDevice(device):
        trials_at_once = Lockstep(jobs_of(task, trials, own_setup()), lambda *of: _note(file, *of))
        found = trials_at_once.serve(until)
    found |= {"trials": trials, "seconds": time.perf_counter() - began}
    (out / f"warp_{task}.json").write_text(json.dumps(plain(found)), encoding="utf-8")
    print(task, found, flush=True)


def _note(file: Path, job: Run, done: Any) -> None:
    """Add a record as of ``trials.jsonl``; of an exception, its error."""
    failed = isinstance(done, Exception)
    record = {
        "key": job.key,
        "group": PLANNER,
        "context": job.world,
        "agrees": not failed and done.agrees,
        "attempts": [] if failed else done.attempts,
        "error": repr(done) if failed else None,
        "extra": {} if failed else done.extra,
    }
    with file.open("a", encoding="utf-8") as lines:
        lines.write(json.dumps(plain(record)) + "\n")

"""Step worlds of the reduced drive with MuJoCo Warp on a GPU: the same verdicts as with MuJoCo, and how fast.

    python scripts/gpu.py                                        # rates and verdicts on cuda:0, in minutes
    python scripts/gpu.py verdicts --device cpu --tasks strip --trials 1

*rates*: the commands and motor limits of a trial are recorded with MuJoCo and replayed in many worlds at once: physics
alone. *verdicts*: trials of ``craftsim validate`` of the six tasks with mild randomization, once with MuJoCo and once
with MuJoCo Warp in place of ``mj_step``; sensors, control laws and judge are the same code, on one core for all trials
of a task, whose worlds step together. Each starts where MuJoCo has let it come to rest. MuJoCo Warp computes in single
precision. Nothing sleeps on either side, unless a row says so. The report is of all that the output folder has, and
``--store`` writes docs/results/gpu.json of it, for docs/explanation/drives.md.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from statistics import median
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
from craftsim.validation.rollout import Run, do_run
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
WHOLE: Final = 64
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
    ):
        """Do what craftsim.models.effects.turn_motors does, for gears without backlash."""
        world, wheel = wp.tid()
        at = places[wheel]
        turned = wp.quat(qpos[world, at + 4], qpos[world, at + 5], qpos[world, at + 6], qpos[world, at + 3])
        push = wp.quat_rotate(turned, wp.vec3(own[wheel][0], own[wheel][1], 0.0))
        row = wp.spatial_vector(push[0], push[1], push[2], 0.0, 0.0, own[wheel][2])
        gear[world, motors[wheel][0]] = row
        gear[world, motors[wheel][1]] = row

    @wp.kernel
    def count(
        iterations: wp.array(dtype=int),
        limit: int,
        steps: wp.array(dtype=int),
        capped: wp.array(dtype=int),
        most: wp.array(dtype=int),
    ):
        world = wp.tid()
        steps[world] += 1
        most[world] = wp.max(most[world], iterations[world])
        if iterations[world] >= limit:
            capped[world] += 1

    @wp.kernel
    def command(
        start: wp.array(dtype=int),
        steps: wp.array(dtype=int),
        commands: wp.array2d(dtype=float),
        limits: wp.array2d(dtype=wp.vec2),
        ctrl: wp.array2d(dtype=float),
        forcerange: wp.array2d(dtype=wp.vec2),
    ):
        world, motor = wp.tid()
        now = start[world] + steps[world]
        ctrl[world, motor] = commands[now, motor]
        forcerange[world, motor] = limits[now, motor]

    return SimpleNamespace(turn=turn, count=count, command=command)


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
        self.data = mjw.make_data(first.model, n, nconmax=contacts, nccdmax=contacts // 2, njmax=rows)
        first.model.tree_sleep_policy[:] = policies
        for name in (*VARIED, "gravity"):
            values = [getattr(one.model.opt if name == "gravity" else one.model, name) for one in physics]
            place = self.model.opt if name == "gravity" else self.model
            setattr(place, name, _array(values, n, getattr(place, name).dtype))
        _, (_, places, wheels, _) = effects_of(first, IDEAL)
        pairs = np.column_stack([wheels["motor"], wheels["gear"]])
        own = np.ascontiguousarray(wheels["own_gear"][:, [0, 1, 5]])
        self._turn = (
            wp.array(places, dtype=int),
            wp.array(pairs, dtype=wp.vec2i),
            wp.array(own, dtype=wp.vec3),
        )
        self.steps, self.capped, self.most = (wp.zeros(n, dtype=int) for _ in range(3))
        # Kernels are loaded before a graph is captured.
        self.step()
        self.begin({name: [getattr(one.data, name) for one in physics] for name in STATE})

    def begin(self, state: Mapping[str, Any]) -> None:
        """Begin in a state, arrays (n or 1, size) by MuJoCo's names."""
        for name, values in state.items():
            array = getattr(self.data, name)
            array.assign(_array(values, len(array), array.dtype))
        for counted in (self.steps, self.capped, self.most, self.data.overflow):
            counted.zero_()

    def step(self) -> None:
        """Run one physics step."""
        own, model, data = kernels(), self.model, self.data
        places, motors, gears = self._turn
        wp.launch(
            own.turn, (data.nworld, len(places)), [data.qpos, places, motors, gears, model.actuator_gear]
        )
        mjw.step(model, data)
        counted = [data.solver_niter, model.opt.iterations, self.steps, self.capped, self.most]
        wp.launch(own.count, data.nworld, counted)

    def captured(self, work: Callable[[], None]) -> Callable[[], None]:
        """Return what launches the kernels that some work launches: on a GPU as a graph."""
        if not wp.get_device().is_cuda:
            return work
        with wp.ScopedCapture() as capture:
            work()
        return partial(wp.capture_launch, capture.graph)

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
        self._stopped, self._turn = False, threading.Lock()
        self._threads = [
            threading.Thread(target=self._try, args=(place, job, note), daemon=True)
            for place, job in enumerate(jobs)
        ]

    def _try(self, place: int, job: Run, note: Callable[[Run, Any], None]) -> None:
        def where(*terms: Any) -> Judge:
            judge = set_up(*terms)
            self._worlds[place] = judge.physics
            self._ask(place, 0)
            judge.physics._stepping = SimpleNamespace(run=partial(self._step, place, judge.physics))
            return judge

        # One at a time: what is compiled for all is not made for threads.
        with self._turn:
            try:
                note(job, do_run(replace(job, set_up=where)))
            except Exception as error:
                note(job, error)
        self._requests.put((place, -1))

    def _ask(self, place: int, n_steps: int) -> None:
        self._answers[place].clear()
        self._turn.release()
        self._requests.put((place, n_steps))
        self._answers[place].wait()
        self._turn.acquire()
        if self._stopped:
            raise TimeoutError("out of time")

    def _step(self, place: int, physics: PhysicsWorld, n_steps: int) -> int:
        """Do what craftsim.models.stepping.Stepping.run does."""
        if not n_steps:
            return 0
        self._ask(place, n_steps)
        return self._mirror.show(physics, n_steps)

    def serve(self, until: float) -> dict[str, Any]:
        """Step until all trials have ended, or it is that time; return figures of the steps."""
        for thread in self._threads:
            thread.start()
        left: dict[int, int] = {}
        live, mirror, n_steps, device_s, began_s = len(self._threads), None, 0, 0.0, time.perf_counter()
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
            elif mirror is None:
                self._mirror = mirror = _Mirror([world for world in self._worlds if world is not None])
                began_s = time.perf_counter()
            else:
                number, now_s = min(left.values()), time.perf_counter()
                mirror.advance(number)
                device_s += time.perf_counter() - now_s
                n_steps += number * live
                left = {place: wanted - number for place, wanted in left.items()}
            for place in [place for place, wanted in left.items() if self._stopped or not wanted]:
                del left[place]
                self._answers[place].set()
        found = {"steps": n_steps, "seconds": time.perf_counter() - began_s, "device_s": device_s}
        return found | (mirror.worlds.figures() if mirror else {"overflows": []})


class _Mirror:
    """Worlds on a device, and what is read of them in MuJoCo's own data."""

    def __init__(self, worlds: Sequence[PhysicsWorld]) -> None:
        contacts, rows = (2 * max(getattr(one.data, name) for one in worlds) for name in ("ncon", "nefc"))
        self.worlds, self._physics = DeviceWorlds(worlds, len(worlds), contacts + 40, rows + 100), worlds
        self._step = self.worlds.captured(self.worlds.step)
        data, pinned = self.worlds.data, wp.get_device().is_cuda
        self._read = [getattr(data, name) for name in READ]
        contact = data.contact
        self._read += [contact.worldid, contact.type, contact.geom, contact.frame, contact.dist]
        self._read += [contact.efc_address, data.efc.force, data.nacon, self.worlds.capped]
        self._host = [wp.empty_like(array, device="cpu", pinned=pinned) for array in self._read]
        self._seen = [array.numpy() for array in self._host]
        self._row = {id(physics): row for row, physics in enumerate(worlds)}
        self._capped = np.zeros(len(worlds), int)

    def advance(self, n_steps: int) -> None:
        """Take motors' commands and limits of all worlds, step, and read."""
        ctrl = np.array([one.data.ctrl for one in self._physics], np.float32)
        limits = np.array([one.model.actuator_forcerange for one in self._physics], np.float32)
        self.worlds.data.ctrl.assign(ctrl)
        self.worlds.model.actuator_forcerange.assign(limits)
        for _ in range(n_steps):
            self._step()
        for own, array in zip(self._host, self._read, strict=True):
            wp.copy(own, array)
        wp.synchronize_device()

    def show(self, physics: PhysicsWorld, n_steps: int) -> int:
        """Write what was read of a world into its MjData; return in how many steps the solver gave up."""
        data, seen, row = physics.data, self._seen, self._row[id(physics)]
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
        contact.geom1[:], contact.geom2[:] = geoms[mine].T
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
            self.first, self.stepping = physics.save(), physics._stepping
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
        self.positions = np.array([*self.states["qpos"], self.physics.data.qpos])
        self.n_steps, self.contacts, self.rows = len(steps), int(contacts.max()), int(rows.max())

    def mujoco_rate(self, seconds: float) -> float:
        """Replay on one core for so long, the whole trial again and again; return physics steps a CPU second."""
        physics, rounds, began = self.physics, 0, time.process_time()
        while not rounds or time.process_time() - began < seconds:
            physics.restore(self.first)
            for ctrl in self.ctrl[:: physics.config.steps_per_period]:
                physics.data.ctrl[:] = ctrl
                physics.advance()
            rounds += 1
        rate = rounds * self.n_steps / (time.process_time() - began)
        if (physics.data.qpos != self.positions[-1]).any():
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
    physics.restore(recording.first)
    worlds = DeviceWorlds([physics], n_worlds, 2 * recording.contacts + 40, recording.rows + 40)
    starts = np.linspace(0, recording.n_steps - n_steps, n_worlds).astype(int)
    commands = wp.array(recording.ctrl.astype(np.float32), dtype=float)
    limits = wp.array(recording.limits.astype(np.float32), dtype=wp.vec2)
    places = wp.array(starts, dtype=int), worlds.steps
    given = [*places, commands, limits, worlds.data.ctrl, worlds.model.actuator_forcerange]

    def step() -> None:
        wp.launch(kernels().command, (n_worlds, commands.shape[1]), given)
        worlds.step()

    launch = worlds.captured(step)
    launch()
    worlds.begin({name: values[starts] for name, values in recording.states.items()})
    wp.synchronize_device()
    began = time.perf_counter()
    for _ in range(n_steps):
        launch()
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
    far = np.abs(qpos - recording.positions[starts + n_steps])[:, physics.pose_places[:, :3]].max(axis=(1, 2))
    found |= {"median_off_m": float(np.median(far)), "most_off_m": float(far.max())}
    if n_steps == recording.n_steps:
        wanted, read = recording.grid(recording.positions[-1]), [recording.grid(row) for row in qpos]
        same = [not one.problems and one.grid.same_visible(wanted.grid) for one in read]
        found["equal"] = sum(same)
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
        "mujoco_a_second": recording.mujoco_rate(1.0),
        "mujoco_asleep_a_second": Recording(task, asleep).mujoco_rate(1.0),
        "replays": [],
    }
    file = out / f"rates_{task}.json"
    for n in worlds:
        file.write_text(json.dumps(plain(found)), encoding="utf-8")
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


def with_mujoco(task: str, first: int, after: int, until: float, out: Path) -> None:
    """Carry out trials of a task with MuJoCo, a line for each in a file."""
    for job in jobs_of(task, after, own_setup())[first:]:
        if time.time() < until:
            _note(out / f"mujoco_{task}.jsonl", job, do_run(job))


def with_warp(task: str, trials: int, device: str, until: float, out: Path) -> None:
    """Do so with MuJoCo Warp, all at once."""
    file = out / f"warp_{task}.jsonl"
    with wp.ScopedDevice(device):
        trials_at_once = Lockstep(jobs_of(task, trials, own_setup()), lambda *of: _note(file, *of))
        found = trials_at_once.serve(until)
    found["worlds"] = trials
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
    # A line at once: other processes write there.
    with file.open("ab", buffering=0) as lines:
        lines.write(f"{json.dumps(plain(record))}\n".encode())


def main() -> int:
    """Run, compare, print and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("part", nargs="?", choices=("all", "rates", "verdicts", "report"), default="all")
    parser.add_argument(
        "--tasks", nargs="+", choices=TASK_NAMES, help="rates: of two and four cars; verdicts: all six"
    )
    parser.add_argument("--trials", type=int, default=10, help="of each task")
    parser.add_argument("--worlds", type=int, nargs="+", default=[1, 64, 1024, 4096, 16384])
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--processes", type=int, default=len(TASK_NAMES))
    parser.add_argument(
        "--seconds", type=float, default=3600, help="begin nothing afterwards, and stop trials"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "gpu")
    parser.add_argument("--store", action="store_true", help=f"write {STORED.relative_to(ROOT)}")
    asked = parser.parse_args()
    until = time.time() + asked.seconds
    asked.out.mkdir(parents=True, exist_ok=True)
    try:
        if asked.part != "report":
            kernels()
            if asked.device not in (known := [device.alias for device in wp.get_devices()]):
                raise InputError(f"there is no device {asked.device}; there are {', '.join(known)}")
            name = f"{asked.device}: {wp.get_device(asked.device).name}"
            made_with = versions() | {key: version(key) for key in ("mujoco-warp", "warp-lang")}
            described = {"device": name, "trials": asked.trials, "versions": made_with}
            (asked.out / "device.json").write_text(json.dumps(described), encoding="utf-8")
        if asked.part in ("all", "rates"):
            for task in asked.tasks or RATED:
                rates(task, asked.worlds, asked.device, until, asked.out)
        if asked.part in ("all", "verdicts"):
            verdicts(asked.tasks or TASK_NAMES, asked, until)
        stored = gather(asked.out)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if asked.store:
        STORED.write_text(json.dumps(plain(stored), indent=1) + "\n", encoding="utf-8")
    differing = sum(one["differing"] for one in stored["verdicts"].values())
    words = f"{differing} of {sum(one['actions'] for one in stored['verdicts'].values())} actions differ."
    tables = [DataTable(numbers(*head), rows) for head, *rows in (verdict_table(stored), rate_table(stored))]
    return Report(
        "MuJoCo Warp",
        f"Reduced drive, {stored['device']}",
        Headline(
            "Differs" if differing else "No difference", Tone.CAUTION if differing else Tone.GOOD, words
        ),
        sections=[Section("gpu", "MuJoCo Warp", "Verdicts; rates.", tables, True)],
        notes=notes_of(stored),
        document=document(stored, command="gpu", seed=0, config={"trials": stored["trials"]}),
        exit_code=int(bool(differing)),
    ).publish(asked.out)


def verdicts(tasks: Sequence[str], asked: argparse.Namespace, until: float) -> None:
    """Carry out the trials of tasks in processes, first with MuJoCo."""
    for file in asked.out.glob("*.jsonl"):
        file.unlink()
    at_once = 5
    with ProcessPoolExecutor(asked.processes, multiprocessing.get_context("spawn")) as pool:
        work = [
            pool.submit(with_mujoco, task, first, min(first + at_once, asked.trials), until, asked.out)
            for first in range(0, asked.trials, at_once)
            for task in tasks
        ]
        work += [pool.submit(with_warp, task, asked.trials, asked.device, until, asked.out) for task in tasks]
        for one in work:
            if error := one.exception():
                print(f"error: {error!r}", file=sys.stderr, flush=True)


def gather(out: Path) -> dict[str, Any]:
    """Return what a folder has: figures of rates and of verdicts by task. Raises InputError where it has none."""
    if not (out / "device.json").exists():
        raise InputError(f"nothing has run in {out}; leave out 'report'")
    stored: dict[str, Any] = _read(out / "device.json") | {"rates": {}, "verdicts": {}}
    for task in TASK_NAMES:
        if (file := out / f"rates_{task}.json").exists():
            stored["rates"][task] = _read(file)
        runs = [out / f"{side}_{task}.jsonl" for side in ("mujoco", "warp")]
        if all(run.exists() for run in runs):
            records = [[json.loads(line) for line in run.open(encoding="utf-8")] for run in runs]
            closed = out / f"warp_{task}.json"
            stored["verdicts"][task] = _compared(*records) | {
                "loop": _read(closed) if closed.exists() else {}
            }
    return stored


def _read(file: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return found


def _compared(first: list[Any], other: list[Any]) -> dict[str, Any]:
    """Return how the trials of a task went with MuJoCo and with MuJoCo Warp."""
    pairs, actions = compare_paired(first, other), alike(first, other)
    spans = [
        {one["key"]: one["extra"]["makespan_s"] for one in run if not one["error"]} for run in (first, other)
    ]
    both = [key for key in spans[0] if key in spans[1]]
    paired = [[one for one in run if one["key"] in both] for run in (first, other)]
    ratios = [spans[1][key] / spans[0][key] for key in both]
    return {
        "trials": pairs.pairs,
        "as_predicted": [
            sum(act["result"] == Verdict.AS_PREDICTED for one in run for act in one["attempts"])
            for run in paired
        ],
        "actions": actions.actions,
        "differing": actions.actions - actions.as_predicted_alike,
        "differences": list(map(dict, actions.differences)),
        "makespan_ratios": [min(ratios), median(ratios), max(ratios)] if ratios else [],
        "errors": sorted({str(one["error"]) for run in (first, other) for one in run if one["error"]}),
    }


def notes_of(stored: dict[str, Any]) -> list[str]:
    """Return how replays ended, and what was not as it should be."""
    found, every = [], [(task, one["loop"]) for task, one in stored["verdicts"].items() if one["loop"]]
    for task, of in stored["rates"].items():
        for one in of["replays"]:
            every.append((task, one))
            off = (
                f"{1e3 * one['median_off_m']:.2g} mm at the median, {1e3 * one['most_off_m']:.2g} mm at most"
            )
            found.append(f"{task}, {one['worlds']} worlds: after {one['steps']} steps of replay off by {off}")
        found += [f"{task}: {of['why']}"] if "why" in of else []
    for task, one in every:
        if one["overflows"]:
            found.append(f"{task}, {one['worlds']} worlds: {', '.join(one['overflows'])} in some step")
    for task, one in stored["verdicts"].items():
        found += [f"{task}: {error}" for error in one["errors"]]
        found += [
            f"{task}: {of['actions']} {of['kind']}: such as {of['example']}" for of in one["differences"]
        ]
    return found


def verdict_table(stored: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return the table of actions as predicted, its head first."""
    rows = [("task", "MuJoCo", "Warp", "differing", "makespans")]
    for task, one in stored["verdicts"].items():
        counts = (f"{n}/{one['actions']}" for n in one["as_predicted"])
        ratios = "-".join(f"{ratio:.3f}" for ratio in one["makespan_ratios"][::2])
        rows.append((task, *counts, str(one["differing"]), ratios))
    return rows


def rate_table(stored: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return the table of joint steps a second of physics, and what belongs to it, its head first."""
    rated = stored["rates"]
    rows: dict[tuple[str, str], dict[str, str]] = {}
    for task, of in rated.items():
        loop = stored["verdicts"].get(task, {}).get("loop")
        rates = [
            ("MuJoCo", 1, of["mujoco_asleep_a_second"]),
            ("nothing asleep", 1, of["mujoco_a_second"]),
        ]
        rates += [("Warp", one["worlds"], one["steps_a_second"]) for one in of["replays"]]
        rates += [("closed loop", loop["worlds"], loop["steps"] / loop["seconds"])] if loop else []
        for name, worlds, rate in rates:
            joint = f"{rate * of['joint_steps'] / of['steps']:,.0f}"
            rows.setdefault((name, f"{worlds:,}"), {})[task] = joint
        for one in of["replays"]:
            if one.get("equal") is not None and one["worlds"] > 1:
                rows.setdefault(("end as MuJoCo's", f"{one['worlds']:,}"), {})[task] = f"{one['equal']:,}"
        rows.setdefault(("physics steps each", ""), {})[task] = f"{of['steps'] / of['joint_steps']:.0f}"
    cells = [(*name, *(of.get(task, "") for task in rated)) for name, of in rows.items()]
    return [("joint steps/s", "worlds", *rated), *cells]


if __name__ == "__main__":
    sys.exit(main())

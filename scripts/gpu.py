"""Carry out trials of the reduced drive with MuJoCo Warp on a GPU or a CPU: are the verdicts those of MuJoCo?

    python scripts/gpu.py                                # on cuda:0, in minutes
    python scripts/gpu.py --device cpu --tasks strip --trials 1

Trials of ``craftsim validate`` of the six tasks with mild randomization, once with MuJoCo and once with MuJoCo Warp in
place of ``mj_step``; sensors, control laws and judge are the same code, on one core for all trials of a task, whose
worlds step together. Each starts where MuJoCo has let it come to rest. MuJoCo Warp computes in single precision.
Nothing sleeps on either side. The report is of all that the output folder has.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import queue
import sys
import threading
import time
from collections.abc import Callable, Sequence
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
PIP: Final = "pip install mujoco-warp==3.17.0 warp-lang==1.19.0"
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
        """Do what craftsim.models.effects.turn_motors does, for gears without backlash and wheels that turn."""
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

    return SimpleNamespace(turn=turn, count=count)


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
        for name in STATE:
            array = getattr(self.data, name)
            array.assign(_array([getattr(one.data, name) for one in physics], n, array.dtype))
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
    """Run, compare and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("part", nargs="?", choices=("report",), help="compare what has run")
    parser.add_argument("--tasks", nargs="+", choices=TASK_NAMES, default=TASK_NAMES)
    parser.add_argument("--trials", type=int, default=10, help="of each task")
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--processes", type=int, default=len(TASK_NAMES))
    parser.add_argument(
        "--seconds", type=float, default=3600, help="begin nothing afterwards, and stop trials"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "gpu")
    asked = parser.parse_args()
    until = time.time() + asked.seconds
    asked.out.mkdir(parents=True, exist_ok=True)
    try:
        if asked.part is None:
            kernels()
            if asked.device not in (known := [device.alias for device in wp.get_devices()]):
                raise InputError(f"there is no device {asked.device}; there are {', '.join(known)}")
            name = f"{asked.device}: {wp.get_device(asked.device).name}"
            made_with = versions() | {key: version(key) for key in ("mujoco-warp", "warp-lang")}
            described = {"device": name, "trials": asked.trials, "versions": made_with}
            (asked.out / "device.json").write_text(json.dumps(described), encoding="utf-8")
            verdicts(asked.tasks, asked, until)
        stored = gather(asked.out)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    differing = sum(one["differing"] for one in stored["verdicts"].values())
    words = f"{differing} of {sum(one['actions'] for one in stored['verdicts'].values())} actions differ."
    head, *rows = verdict_table(stored)
    return Report(
        "MuJoCo Warp",
        f"Reduced drive, {stored['device']}",
        Headline(
            "Differs" if differing else "No difference", Tone.CAUTION if differing else Tone.GOOD, words
        ),
        sections=[Section("gpu", "MuJoCo Warp", "Verdicts.", [DataTable(numbers(*head), rows)], True)],
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
    """Return the verdicts by task that a folder has. Raises InputError where it has none."""
    if not (out / "device.json").exists():
        raise InputError(f"nothing has run in {out}; leave out 'report'")
    stored: dict[str, Any] = _read(out / "device.json") | {"verdicts": {}}
    for task in TASK_NAMES:
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
    """Return what was not as it should be."""
    found = []
    for task, one in stored["verdicts"].items():
        if overflows := one["loop"].get("overflows"):
            found.append(f"{task}: {', '.join(overflows)} in some step")
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


if __name__ == "__main__":
    sys.exit(main())

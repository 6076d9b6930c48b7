"""Run a campaign and a training on a Ray cluster of two nodes: kill a node on the way, then the run, and resume it.

    python scripts/campaign.py                     # 100,000 trials, and a training in physics
    python scripts/campaign.py --trials 2000
    python scripts/campaign.py --trials 0          # the training alone

A trial is an episode of random legal play on the grid, so short that the campaign itself is measured. The same trials
run in one local process, too; both must have equal records, with no trial lost or done twice. The training, too, must
come to the curve and the policy of a local one. Figures: docs/results/campaign.json.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from functools import cache
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from measure_results import revision

from craftsim.cli.bench import pick
from craftsim.experiments.experiment import Experiment, Result, RunOptions, Trial
from craftsim.experiments.records import TRIALS_FILE
from craftsim.experiments.session import run_experiment
from craftsim.learning.curve import CURVE_FILE
from craftsim.learning.policy_files import POLICY_FILE
from craftsim.reports.json_file import versions
from craftsim.tasks import make_task
from craftsim.tasks.episodes import Episodes

ROOT: Final = Path(__file__).parents[1]
STORED: Final = ROOT / "docs" / "results" / "campaign.json"
TASK, TICKS = "complex_two_story", 10
BATCH: Final = 20
"""Trials sent to a worker together."""
NODE_DIES, CAMPAIGN_DIES = 0.3, 0.6
"""Parts of the trials that are done when a node and the campaign are killed."""
EVALUATIONS: Final = 6
TRAIN: Final = (
    *(
        "train",
        "strip",
        "--backend",
        "physics",
        "--steps",
        str(EVALUATIONS * 1024),
        "--until",
        "1",
        "--episodes",
        "20",
    ),
    *(
        "--worlds",
        "4",
        "--width",
        "32",
        "--evaluate-every",
        "1024",
        "--evaluation-episodes",
        "8",
        "--workers",
        "2",
    ),
)
"""The training that goes through Ray, too."""
SAMPLE: Final = 1000
"""Trials of which the CPU time is measured by itself."""


@cache
def world() -> Episodes:
    """Return the world in which a worker plays."""
    return Episodes(make_task(TASK), np.random.default_rng(0))


def play(seed: int) -> Result:
    """Play an episode; it agrees if nothing that was offered is refused."""
    episodes = world()
    episodes.rng = np.random.default_rng(seed)
    episodes.reset()
    refused = 0
    for _ in range(TICKS):
        actions = pick(episodes.rng, episodes.legal())
        # One car after the other: what an earlier one does may forbid what a later one was offered.
        refused += int((~episodes.step(actions).applied[:, 0]).sum())
    end = hashlib.sha256(episodes.grids.cells.tobytes() + episodes.grids.cars.tobytes())
    return Result(True, extra={"refused": refused, "end": end.hexdigest()})


def work(engine: str, out: str, trials: int) -> None:
    """Run or resume the campaign."""
    items = [Trial(f"episode {seed}", TASK, seed, seed) for seed in range(trials)]
    experiment = Experiment("campaign", 0, {"ticks": TICKS}, items, play, batch=BATCH)
    options = RunOptions(
        2 if engine == "ray" else 1, "ray" if engine == "ray" else "local", resume=True
    )
    run_experiment(experiment, Path(out), options)


class Processes:
    """CPU time and memory of all processes that descend from this one, those that have ended included."""

    def __init__(self) -> None:
        """Start with nothing."""
        self.cpu_s: dict[int, float] = {}
        """By process, when it was last seen."""
        self.memory: dict[int, list[int]] = {}
        """Bytes of the campaign and of all processes together, by the number of trials done."""

    def look(self, campaign: int, done: int) -> None:
        """Bring all up to date."""
        memory = {os.getpid(): 0}
        for folder in sorted(Path("/proc").glob("[0-9]*"), key=lambda path: int(path.name)):
            try:
                fields = (folder / "stat").read_text().rpartition(")")[2].split()
            except (FileNotFoundError, ProcessLookupError):
                continue
            if int(fields[1]) in memory:
                memory[int(folder.name)] = int(fields[21]) * os.sysconf("SC_PAGE_SIZE")
                self.cpu_s[int(folder.name)] = sum(map(int, fields[11:13])) / os.sysconf(
                    "SC_CLK_TCK"
                )
        self.memory[done] = [memory.get(campaign, 0), sum(memory.values())]

    def figures(self) -> dict[str, Any]:
        """Return the CPU time of all, and the memory in MB after a tenth and nine tenths of the trials."""
        last, found = max(self.memory), {}
        for place, name in enumerate(("campaign_mb", "together_mb")):
            found[name] = [
                self.memory[min(self.memory, key=lambda done: abs(done - part * last))][place] / 1e6
                for part in (0.1, 0.9)
            ]
        return {"cpu_s": sum(self.cpu_s.values()), **found}


class Run:
    """A process that runs Python code and writes lines of results to a file."""

    def __init__(self, code: str, lines: Path, total: int, address: str = "") -> None:
        """Start it; ``total`` is the number of lines in the end."""
        path = os.pathsep.join(map(str, (Path(__file__).parent.resolve(), ROOT.resolve())))
        environment = os.environ | {
            "RAY_ADDRESS": address,
            "OMP_NUM_THREADS": "1",
            "PYTHONPATH": path,
        }
        self.lines, self.total = lines, total
        self.process = subprocess.Popen([sys.executable, "-P", "-c", code], env=environment)

    def until(self, part: float, processes: Processes) -> int:
        """Wait for a part of the lines, or the process to end; return its exit status, 0 while it runs."""
        while self.process.poll() is None:
            processes.look(self.process.pid, done := self.done)
            print(f"{done} of {self.total}", flush=True)
            if done >= part * self.total and part < 1:
                return 0
            time.sleep(1.0)
        return self.process.returncode

    def kill(self) -> int:
        """Kill it; return how many lines it has left."""
        self.process.kill()
        self.process.wait()
        return self.done

    @property
    def done(self) -> int:
        """Number of lines in the file."""
        return self.lines.read_bytes().count(b"\n") if self.lines.exists() else 0


class TwoNodes:
    """Context manager of a Ray cluster of two nodes with a processor each."""

    def __enter__(self) -> Self:
        """Start it."""
        from ray.cluster_utils import Cluster

        self._cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
        self._nodes = [self._cluster.add_node(num_cpus=1) for _ in range(2)]
        self.address: str = self._cluster.address
        return self

    def lose(self) -> None:
        """Kill a node."""
        self._cluster.remove_node(self._nodes.pop(), allow_graceful=False)

    def add(self) -> None:
        """Add a node."""
        self._nodes.append(self._cluster.add_node(num_cpus=1))

    def __exit__(self, *_: object) -> None:
        """Stop it."""
        self._cluster.shutdown()


def campaign_on(engine: str, out: Path, trials: int, address: str = "") -> Run:
    """Start or resume the campaign."""
    code = f"import campaign; campaign.work({engine!r}, {str(out)!r}, {trials})"
    return Run(code, out / TRIALS_FILE, trials, address)


def on_cluster(out: Path, trials: int) -> dict[str, Any]:
    """Run the campaign on a cluster that loses a node, kill and resume it; return what that took."""
    processes, began_s = Processes(), time.monotonic()
    with TwoNodes() as nodes:
        campaign = campaign_on("ray", out, trials, nodes.address)
        status = campaign.until(NODE_DIES, processes)
        nodes.lose()
        status = status or campaign.until(CAMPAIGN_DIES, processes)
        kept = campaign.kill()
        nodes.add()
        status = status or campaign_on("ray", out, trials, nodes.address).until(1, processes)
        took_s = time.monotonic() - began_s
    if status:
        sys.exit("the campaign failed")
    return {"kept": kept, "clock_s": took_s, **processes.figures()}


def in_one_process(out: Path, trials: int) -> dict[str, Any]:
    """Run the campaign in one local worker; return what that took."""
    processes, began_s = Processes(), time.monotonic()
    if campaign_on("local", out, trials).until(1, processes):
        sys.exit("the campaign failed")
    return {"clock_s": time.monotonic() - began_s, **processes.figures()}


def training_on(engine: str, out: Path, address: str = "") -> Run:
    """Start or resume the training; it saves at every evaluation, each a line of the learning curve."""
    words = [*TRAIN, "--engine", engine, "--out", str(out), "--resume"]
    return Run(
        f"from craftsim.cli import main; raise SystemExit(main({words}))",
        out / CURVE_FILE,
        EVALUATIONS + 1,
        address,
    )


def training(out: Path) -> dict[str, Any]:
    """Train on a cluster that loses a node, and is killed; resume it twice, compare it with a local training."""
    found: dict[str, Any] = {}
    processes, began_s = Processes(), time.monotonic()
    with TwoNodes() as nodes:
        run = training_on("ray", out / "ray", nodes.address)
        status = run.until(NODE_DIES, processes)
        nodes.lose()
        found["status_without_node"] = status or run.until(1, processes)
        nodes.add()
        run = training_on("ray", out / "ray", nodes.address)
        status = run.until(CAMPAIGN_DIES, processes)
        found["kept"] = run.kill() - 1
        status = status or training_on("ray", out / "ray", nodes.address).until(1, processes)
        found["ray"] = {
            "clock_s": time.monotonic() - began_s,
            "cpu_s": processes.figures()["cpu_s"],
        }
    processes, began_s = Processes(), time.monotonic()
    status = status or training_on("local", out / "local").until(1, processes)
    if status:
        sys.exit("a training failed")
    found["local"] = {"clock_s": time.monotonic() - began_s, "cpu_s": processes.figures()["cpu_s"]}
    both = [
        [(out / engine / name).read_bytes() for name in (CURVE_FILE, POLICY_FILE)]
        for engine in ("ray", "local")
    ]
    report = json.loads((out / "ray" / "report.json").read_text(encoding="utf-8"))
    found["steps"], found["evaluations"] = report["figures"]["steps"], EVALUATIONS
    return found | {"equal": both[0] == both[1]}


def records(out: Path) -> list[dict[str, Any]]:
    """Return the records of a run."""
    return [
        json.loads(line) for line in (out / TRIALS_FILE).read_text(encoding="utf-8").splitlines()
    ]


def trial_s() -> float:
    """Return the CPU time of a trial without a campaign."""
    play(0)
    began_s = time.process_time()
    for seed in range(SAMPLE):
        play(seed)
    return (time.process_time() - began_s) / SAMPLE


def store(found: dict[str, Any]) -> None:
    """Store the figures."""
    STORED.write_text(
        json.dumps(found | {"revision": revision()}, indent=1, sort_keys=True) + "\n",
        encoding="utf-8",
    )


def main() -> int:
    """Run both, compare the records, print and store the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=100_000)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "campaign")
    asked = parser.parse_args()
    shutil.rmtree(asked.out, ignore_errors=True)
    trained = training(asked.out / "training")
    print(json.dumps(trained, indent=1))
    if not asked.trials:
        store(json.loads(STORED.read_text(encoding="utf-8")) | {"training": trained})
        return 0 if trained["equal"] else 1
    own_s = trial_s()
    found: dict[str, Any] = {"trials": asked.trials, "trial_s": own_s, "versions": versions()}
    found["training"] = trained
    found["ray"] = on_cluster(asked.out / "ray", asked.trials)
    found["local"] = in_one_process(asked.out / "local", asked.trials)
    both = [records(asked.out / engine) for engine in ("ray", "local")]
    found["distinct"] = len({record["key"] for record in both[0]})
    found["equal"] = both[0] == both[1]
    found["errors"] = sum(record["error"] is not None for record in both[0])
    for engine in ("ray", "local"):
        found[engine]["overhead_s"] = found[engine]["cpu_s"] / asked.trials - own_s
    print(json.dumps(found, indent=1))
    if asked.trials == parser.get_default("trials"):
        store(found)
    complete = found["distinct"] == asked.trials and not found["errors"]
    return 0 if complete and found["equal"] and trained["equal"] else 1


if __name__ == "__main__":
    sys.exit(main())

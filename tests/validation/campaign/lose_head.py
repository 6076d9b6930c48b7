"""A campaign on a Ray cluster of this machine whose head is killed on the way: lose_head.py OUT."""

import os
import signal
import sys
from contextlib import nullcontext
from pathlib import Path

import cheap_work
from ray.cluster_utils import Cluster

from craftsim.errors import InputError
from craftsim.experiments.experiment import RunOptions
from craftsim.experiments.session import run_experiment

N_ITEMS = 14


def items(out: Path):
    """Return items that take long while the campaign's folder says so."""
    return cheap_work.items(
        N_ITEMS, **{f"i{i}": ("slow while", out / "slow") for i in range(10, N_ITEMS)}
    )


def main(out: Path) -> None:
    """Run the campaign until it says that the cluster is gone."""
    nodes = Cluster(
        initialize_head=True, head_node_args={"num_cpus": 2, "include_dashboard": False}
    )
    os.environ["RAY_ADDRESS"] = nodes.address

    out.joinpath("slow").touch()

    def kill_head(record):
        if sum(1 for _ in (out / "trials.jsonl").open()) == 10:
            for infos in nodes.head_node.all_processes.values():
                for info in infos:
                    os.kill(info.process.pid, signal.SIGKILL)

    try:
        options = RunOptions(2, "ray", progress=lambda total: nullcontext(kill_head))
        run_experiment(cheap_work.experiment(items(out)), out, options)
    except InputError as error:
        print(error)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

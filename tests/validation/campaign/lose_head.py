"""A campaign on a Ray cluster of this machine whose head is killed on the way: lose_head.py OUT."""

import os
import signal
import sys
from pathlib import Path

import cheap_work
from ray.cluster_utils import Cluster

from craftsim.errors import InputError
from craftsim.validation.campaign import Header, run_campaign

HEADER = Header("ray", 0, {})
ITEMS = cheap_work.items(200, **{f"i{i}": "slow" for i in range(200)})


def main(out: Path) -> None:
    """Run the campaign until it says that the cluster is gone."""
    nodes = Cluster(initialize_head=True, head_node_args={"num_cpus": 2, "include_dashboard": False})
    os.environ["RAY_ADDRESS"] = nodes.address

    def kill_head(record):
        if sum(1 for _ in (out / "trials.jsonl").open()) == 10:
            for infos in nodes.head_node.all_processes.values():
                for info in infos:
                    os.kill(info.process.pid, signal.SIGKILL)

    try:
        run_campaign(ITEMS, cheap_work.work, out, HEADER, workers=2, engine="ray", on_record=kill_head)
    except InputError as error:
        print(error)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

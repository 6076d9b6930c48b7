"""On a real Ray cluster of two nodes a campaign gives the same as on this machine."""

import cheap_work
import pytest

from craftsim.discrete.errors import InputError
from craftsim.validation.campaign import Header, run_campaign

ray = pytest.importorskip("ray", reason="the extra 'ray' is not installed")
HEADER = Header("ray", 0, {})


@pytest.fixture
def cluster(monkeypatch):
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    from ray.cluster_utils import Cluster

    nodes = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    nodes.add_node(num_cpus=1)
    monkeypatch.setenv("RAY_ADDRESS", nodes.address)
    yield nodes
    ray.shutdown()
    nodes.shutdown()


def test_records_are_those_of_local_workers_whatever_goes_wrong(tmp_path, cluster):
    faults = {"i3": "raise", "i5": "die", "i9": "hang"}
    faults = {**faults, "i7": ("die once", tmp_path / "died")}
    items = cheap_work.items(12, **faults)
    records = run_campaign(
        items, cheap_work.work, tmp_path / "ray", HEADER, workers=2, engine="ray", timeout_s=1, batch=2
    )
    assert [record["error"] is None for record in records] == [i not in (3, 5, 9) for i in range(12)]
    (tmp_path / "died").unlink()
    local = run_campaign(items, cheap_work.work, tmp_path / "local", HEADER, workers=2, timeout_s=1)
    assert records == local


def test_without_a_cluster_the_message_says_how_to_start_one(tmp_path, monkeypatch):
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    with pytest.raises(InputError, match="ray start --head"):
        run_campaign(cheap_work.items(1), cheap_work.work, tmp_path, HEADER, engine="ray")

"""A run begins with a policy: it plays as that one does, and in another area what lies alike is seen alike."""

import hashlib
import json

import pytest
import torch
from torch import nn

import craftsim
from craftsim.cli import main
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kernel.tasks import IS_BLOCK, IS_CAR, IS_GOAL, ROW
from craftsim.errors import InputError
from craftsim.training.config import TrainConfig
from craftsim.training.networks import CarNet
from craftsim.training.policy import SHIPPED
from craftsim.training.rollouts import Seen
from craftsim.training.shape import Shape
from craftsim.training.trainer import Trainer


def _net(area):
    net = CarNet(Shape.of(craftsim.designs_task(area=area), 8, "relative"))
    nn.init.normal_(net.head[1][-1].weight)
    return net


def _rated(net, cells):
    """Return how a car rates actions that stands in the first cell, with a block in the second, and one to build."""
    rows = torch.zeros(1, 1, 3, ROW, dtype=torch.long)
    for row, cell, kinds in zip(rows[0, 0], cells, ([IS_CAR], [IS_BLOCK], [IS_BLOCK, IS_GOAL]), strict=True):
        row[:3] = torch.tensor(cell)
        row[kinds] = 1
    with torch.no_grad():
        places = net.encoder.places(rows.flatten(-2))
        return net(Seen(places, torch.ones(1, 1, N_ACTIONS, dtype=torch.bool)))


@pytest.mark.parametrize("area", [(7, 7, 2), (8, 6, 2), (6, 7, 3), (6, 6, 1)])
def test_what_lies_alike_is_seen_alike_in_another_area(area):
    known, net = _net((6, 6, 2)), _net(area)
    net.encoder.take_over(known.encoder, torch.ones(known.encoder.absent + 1, dtype=torch.bool))
    net.head.load_state_dict(known.head.state_dict())
    near = [(1, 1, 1), (2, 1, 1), (1, 3, 1)]
    far = [(4, 4, 1), (4, 3, 1), (2, 4, 1)]
    moved = [(x + area[0] - 6, y + area[1] - 6, z) for x, y, z in far]
    assert torch.allclose(_rated(net, near), _rated(known, near), atol=1e-6)
    assert torch.allclose(_rated(net, moved), _rated(known, far), atol=1e-6)
    assert not torch.allclose(_rated(known, near), _rated(known, far), atol=1e-3)


@pytest.mark.parametrize("name", ["random_strip", "complex_two_story"])
def test_a_run_begins_with_the_policy_and_names_it(name, tmp_path, capsys):
    config = craftsim.load_policy(name).config
    words = ["--network", config.network, "--pretrained", name, "--acting", config.acting]
    asked = ["--task", config.task, "--steps", "1", "--until", "0", "--worlds", "1", "--episodes", "10"]
    assert main(["train", *asked, *words, "--out", str(tmp_path)]) == 0
    told = json.loads((tmp_path / "report.json").read_text())["config"]
    file = SHIPPED / f"{name}.safetensors"
    assert told["pretrained"] == name
    assert told["pretrained_digest"] == hashlib.sha256(file.read_bytes()).hexdigest()
    begun = Trainer(TrainConfig(config.task, network=config.network, pretrained=name)).learner.net
    known = craftsim.load_policy(name).net
    assert all(a.equal(b) for a, b in zip(begun.parameters(), known.parameters(), strict=True))


def test_a_run_that_began_with_a_policy_resumes(goes_on):
    goes_on(TrainConfig("random_strip", worlds=3, network="relative", pretrained="random_simple_two_story"))


@pytest.mark.parametrize(
    ("task", "given", "said"),
    [
        ("random_strip", {"width": 64}, "take the same network and width"),
        ("complex_two_story", {"network": "map"}, "take the same network and width"),
        ("random_strip", {"pretrained": "no_such.safetensors"}, "no_such.safetensors"),
        ("random_strip", {"algo": "qmix"}, "qmix learns values"),
    ],
)
def test_what_cannot_be_taken_over_is_refused(task, given, said):
    with pytest.raises(InputError, match=said):
        Trainer(TrainConfig(task, **{"network": "relative", "pretrained": "random_strip", **given}))

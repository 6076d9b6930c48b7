"""QMIX's mixer begins at a scale at which the cars' values change the team's."""

from dataclasses import replace

import pytest
import torch

from craftsim.training.config import TrainConfig
from craftsim.training.networks import JointNet, OthersNet, QMixer
from craftsim.training.trainer import Trainer

CASES = (("strip", "map"), ("complex_two_story", "map"), ("designs", "relative"))


def _seen(task, network):
    """Return the shape of a task's networks, and observations and masks of its first episodes, played at random."""
    trainer = Trainer(TrainConfig(task, "qmix", worlds=10, network=network))
    played = trainer.play(0)
    return trainer.shape, played.now.flat()


@pytest.fixture(scope="module")
def seen():
    return {case: _seen(*case) for case in CASES}


def _states(mixer, seen):
    with torch.no_grad():
        return mixer.encoder.of_places(seen.places, seen.offers).mean(-2).relu()


def _share(mix, n_cars, state, n):
    """Return by how much the team's value changes with a car's, on average over n states."""
    chosen = torch.zeros(n, n_cars, requires_grad=True)
    (slope,) = torch.autograd.grad(mix(chosen, state).sum(), chosen)
    return float(slope.mean())


@pytest.mark.parametrize("case", CASES)
def test_the_table_of_the_state_begins_as_a_linear_layer_does(case, seen):
    shape = seen[case][0]
    torch.manual_seed(0)
    table, layer = (
        layer.weight.detach() for layer in (QMixer(shape).encoder.table, torch.nn.Linear(shape.places, 2))
    )
    assert table.abs().max() <= shape.places**-0.5
    assert float(table.std()) == pytest.approx(float(layer.std()), rel=0.02)


@pytest.mark.parametrize("case", CASES)
def test_the_team_s_value_rises_at_first_with_a_car_s_as_in_the_published_mixer(case, seen):
    """There one or two linear layers make the weights, of a state whose numbers were divided by their largest."""
    shape, observed = seen[case]
    n = shape.n_cars
    shares = []
    for seed in range(6):
        torch.manual_seed(seed)
        ours = _share(QMixer(shape), n, observed, len(observed.places))
        state, published = 0.3 * torch.randn(2000, 50), QMixer(replace(shape, width=50))
        single = _share(published.mix, n, state, 2000)
        for name, n_out in {"first_weight": 32 * n, "last_weight": 32}.items():
            layers = torch.nn.Linear(50, 64), torch.nn.ReLU(), torch.nn.Linear(64, n_out)
            setattr(published, name, torch.nn.Sequential(*layers))
        shares.append((ours, single, _share(published.mix, n, state, 2000)))
    ours, single, double = torch.tensor(shares).mean(0).tolist()
    assert double / 2 < ours < single


def test_the_size_of_the_state_hardly_depends_on_how_many_things_there_are(seen):
    torch.manual_seed(0)
    sizes = []
    for case in CASES[:2]:
        shape, observed = seen[case]
        sizes.append(float(_states(QMixer(shape), observed).square().mean().sqrt()))
    few, many = sizes
    assert many == pytest.approx(few, rel=0.1)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("kind", [JointNet, OthersNet])
def test_other_networks_of_the_team_begin_with_values_close_to_zero(kind, case, seen):
    shape, observed = seen[case]
    torch.manual_seed(0)
    with torch.no_grad():
        net = kind(shape)
        look = net.state(observed) if kind is JointNet else observed
        values = net(look, observed.offers.long().argmax(-1))
    for of in values if isinstance(values, tuple) else [values]:
        assert of.abs().max() < 0.1

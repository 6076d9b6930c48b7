"""A run that begins with what another one has learnt: on the same task, or on one of another area."""

from __future__ import annotations

import hashlib

import torch

from craftsim.errors import InputError
from craftsim.training.checkpoint import TABLE, read_policy
from craftsim.training.config import WITH_PROBABILITIES, TrainConfig
from craftsim.training.features import RelativeEncoder
from craftsim.training.networks import CarNet, first_net
from craftsim.training.policy import policy_file
from craftsim.training.shape import Shape


def begin_as_pretrained(net: CarNet, shape: Shape, config: TrainConfig) -> str:
    """Let a network begin as the policy that a configuration names; return the digest (SHA-256) of its file.

    What that one has not learnt stays as it is. Networks that look from a car may be for areas of different sizes,
    others are for the same one. Raises InputError for a policy of which nothing can be taken over.
    """
    path = policy_file(config.pretrained)
    head, other = read_policy(path)
    begun, known = head.config, head.shape
    if begun.algo not in WITH_PROBABILITIES:
        raise InputError(
            f"{path}: trained by {begun.algo}, which rates actions by value; allowed: {', '.join(WITH_PROBABILITIES)}"
        )
    learnt = (other.encoder.table.weight != first_net(known, begun.seed).encoder.table.weight).any(-1)
    if known.fits(shape):
        table = torch.where(learnt[:, None], other.encoder.table.weight, net.encoder.table.weight)
        net.load_state_dict({**other.state_dict(), TABLE: table})
    elif (
        isinstance(net.encoder, RelativeEncoder)
        and isinstance(other.encoder, RelativeEncoder)
        and known.width == shape.width
    ):
        net.encoder.take_over(other.encoder, learnt)
        net.head.load_state_dict(other.head.state_dict())
    else:
        raise InputError(
            f"{path}: its network is for {known}, the one to train for {shape}; take the same network and width, and "
            "with 'map' the same area and number of cars"
        )
    return hashlib.sha256(path.read_bytes()).hexdigest()

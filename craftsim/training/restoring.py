"""Tensors from a file, compared with those that they replace."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from craftsim.errors import InputError
from craftsim.storage.limits import LARGEST_WEIGHT


def numbers(
    saved: Any, name: str, like: Tensor, low: float = -LARGEST_WEIGHT, high: float = LARGEST_WEIGHT
) -> Tensor:
    """Return a tensor of the shape and type of ``like``; raise InputError for what is none.

    Its numbers must be within bounds, and so be finite.
    """
    if type(saved) is not Tensor or (saved.shape, saved.dtype, saved.layout) != (
        like.shape,
        like.dtype,
        torch.strided,
    ):
        found = f"{saved.dtype} {tuple(saved.shape)}" if isinstance(saved, Tensor) else type(saved).__name__
        raise InputError(f"'{name}' is {found}; allowed: {like.dtype} {tuple(like.shape)}")
    if saved.numel() and not (low <= float(saved.min()) and float(saved.max()) <= high):
        raise InputError(f"'{name}' has numbers that are not finite, or not from {low:g} to {high:g}")
    return saved


def restore_module(module: nn.Module, saved: Mapping[str, Any]) -> None:
    """Take over weights; settings among its tensors, single numbers, stay as they are. Raises InputError."""
    state = module.state_dict()
    if odd := sorted(set(saved) ^ set(state), key=str):
        raise InputError(f"'{str(odd[0])[:80]}' is missing or unknown among its weights")
    for key, own in state.items():
        if own.ndim and own.is_floating_point():
            state[key] = numbers(saved[key], key, own)
    module.load_state_dict(state)


def restore_adam(optimizer: torch.optim.Optimizer, saved: Mapping[str, Any]) -> None:
    """Take over the averages of Adam or RAdam; its settings stay as they are. Raises InputError."""
    own = optimizer.state_dict()
    parameters = dict(
        enumerate(parameter for group in optimizer.param_groups for parameter in group["params"])
    )
    state = {number: _averages(parameters[number], **found) for number, found in saved["state"].items()}
    optimizer.load_state_dict(own | {"state": state})


def _averages(like: Tensor, step: Any, exp_avg: Any, exp_avg_sq: Any) -> dict[str, Tensor]:
    return {
        "step": numbers(step, "step", torch.zeros(()), 0, 2**31),
        "exp_avg": numbers(exp_avg, "exp_avg", like),
        "exp_avg_sq": numbers(exp_avg_sq, "exp_avg_sq", like, 0),
    }

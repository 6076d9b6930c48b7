"""Tensors from a file, compared with those that they are to replace before any of them is used."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from craftsim.errors import InputError
from craftsim.storage.limits import LARGEST_WEIGHT
from craftsim.training.archive import Saved


def part(saved: Any, key: str) -> dict[str, Any]:
    """Return the mapping under a key; raise InputError where there is none."""
    if not isinstance(saved, dict) or not isinstance(saved.get(key), dict):
        raise InputError(f"it has no part '{key}'")
    found: dict[str, Any] = saved[key]
    return found


def check_like(saved: Any, key: str, shape: tuple[int, ...], dtype: torch.dtype) -> Saved:
    """Return a tensor that is not read yet; raise InputError where it has another shape or type."""
    name = str(dtype).removeprefix("torch.")
    if not isinstance(saved, Saved) or (saved.shape, saved.dtype) != (tuple(shape), name):
        found = f"{saved.dtype} {saved.shape}" if isinstance(saved, Saved) else type(saved).__name__
        raise InputError(f"'{key}' is {found}; allowed: {name} {tuple(shape)}")
    return saved


def numbers(
    saved: Any, key: str, like: Tensor, low: float = -LARGEST_WEIGHT, high: float = LARGEST_WEIGHT
) -> Tensor:
    """Return a tensor of a shape and type; raise InputError where a number is not finite, or out of all proportion."""
    found = check_like(saved, key, tuple(like.shape), like.dtype).read()
    if found.numel() and not (low <= float(found.min()) and float(found.max()) <= high):
        raise InputError(f"'{key}' has numbers that are not finite, or not from {low:g} to {high:g}")
    return found


def constant(saved: Any, key: str, like: Tensor) -> Tensor:
    """Return a tensor; raise InputError where it is another one."""
    found = check_like(saved, key, tuple(like.shape), like.dtype).read()
    if not torch.equal(found, like):
        raise InputError(f"'{key}' is not what this version of craftsim has there")
    return found


def weights(saved: Mapping[str, Any], like: Mapping[str, Tensor]) -> OrderedDict[str, Tensor]:
    """Return tensors to load into a module, whose own ``like`` are; settings among them must be as they are there.

    All shapes are compared before anything is read. Raises InputError.
    """
    if set(saved) != set(like):
        odd = sorted(set(saved) ^ set(like), key=str)[0]
        raise InputError(f"'{str(odd)[:80]}' is missing or unknown among its weights")
    for key, tensor in like.items():
        check_like(saved[key], key, tuple(tensor.shape), tensor.dtype)
    # A copy has what hangs on the state of a module, too.
    state = OrderedDict(like)
    state.__dict__.update(getattr(like, "__dict__", {}))
    for key, tensor in like.items():
        setting = tensor.ndim == 0 or not tensor.is_floating_point()
        state[key] = (constant if setting else numbers)(saved[key], key, tensor)
    return state


def table_rows(saved: Mapping[str, Any], like: Tensor) -> tuple[Tensor, Tensor]:
    """Return which rows of a table, as large as ``like``, are replaced, in order, and by what. Raises InputError."""
    places, width = like.shape
    rows = saved.get("rows")
    n = rows.shape[0] if isinstance(rows, Saved) and len(rows.shape) == 1 else places
    if saved.get("places") != places or n > places:
        raise InputError(f"its table has {str(saved.get('places'))[:40]} places; allowed: {places}")
    check_like(rows, "rows", (n,), torch.int64)
    values = numbers(saved.get("values"), "values", torch.empty((n, width), device="meta"))
    found = numbers(rows, "rows", torch.empty(n, dtype=torch.int64, device="meta"), 0, places - 1)
    if (found.diff() <= 0).any():
        raise InputError("'rows' of its table are not in order")
    return found, values


def module_state(saved: Any, key: str, module: nn.Module) -> OrderedDict[str, Tensor]:
    """Return the state of a module under a key; raises as :func:`weights`."""
    return weights(part(saved, key), module.state_dict())


def adam_state(saved: Any, optimizer: torch.optim.Adam) -> dict[str, Any]:
    """Return the state of the optimiser: its averages, with the settings of this version. Raises InputError."""
    found, own = part(saved, "optimizer"), optimizer.state_dict()
    groups = found.get("param_groups")
    if not isinstance(groups, list) or len(groups) != len(own["param_groups"]):
        raise InputError("'param_groups' of the optimiser is not a list of the groups of this version")
    for group, settings in zip(groups, own["param_groups"], strict=True):
        same = isinstance(group, dict) and all(
            group[name] == settings[name] for name in group if name in settings
        )
        if not same or group.get("params") != settings["params"]:
            raise InputError("a setting of the optimiser is not what this version of craftsim has there")
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    state: dict[int, dict[str, Tensor]] = {}
    for number, averages in part(found, "state").items():
        keys = {"step", "exp_avg", "exp_avg_sq"}
        if type(number) is not int or not 0 <= number < len(parameters):
            raise InputError(f"the optimiser has averages for weights that are not there: {str(number)[:40]}")
        if not isinstance(averages, dict) or set(averages) != keys:
            raise InputError(f"the averages {number} of the optimiser are not {', '.join(sorted(keys))}")
        like = parameters[number]
        state[number] = {
            "step": _steps(averages["step"]),
            "exp_avg": numbers(averages["exp_avg"], "exp_avg", like),
            "exp_avg_sq": numbers(averages["exp_avg_sq"], "exp_avg_sq", like, low=0.0),
        }
    return {"state": state, "param_groups": own["param_groups"]}


def _steps(saved: Any) -> Tensor:
    steps = check_like(saved, "step", (), torch.float32).read()
    if not 0 <= float(steps) < 2**31:
        raise InputError(f"'step' of the optimiser is {float(steps)}; allowed: 0 or more")
    return steps

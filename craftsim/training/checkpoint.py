"""What training leaves behind: a policy file, small, and a run file, from which training goes on.

Both hold tensors and plain values only, and are read such that nothing in them can run.
"""

from __future__ import annotations

import pickle
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import torch

from craftsim.discrete.rules.legality import N_ACTIONS
from craftsim.errors import InputError
from craftsim.training.config import TrainConfig
from craftsim.training.features import Shape
from craftsim.training.identity import TaskIdentity
from craftsim.training.networks import CarNet

POLICY_FILE: Final = "policy.pt"
RUN_FILE: Final = "run.pt"
FORMAT: Final = 2
"""Raised whenever older files cannot be read any more."""


def save_policy(
    path: Path,
    config: TrainConfig,
    identity: TaskIdentity,
    shape: Shape,
    net: CarNet,
    versions: dict[str, str],
) -> None:
    """Write a policy, and what it was trained for and with."""
    _save(
        path,
        {
            "kind": "policy",
            "config": config.as_dict(),
            "task": identity.as_dict(),
            "shape": asdict(shape),
            "versions": versions,
            "net": net.state_dict(),
        },
    )


def read_policy(path: Path) -> tuple[TrainConfig, TaskIdentity, Shape, CarNet]:
    """Return what :func:`save_policy` wrote; raises InputError for any other file."""
    content = _read(path, "policy")
    try:
        shape = Shape(**{**content["shape"], "size": tuple(content["shape"]["size"])})
        net = CarNet(shape, N_ACTIONS)
        net.load_state_dict(content["net"])
        identity = TaskIdentity(**content["task"])
        return TrainConfig.from_dict(content["config"]), identity, shape, net.eval()
    except (KeyError, TypeError, RuntimeError, InputError) as error:
        raise InputError(f"{path}: not a policy of this version of craftsim ({error})") from error


def save_run(path: Path, content: dict[str, Any]) -> None:
    """Write the state of a training run."""
    _save(path, {"kind": "run", **content})


def read_run(path: Path) -> dict[str, Any]:
    """Return what :func:`save_run` was given; raises InputError for any other file."""
    return _read(path, "run")


def _save(path: Path, content: dict[str, Any]) -> None:
    partial = path.with_name(f".{path.name}.partial")
    try:
        torch.save({"craftsim": FORMAT, **content}, partial)
        partial.replace(path)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error


def _read(path: Path, kind: str) -> dict[str, Any]:
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    except (RuntimeError, ValueError, EOFError, pickle.UnpicklingError) as error:
        raise InputError(f"{path}: not a file that 'craftsim train' wrote") from error
    if not isinstance(content, dict) or content.get("kind") != kind:
        raise InputError(f"{path}: not a {kind} file of 'craftsim train'; {_HINTS[kind]}")
    if content["craftsim"] != FORMAT:
        raise InputError(f"{path}: written in format {content['craftsim']}, this version reads {FORMAT}")
    return content


_HINTS: Final = {
    "policy": f"a policy is in the run's folder, in {POLICY_FILE}",
    "run": f"a run goes on from its folder, which holds a {RUN_FILE}",
}

"""What training leaves behind: a policy file, small, and a run file, from which training goes on.

Both are safetensors files with all that is no tensor as their metadata. Nothing in them can run when they are read.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from pydantic import ConfigDict, FailFast, Field, TypeAdapter, ValidationError, with_config

from craftsim.errors import InputError
from craftsim.learning.config import TrainConfig
from craftsim.learning.curve import CurvePoint
from craftsim.learning.policy_files import POLICY_FILE
from craftsim.learning.shape import Shape, TaskIdentity
from craftsim.storage.limits import (
    CURVE_POINTS,
    POLICY,
    POLICY_HEAD_BYTES,
    RUN,
    RUN_HEAD_BYTES,
    Limits,
)
from craftsim.storage.reading import open_file
from craftsim.storage.records import first_mistake
from craftsim.storage.writing import write_whole

if TYPE_CHECKING:
    from torch import Tensor

    from craftsim.learning.networks import CarNet

RUN_FILE: Final = "run.safetensors"
ENCODER_TABLE: Final = "encoder.table.weight"
ROWS: Final = "encoder.table.rows"


@dataclass(frozen=True)
class PolicyHead:
    """All of a policy file but the weights."""

    config: TrainConfig
    task: TaskIdentity
    shape: Shape
    versions: dict[str, str]


@dataclass(frozen=True)
class RunHead:
    """All of a run file but tensors."""

    config: TrainConfig
    task: TaskIdentity
    starts: str  # digest of the other starts; empty without
    versions: dict[str, str]
    iteration: int
    wall_s: float
    cpu_s: float  # of training, in all calls that the run took; processes that hold worlds in physics aside
    curve: Annotated[list[CurvePoint], Field(max_length=CURVE_POINTS), FailFast()]

    def __post_init__(self) -> None:
        if not 0 <= self.iteration < 2**60 or self.wall_s < 0 or self.cpu_s < 0:
            raise InputError(
                f"iteration is {self.iteration} after {self.wall_s} s, {self.cpu_s} s of CPU; allowed: 0 or more"
            )


@dataclass(frozen=True)
class _Kind:
    """What tells one kind of file from the other."""

    name: str
    format: str  # another one whenever files of before cannot be read any more
    limits: Limits
    head_bytes: int
    head: TypeAdapter[Any]
    hint: str


_STRICT: Final = with_config(ConfigDict(extra="forbid", strict=True, allow_inf_nan=False))
_POLICY: Final = _Kind(
    name="policy",
    format="6",
    limits=POLICY,
    head_bytes=POLICY_HEAD_BYTES,
    head=TypeAdapter(_STRICT(PolicyHead)),
    hint=f"a policy is in the run's folder, in {POLICY_FILE}",
)
_RUN: Final = _Kind(
    name="run",
    format="run 10",
    limits=RUN,
    head_bytes=RUN_HEAD_BYTES,
    head=TypeAdapter(_STRICT(RunHead)),
    hint=f"a run goes on from its folder, which holds a {RUN_FILE}",
)


def save_policy(path: Path, head: PolicyHead, net: CarNet) -> None:
    """Write a policy, and what it was trained for and with.

    Most of its table is of what never occurred in training and is as the run's seed made it: that is left out.
    """
    from craftsim.learning.networks import first_net

    weights = {name: weight.detach().cpu() for name, weight in net.named_parameters()}
    table = weights[ENCODER_TABLE]
    first = first_net(head.shape, head.config.seed).encoder.table.weight
    rows = (table != first).any(-1).nonzero()[:, 0]
    _write(path, _POLICY, head, weights | {ROWS: rows, ENCODER_TABLE: table[rows]})


def read_policy(path: Path) -> tuple[PolicyHead, CarNet]:
    """Return what :func:`save_policy` wrote; raises InputError for any other file."""
    head, arrays = _read(path, _POLICY)
    with naming(path):
        return head, _net(head, arrays)


def _net(head: PolicyHead, arrays: dict[str, Any]) -> CarNet:
    """Return the network of a policy; raises InputError for arrays that are not its weights."""
    # Only after the file is known to be one of ours: torch takes a second and 200 MB.
    import torch

    from craftsim.learning.networks import first_net, restore

    net = first_net(head.shape, head.config.seed)
    weights = dict(net.named_parameters())
    places, width = weights[ENCODER_TABLE].shape
    n = 0
    if ROWS in arrays:
        n = min(arrays[ROWS].size, places)
    rows = torch.empty(n, dtype=torch.int64)
    values = torch.empty(n, width)
    restore({ROWS: rows, **weights, ENCODER_TABLE: values}, arrays, {ROWS: (0, places - 1)})
    if (rows.diff() <= 0).any():
        raise InputError(f"'{ROWS}' are not in order")
    with torch.no_grad():
        weights[ENCODER_TABLE][rows] = values
    return net.eval()


def save_run(path: Path, head: RunHead, tensors: Mapping[str, Tensor]) -> None:
    """Write the state of a training run."""
    _write(path, _RUN, head, tensors)


def read_run_file(path: Path) -> tuple[RunHead, dict[str, Any]]:
    """Return what :func:`save_run` wrote, tensors as arrays; raises InputError for any other file."""
    return _read(path, _RUN)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Let InputErrors in the block name a file."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _write(path: Path, kind: _Kind, head: Any, tensors: Mapping[str, Tensor]) -> None:
    from safetensors.torch import save

    metadata = {"format": kind.format, "craftsim": json.dumps(asdict(head))}
    write_whole(path, save(dict(tensors), metadata))


def _read(path: Path, kind: _Kind) -> tuple[Any, dict[str, Any]]:
    """Return the head of a file, and its arrays by name."""
    with open_file(path, kind.limits) as file:
        start = file.read(8)
    with naming(path):
        return _content(path, start, kind)


def _content(path: Path, start: bytes, kind: _Kind) -> tuple[Any, dict[str, Any]]:
    """Return the same; ``start`` are the first bytes."""
    refused = InputError(f"not a file that 'craftsim train' wrote, or damaged; {kind.hint}")
    if int.from_bytes(start, "little") > kind.head_bytes:
        raise refused
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, "numpy") as content:
            metadata = content.metadata() or {}
            if "craftsim" not in metadata:
                raise InputError(f"not a {kind.name} file of 'craftsim train'; {kind.hint}")
            stored_format = metadata.get("format")
            if stored_format != kind.format:
                raise InputError(
                    f"written in format {str(stored_format)[:40]}, this version reads {kind.format}"
                )
            head = kind.head.validate_json(metadata["craftsim"])
            return head, {name: content.get_tensor(name) for name in content.keys()}  # noqa: SIM118
    except ValidationError as error:
        raise InputError(first_mistake(error)) from None
    except (SafetensorError, TypeError, ValueError, OSError):
        raise refused from None

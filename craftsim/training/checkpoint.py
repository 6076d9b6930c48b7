"""What training leaves behind: a policy file, small, and a run file, from which training goes on.

A policy is a safetensors file with all else as its metadata. A run's file is torch's own, for that run alone. Nothing
in either can run when it is read.
"""

from __future__ import annotations

import json
import pickletools
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar

from pydantic import ConfigDict, FailFast, Field, TypeAdapter, ValidationError, with_config

from craftsim.errors import InputError
from craftsim.storage.limits import CURVE_POINTS, PICKLE_BYTES, PICKLE_STEPS, POLICY, POLICY_HEAD_BYTES, RUN
from craftsim.storage.reading import ARCHIVE_ERRORS, open_archive, open_file
from craftsim.storage.records import first_mistake
from craftsim.storage.writing import whole, write_whole
from craftsim.training.config import TrainConfig
from craftsim.training.curve import CurvePoint
from craftsim.training.policy import POLICY_FILE
from craftsim.training.shape import Shape, TaskIdentity

if TYPE_CHECKING:
    from craftsim.training.networks import CarNet

RUN_FILE: Final = "run.pt"
FORMAT: Final = 6
RUN_FORMAT: Final = 9
"""Of policies and of runs; raised whenever older files cannot be read any more."""
TABLE: Final = "encoder.table.weight"
ROWS: Final = "encoder.table.rows"
_NAMED: Final = {
    "collections OrderedDict",
    "torch Size",
    "torch device",
    "torch._utils _rebuild_tensor_v2",
    *(f"torch {kind}Storage" for kind in ("Float", "Double", "Long", "Int", "Short", "Bool")),
}
"""What a run file names. Of the other names that torch takes some ask for as much memory as the file says."""

T = TypeVar("T")


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


def save_policy(path: Path, head: PolicyHead, net: CarNet) -> None:
    """Write a policy, and what it was trained for and with.

    Most of its table is of what never occurred in training and is as the run's seed made it: that is left out.
    """
    from safetensors.torch import save

    from craftsim.training.networks import first_net

    weights = {name: weight.detach() for name, weight in net.named_parameters()}
    table, first = weights[TABLE], first_net(head.shape, head.config.seed).encoder.table.weight
    rows = (table != first).any(-1).nonzero()[:, 0]
    weights |= {ROWS: rows, TABLE: table[rows]}
    metadata = {"format": str(FORMAT), "craftsim": json.dumps(asdict(head))}
    write_whole(path, save(weights, metadata))


def read_policy(path: Path) -> tuple[PolicyHead, CarNet]:
    """Return what :func:`save_policy` wrote; raises InputError for any other file."""
    with open_file(path, POLICY) as file:
        start = file.read(8)
    if start.startswith(b"PK"):
        raise InputError(
            f"{path}: written by craftsim 0.2 or older, whose policies this version does not read; train it again"
        )
    if int.from_bytes(start, "little") > POLICY_HEAD_BYTES:
        raise _refused(path, "policy")
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, "numpy") as content:
            metadata = content.metadata() or {}
            if "craftsim" not in metadata:
                raise InputError(_OTHER["policy"])
            if (found := metadata.get("format")) != str(FORMAT):
                raise InputError(f"written in format {str(found)[:40]}, this version reads {FORMAT}")
            head = _head(_POLICY_HEAD, metadata["craftsim"])
            # Only after the file is known to be one of ours: torch takes a second and 200 MB.
            return head, _net(head, {name: content.get_tensor(name) for name in content.keys()})  # noqa: SIM118
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (SafetensorError, TypeError, ValueError, OSError):
        raise _refused(path, "policy") from None


def _net(head: PolicyHead, arrays: dict[str, Any]) -> CarNet:
    """Return the network of a policy; raises InputError for arrays that are not its weights."""
    import torch

    from craftsim.training.networks import first_net, numbers

    net = first_net(head.shape, head.config.seed)
    weights = dict(net.named_parameters())
    if odd := sorted(set(arrays) ^ {*weights, ROWS}):
        raise InputError(f"'{odd[0][:80]}' is missing or unknown among its weights")
    saved = {name: torch.from_numpy(array) for name, array in arrays.items()}
    places, width = weights[TABLE].shape
    n = min(len(saved[ROWS].flatten()), places)
    rows = numbers(saved[ROWS], ROWS, torch.empty(n, dtype=torch.int64), 0, places - 1)
    if (rows.diff() <= 0).any():
        raise InputError(f"'{ROWS}' are not in order")
    with torch.no_grad():
        weights.pop(TABLE)[rows] = numbers(saved[TABLE], TABLE, torch.empty(n, width))
        for name, weight in weights.items():
            weight.copy_(numbers(saved[name], name, weight))
    return net.eval()


def save_run(path: Path, head: RunHead, learner: dict[str, Any], novelty: Any) -> None:
    """Write the state of a training run."""
    import torch

    content = {"craftsim": RUN_FORMAT, "head": json.dumps(asdict(head))}
    with whole(path) as partial, partial.open("wb") as file:
        try:
            torch.save(content | {"learner": learner, "novelty": novelty}, file)
        except RuntimeError as error:
            # Torch notices only that less was written than it wanted.
            if isinstance(error.__context__, OSError):
                raise error.__context__ from None
            raise


@contextmanager
def open_run(path: Path) -> Iterator[tuple[RunHead, Any, Any]]:
    """Give what :func:`save_run` wrote: head, learner and novelty.

    Raises InputError, beginning with the path, for any other file. An InputError in the block names the file.
    """
    _check_run(path)
    import torch

    try:
        # Tensors are read when they are used.
        content = torch.load(path, "cpu", weights_only=True, mmap=True)
    except Exception:  # it raises whatever its parts do
        raise _refused(path, "run") from None
    try:
        if not isinstance(content, dict) or "craftsim" not in content:
            raise InputError(_OTHER["run"])
        if (found := content["craftsim"]) != RUN_FORMAT:
            raise InputError(
                f"written in format {str(found)[:40]}, by another version of craftsim; this version reads {RUN_FORMAT}"
            )
        yield _head(_RUN_HEAD, content.get("head")), content.get("learner"), content.get("novelty")
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _check_run(path: Path) -> None:
    """Raise InputError for a file that torch would make more of than the file holds."""
    try:
        with open_archive(path, RUN) as archive:
            members = archive.infolist()
            (contents,) = (one for one in members if one.filename.endswith("data.pkl"))
            if contents.file_size > PICKLE_BYTES or any(one.compress_type for one in members):
                raise ValueError
            for number, (step, argument, _) in enumerate(pickletools.genops(archive.read(contents))):
                if number > PICKLE_STEPS or (step.name == "GLOBAL" and argument not in _NAMED):
                    raise ValueError
    except ARCHIVE_ERRORS:
        raise _refused(path, "run") from None


def _refused(path: Path, kind: str) -> InputError:
    return InputError(f"{path}: not a file that 'craftsim train' wrote, or damaged; {_HINTS[kind]}")


def _head(kind: TypeAdapter[T], text: Any) -> T:
    try:
        return kind.validate_json(text)
    except ValidationError as error:
        raise InputError(first_mistake(error)) from None


_STRICT: Final = with_config(ConfigDict(extra="forbid", strict=True, allow_inf_nan=False))
_POLICY_HEAD: Final = TypeAdapter(_STRICT(PolicyHead))
_RUN_HEAD: Final = TypeAdapter(_STRICT(RunHead))
_HINTS: Final = {
    "policy": f"a policy is in the run's folder, in {POLICY_FILE}",
    "run": f"a run goes on from its folder, which holds a {RUN_FILE}",
}
_OTHER: Final = {kind: f"not a {kind} file of 'craftsim train'; {hint}" for kind, hint in _HINTS.items()}

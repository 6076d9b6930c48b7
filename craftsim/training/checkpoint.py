"""What training leaves behind: a policy file, small, and a run file, from which training goes on.

Both hold tensors and plain values only, and are read such that nothing in them can run.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

from craftsim.errors import InputError
from craftsim.storage.limits import CURVE_POINTS, POLICY, RUN, Limits
from craftsim.storage.mistakes import first_mistake
from craftsim.storage.writing import whole
from craftsim.training.archive import reading_archive
from craftsim.training.config import TrainConfig
from craftsim.training.curve import Point
from craftsim.training.identity import TaskIdentity
from craftsim.training.policy import POLICY_FILE
from craftsim.training.shape import Shape

if TYPE_CHECKING:
    from pydantic import TypeAdapter

    from craftsim.training.networks import CarNet

RUN_FILE: Final = "run.pt"
FORMAT: Final = 5
RUN_FORMAT: Final = 6
"""Of policies and of runs; raised whenever older files cannot be read any more."""
TABLE: Final = "encoder.table.weight"

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class PolicyHead:
    """All of a policy file but the weights."""

    config: TrainConfig
    task: TaskIdentity
    shape: Shape
    versions: dict[str, str]


@dataclasses.dataclass(frozen=True)
class RunHead:
    """All of a run file but tensors."""

    config: TrainConfig
    task: TaskIdentity
    starts: str
    """Digest of the other starts; empty without."""
    versions: dict[str, str]
    iteration: int
    wall_s: float
    cpu_s: float
    """Of training, in all calls that the run took; processes that hold worlds in physics aside."""
    curve: list[Point]

    def __post_init__(self) -> None:
        if not 0 <= self.iteration < 2**60 or self.wall_s < 0 or self.cpu_s < 0:
            raise InputError(
                f"iteration is {self.iteration} after {self.wall_s} s, {self.cpu_s} s of CPU; allowed: 0 or more"
            )


@dataclasses.dataclass(frozen=True)
class SavedRun:
    """A run file, open: its tensors are read within the block of :func:`open_run`."""

    head: RunHead
    learner: Any
    novelty: Any


def save_policy(
    path: Path,
    config: TrainConfig,
    identity: TaskIdentity,
    shape: Shape,
    net: CarNet,
    versions: dict[str, str],
) -> None:
    """Write a policy, and what it was trained for and with.

    Most of its table is of what never occurred in training and is as the run's seed made it: that is left out.
    """
    from craftsim.training.networks import first_net

    head = PolicyHead(config, identity, shape, versions)
    state = net.state_dict()
    table, first = state.pop(TABLE), first_net(shape, config.seed).state_dict()[TABLE]
    rows = (table != first).any(-1).nonzero()[:, 0]
    learnt = {"places": len(table), "rows": rows, "values": table[rows]}
    _save(path, {"kind": "policy", **dataclasses.asdict(head), "net": state, "table": learnt})


def read_policy(path: Path) -> tuple[TrainConfig, TaskIdentity, Shape, CarNet]:
    """Return what :func:`save_policy` wrote; raises InputError for any other file."""
    with _opened(path, "policy", POLICY) as content:
        # Only after the file is known to be one of ours: torch takes a second and 200 MB.
        saved = {key: content.pop(key, None) for key in ("net", "table")}
        head = _head(PolicyHead, content)
        import torch

        from craftsim.training.networks import CarNet, first_net
        from craftsim.training.restoring import part, table_rows, weights

        with torch.device("meta"):
            like = CarNet(head.shape).state_dict()
        rows, values = table_rows(part(saved, "table"), like.pop(TABLE))
        state = weights(part(saved, "net"), like)
        net = first_net(head.shape, head.config.seed)
        net.load_state_dict(state, strict=False)
        with torch.no_grad():
            net.encoder.table.weight[rows] = values
        return head.config, head.task, head.shape, net.eval()


def save_run(path: Path, head: RunHead, learner: dict[str, Any], novelty: Any) -> None:
    """Write the state of a training run."""
    _save(path, {"kind": "run", **dataclasses.asdict(head), "learner": learner, "novelty": novelty})


@contextmanager
def open_run(path: Path) -> Iterator[SavedRun]:
    """Give what :func:`save_run` wrote; raises InputError, beginning with the path, for any other file.

    An InputError in the block names the file.
    """
    with _opened(path, "run", RUN) as content:
        learner, novelty = content.pop("learner", None), content.pop("novelty", None)
        yield SavedRun(_head(RunHead, content), learner, novelty)


def _save(path: Path, content: dict[str, Any]) -> None:
    import torch

    with whole(path) as partial, partial.open("wb") as file:
        try:
            torch.save({"craftsim": _FORMATS[content["kind"]], **content}, file)
        except RuntimeError as error:
            # Torch notices only that less was written than it wanted.
            if isinstance(error.__context__, OSError):
                raise error.__context__ from None
            raise


@contextmanager
def _opened(path: Path, kind: str, limits: Limits) -> Iterator[dict[str, Any]]:
    with reading_archive(path, limits) as content:
        if not isinstance(content, dict) or content.pop("kind", None) != kind:
            raise InputError(f"{path}: not a {kind} file of 'craftsim train'; {_HINTS[kind]}")
        if (found := content.pop("craftsim", None)) != (reads := _FORMATS[kind]):
            raise InputError(f"{path}: written in format {str(found)[:40]}, this version reads {reads}")
        try:
            yield content
        except InputError as error:
            raise InputError(f"{path}: {error}") from error


@cache
def _adapter(kind: Hashable) -> TypeAdapter[Any]:
    from pydantic import ConfigDict, TypeAdapter, with_config

    return TypeAdapter(
        with_config(ConfigDict(extra="forbid", strict=True, allow_inf_nan=False))(cast(type, kind))
    )


def _head(kind: type[T], content: dict[str, Any]) -> T:
    from pydantic import ValidationError

    curve = content.get("curve", ())
    if isinstance(curve, list) and len(curve) > CURVE_POINTS:
        raise InputError(f"the curve has {len(curve)} points; allowed: at most {CURVE_POINTS}")
    try:
        # As JSON: strictly that takes a mapping for a dataclass, and a list for a tuple. A tensor is no value there.
        head: T = _adapter(cast(Hashable, kind)).validate_json(json.dumps(content, default=str))
    except ValidationError as error:
        raise InputError(first_mistake(error)) from None
    return head


_FORMATS: Final = {"policy": FORMAT, "run": RUN_FORMAT}
_HINTS: Final = {
    "policy": f"a policy is in the run's folder, in {POLICY_FILE}",
    "run": f"a run goes on from its folder, which holds a {RUN_FILE}",
}

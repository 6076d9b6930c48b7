"""Declaring a machine's figure: its nominal value, where that comes from, and what may be put in its place."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass, field, fields
from typing import Any, Final, Literal

from craftsim.errors import InputError

Origin = Literal["published", "derived", "assumed"]


@dataclass(frozen=True)
class Provenance:
    """Where a figure comes from: its origin and, where there is something to say, a note."""

    origin: Origin
    note: str


@dataclass(frozen=True)
class Allowed:
    """What a figure may be: above ``above`` and at most ``most``, or, where ``fixed`` gives a reason, nothing else."""

    above: float = 0.0
    most: float = math.inf
    fixed: str = ""


ANY: Final = Allowed()
"""Above 0 and finite."""

REACH: Final = 1e6
"""By what factor a figure may be larger or smaller than its nominal value, where nothing narrower is declared: beyond
it arithmetic ends before physics does."""


def fixed(reason: str) -> Allowed:
    """Return that a figure cannot be changed, and why."""
    return Allowed(fixed=reason)


def _figure(value: float, origin: Origin, note: str, allowed: Allowed) -> Any:
    return field(default=value, metadata={"provenance": Provenance(origin, note), "allowed": allowed})


def published(value: float, note: str = "", allowed: Allowed = ANY) -> Any:
    """Declare a dataclass field whose default is a published figure."""
    return _figure(value, "published", note, allowed)


def derived(value: float, note: str, allowed: Allowed = ANY) -> Any:
    """Declare a dataclass field whose default follows from published figures as the note says."""
    return _figure(value, "derived", note, allowed)


def assumed(value: float, note: str, allowed: Allowed = ANY) -> Any:
    """Declare a dataclass field whose default is our assumption, for the reason in the note."""
    return _figure(value, "assumed", note, allowed)


def provenance(parameters: object) -> dict[str, Provenance]:
    """Return the provenance of every figure of a parameter dataclass or instance, by field name."""
    return {f.name: f.metadata["provenance"] for f in fields(parameters)}  # type: ignore[arg-type]


def digest_of(figures: dict[str, Any]) -> str:
    """Return the SHA-256, in hexadecimal, of nested figures by name; an integer counts as the number that it equals."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [plain(item) for item in value]
        return value if isinstance(value, str) else float(value)

    return hashlib.sha256(json.dumps(plain(figures), sort_keys=True).encode()).hexdigest()


def check(parameters: object) -> None:
    """Raise InputError, naming the figure, for the first one that is not what it may be."""
    for f in fields(parameters):  # type: ignore[arg-type]
        check_figure(f"{type(parameters).__name__}.{f.name}", getattr(parameters, f.name), f)


def check_figure(name: str, value: object, declared: Any) -> None:
    """Raise InputError, calling the figure ``name``, for a value that its field does not allow."""
    allowed: Allowed = declared.metadata["allowed"]
    whole = isinstance(declared.default, int)
    kind = int if whole else (int, float)
    if isinstance(value, bool) or not isinstance(value, kind) or not math.isfinite(value):
        raise InputError(f"{name} must be {'an integer' if whole else 'a number'}, not {value!r}")
    if allowed.fixed:
        if value != declared.default:
            raise InputError(f"{name} cannot be changed from {declared.default:.6g}: {allowed.fixed}")
        return
    if not allowed.above < value <= allowed.most:
        most = f" and at most {allowed.most:g}" if allowed.most < math.inf else ""
        raise InputError(f"{name} must be above {allowed.above:g}{most}, not {value!r}")
    check_reach(name, value, declared.default)


def check_reach(name: str, value: float, nominal: float) -> None:
    """Raise InputError, calling the figure ``name``, for a value of another order than the nominal one."""
    least, most = abs(nominal) / REACH, abs(nominal) * REACH
    if value and not least <= abs(value) <= most:
        raise InputError(f"{name} must be from {least:g} to {most:g}, not {value!r}")

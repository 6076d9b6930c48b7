"""A report as ``report.json``; equal runs give equal bytes."""

from __future__ import annotations

import dataclasses
import json
import math
import platform
from collections.abc import Mapping
from enum import Enum
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import numpy as np

from craftsim.storage.extras import mujoco_release
from craftsim.storage.folders import owned
from craftsim.storage.writing import LEFT_OUT_IF_EMPTY, writable, write_whole

SCHEMA_VERSION: Final = 2
"""Incremented whenever a key of the report changes its meaning or is removed."""
_MISSING: Final = "not installed"


def versions() -> dict[str, str]:
    """Return the versions on which a run's results depend, without importing the packages."""
    return {
        "craftsim": _version("craftsim"),
        "mujoco": mujoco_release() or _MISSING,
        "numpy": _version("numpy"),
        "python": platform.python_version(),
        "platform": platform.platform(),
    }


@cache
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return _MISSING


def document(
    figures: Mapping[str, Any],
    *,
    command: str,
    seed: int | None = None,
    config: Mapping[str, Any] | None = None,
    wall: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the content of ``report.json``.

    Everything outside ``wall``, the durations and rates by the clock, is the same for two runs of the same command with
    the same seed and configuration on the same machine. ``figures`` may contain dataclasses, enums (written as their
    names), paths and NumPy values; a number that is not finite is written as null.
    """
    return {
        "schema_version": SCHEMA_VERSION,
        "command": command,
        "seed": seed,
        "versions": versions(),
        "config": config or {},
        "figures": figures,
        "wall": wall or {},
    }


def write_report(out: Path, figures: Mapping[str, Any], **about: Any) -> Path:
    """Write ``report.json``; arguments and errors as of :func:`document` and :func:`write_json`."""
    return write_json(out, document(figures, **about))


def write_json(out: Path, document: Mapping[str, Any]) -> Path:
    """Write ``report.json`` atomically into the directory ``out``, created if missing, and return its path.

    Raises InputError if the directory is not writable or in use, and TypeError for a value that JSON cannot hold.
    """
    text = (
        json.dumps(
            json_value(document), indent=2, sort_keys=True, allow_nan=False, ensure_ascii=False
        )
        + "\n"
    )
    with owned(out):
        return write_whole(out / "report.json", text)


def json_value(value: Any) -> Any:
    """Return a value as JSON types: dict, list, str, int, float, bool and None.

    Enums become their names, numbers that are not finite None, and unencodable characters escapes. Raises TypeError for
    other types.
    """
    match value:
        case Enum():
            return value.name
        case None | bool() | int():
            return value
        case str():
            return writable(value)
        case float():
            if math.isfinite(value):
                return value
            return None
        case np.generic() | np.ndarray():
            return json_value(value.tolist())
        case Path():
            return json_value(str(value))
        case Mapping():
            return {str(json_value(key)): json_value(item) for key, item in value.items()}
        case list() | tuple():
            return [json_value(item) for item in value]
        case _ if dataclasses.is_dataclass(value) and not isinstance(value, type):
            items = {}
            for field in dataclasses.fields(value):
                item = getattr(value, field.name)
                if item or LEFT_OUT_IF_EMPTY not in field.metadata:
                    items[field.name] = json_value(item)
            return items
        case _:
            raise TypeError(f"a report cannot hold a {type(value).__name__}: {value!r}")

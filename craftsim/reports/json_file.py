"""A report as ``report.json``, so that two runs can be compared byte for byte."""

from __future__ import annotations

import dataclasses
import json
import math
import platform
from collections.abc import Mapping
from enum import Enum
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import numpy as np

from craftsim.storage.folders import owned
from craftsim.storage.writing import LEFT_OUT_IF_EMPTY, writable, write_whole

SCHEMA_VERSION: Final = 2
"""Raised whenever a key of the report changes its meaning or goes away."""


def versions() -> dict[str, str]:
    """Return the versions that decide a run's figures, without importing what they name."""
    return {
        **{package: _version(package) for package in ("craftsim", "mujoco", "numpy")},
        "python": platform.python_version(),
        "platform": platform.platform(),
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def document(
    figures: Mapping[str, Any],
    *,
    command: str,
    seed: int | None = None,
    config: Mapping[str, Any] | None = None,
    wall: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return what ``report.json`` holds of a run.

    Everything outside ``wall`` is the same for two runs of the same command with the same seed and configuration on the
    same machine.

    Args:
        figures: results. Dataclasses, enums (by name), paths and NumPy values may be nested in them; a number
            that is not finite is written as null, since JSON has no other value for it.
        command: name of the command that ran.
        seed: what its random generators were seeded with, if it has any.
        config: what else decides the figures.
        wall: what the clock said (durations, rates): never the same twice, hence kept apart.
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
    """Write ``report.json`` with some figures; ``about`` and errors as :func:`document` and :func:`write_json`."""
    return write_json(out, document(figures, **about))


def write_json(out: Path, document: Mapping[str, Any]) -> Path:
    """Write ``report.json`` into the directory ``out``, made when missing, and return its path.

    The file appears whole or not at all.

    Raises:
        InputError: the directory cannot be written to, or somebody else owns it.
        TypeError: a value has no place in JSON.
    """
    text = json.dumps(plain(document), indent=2, sort_keys=True, allow_nan=False, ensure_ascii=False) + "\n"
    with owned(out):
        return write_whole(out / "report.json", text)


def plain(value: Any) -> Any:
    """Return a value made of what JSON knows: dict, list, str, int, float, bool and None.

    Enums become their names, numbers that are not finite None, and what UTF-8 cannot say of a text escapes. Raises
    TypeError for what has no place in JSON.
    """
    match value:
        case Enum():
            return value.name
        case None | bool() | int():
            return value
        case str():
            return writable(value)
        case float():
            return value if math.isfinite(value) else None
        case np.generic() | np.ndarray():
            return plain(value.tolist())
        case Path():
            return plain(str(value))
        case Mapping():
            return {str(plain(key)): plain(item) for key, item in value.items()}
        case list() | tuple():
            return [plain(item) for item in value]
        case _ if dataclasses.is_dataclass(value) and not isinstance(value, type):
            found = {field: getattr(value, field.name) for field in dataclasses.fields(value)}
            return {
                field.name: plain(item)
                for field, item in found.items()
                if LEFT_OUT_IF_EMPTY not in field.metadata or item
            }
        case _:
            raise TypeError(f"a report cannot hold a {type(value).__name__}: {value!r}")

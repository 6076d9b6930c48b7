"""What worlds lack, from YAML files that a person writes: bounded in size, and each mistake named by file and line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from craftsim.errors import InputError
from craftsim.models.parameter_files import number, numbers, read_keys
from craftsim.models.randomization import DomainRandomization
from craftsim.models.sensing import EXACT, SensorNoise
from craftsim.storage.yaml import unknown_words


def load_noise(path: Path | str, nominal: SensorNoise = EXACT) -> SensorNoise:
    """Return the sensor noise of a YAML file; what it leaves out is that of ``nominal``.

    Raises InputError, naming the file and figure, for an unknown figure and one out of range.

    Example:
        >>> from craftsim.models.randomization_files import load_noise
        >>> _ = (folder / "late.yaml").write_text("{min_delay_s: 0.06, max_delay_s: 0.08}")
        >>> load_noise(folder / "late.yaml").max_delay_s
        0.08
    """
    path, known = Path(path), [field.name for field in fields(SensorNoise)]
    figures = numbers(read_keys(path, known), "noise", known)
    try:
        return replace(nominal, **figures)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def load_randomization(
    path: Path | str, presets: Mapping[str, DomainRandomization], limits: list[str]
) -> tuple[str, DomainRandomization, dict[str, float]]:
    """Return what a YAML file draws: the preset that it starts from, the whole, and the limits of errors that it sets.

    The file has any of the figures of DomainRandomization, its parts ``floor``, ``drivetrain``, ``making`` and
    ``sensors`` as sections, a section ``limits``, and under ``base`` the preset for what it leaves out, ``none``
    unless given.

    Args:
        path: of the file.
        presets: by name.
        limits: the names that the section may hold.

    Raises InputError, naming the file, line and figure, for what it should not say.
    """
    path = Path(path)
    parts = {f.name: f.default for f in fields(DomainRandomization)}
    document = read_keys(path, ["base", *parts, "limits"])
    given = document.plain
    base = given.get("base", "none")
    if base not in presets:
        document.fail(("base",), unknown_words(str(base), presets, "value of 'base'"))
    whole, figures = presets[base], dict[str, Any]()
    try:
        for name in parts.keys() & given.keys():
            default = getattr(whole, name)
            if isinstance(default, float):
                figures[name] = number(document, given[name], name, (name,))
            else:
                own = numbers(document, name, [f.name for f in fields(default)], name)
                figures[name] = replace(default, **own)
        whole = replace(whole, **figures)
    except InputError as error:
        raise InputError(
            message if (message := str(error)).startswith(str(path)) else f"{path}: {message}"
        ) from error
    bounds = numbers(document, "limits", limits, "limits") if "limits" in given else {}
    return base, whole, bounds

"""Packages: those that only some commands need, the extras of pyproject.toml, and the release of MuJoCo."""

from __future__ import annotations

import re
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from craftsim.errors import InputError


def need(extra: str, subject: str, *modules: str, remark: str = "") -> None:
    """Raise InputError with the command that installs an extra, where ``subject`` ("tuning needs") lacks a module."""
    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        raise InputError(
            f"{subject} {', '.join(missing)}, not installed here; try: {install_command(extra)}{remark}"
        )


def install_command(extra: str) -> str:
    """Return the command that installs what an extra brings, and leaves craftsim as it is installed.

    ``pip install '.[extra]'`` would put a copy in the place of a checkout that is installed as it stands.
    """
    mark = re.compile(rf"(.*?)\s*;\s*extra == ['\"]{extra}['\"]")
    quoted = []
    for line in _requirements():
        match = mark.fullmatch(line)
        if match:
            quoted.append(f"'{match[1]}'")
    return f"{sys.executable} -m pip install {' '.join(quoted)}"


_MUJOCO: Final = "mujoco"
_LIBRARY: Final = re.compile(r"libmujoco\.(?:so\.)?(\d+(?:\.\d+)+)(?:\.dylib)?")
"""Name of MuJoCo's library, which ends with its release."""
_SAME_MODULE: Final = (_MUJOCO, "mujoco-core")
"""Distributions that bring the module ``mujoco``; each overwrites the other's files."""


@cache
def mujoco_release() -> str | None:
    """Return the release of the module ``mujoco`` as ``mujoco.__version__`` does, without importing it.

    None if there is no such module. A distribution's metadata would not do: another one may bring the module.
    """
    module = sys.modules.get(_MUJOCO)
    if module is not None:
        return str(module.__version__)
    spec = find_spec(_MUJOCO)
    if spec is None:
        return None
    for folder in spec.submodule_search_locations or ():
        for file in Path(folder).glob("libmujoco.*"):
            release = _LIBRARY.fullmatch(file.name)
            if release:
                return release[1]
    try:
        return version(_MUJOCO)
    except PackageNotFoundError:
        return "unknown"


def check_mujoco() -> None:
    """Raise InputError for a release of MuJoCo that craftsim does not allow; there may be none, for the grid alone."""
    release = mujoco_release()
    if release is None:
        return
    reason = why_mujoco_refused(release)
    if reason:
        raise InputError(f"{reason}; to install another one: {install_mujoco()}")


def why_mujoco_refused(release: str) -> str:
    """Return why a release of MuJoCo is not allowed; empty if it is."""
    from packaging.requirements import Requirement
    from packaging.version import InvalidVersion, Version

    requirement = Requirement(_mujoco_requirement())
    try:
        allowed = requirement.specifier.contains(Version(release), prereleases=True)
    except InvalidVersion:
        allowed = False
    if allowed:
        return ""
    return f"MuJoCo {release} is not allowed here, but {requirement.specifier}"


def install_mujoco() -> str:
    """Return the command that installs an allowed release of MuJoCo in the place of any other."""
    pip = f"{sys.executable} -m pip"
    # Without that, files of the one before stay, or go away with it.
    return f"{pip} uninstall -y {' '.join(_SAME_MODULE)} && {pip} install '{_mujoco_requirement()}'"


def _mujoco_requirement() -> str:
    for line in _requirements():
        if re.match(rf"{_MUJOCO}\b(?!-)", line):
            return line
    return _MUJOCO


def _requirements() -> list[str]:
    """Return the requirements of craftsim; none where it is not installed, but found on the path of modules."""
    try:
        return requires("craftsim") or []
    except PackageNotFoundError:
        return []

"""Where policies are: files, folders of training runs, and the shipped ones."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

POLICY_FILE: Final = "policy.safetensors"
"""File name in the folder of a training run."""


SHIPPED_POLICIES: Final = Path(__file__).parents[1] / "data" / "policies"
"""Folder of the shipped policies, by task."""


def shipped_policies() -> list[str]:
    """Return the names of the shipped policies."""
    return sorted(path.stem for path in SHIPPED_POLICIES.glob("*.safetensors"))


def policy_file(path: str | Path) -> Path:
    """Return the path of a policy, given as a file, a folder or the name of a shipped one."""
    if is_shipped_policy(path):
        return SHIPPED_POLICIES / f"{path}.safetensors"
    return _own_file(path)


def is_shipped_policy(path: str | Path) -> bool:
    """Return whether this is the name of a shipped policy, and not a file or folder with a policy."""
    return str(path) in shipped_policies() and not os.path.lexists(_own_file(path))


def _own_file(path: str | Path) -> Path:
    if os.path.isdir(path):
        return Path(path) / POLICY_FILE
    return Path(path)

"""What a campaign is: ``campaign.json``."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from craftsim.errors import InputError
from craftsim.report import plain, versions
from craftsim.storage.limits import HEADER
from craftsim.storage.reading import read_bytes
from craftsim.validation.campaign.items import Item
from craftsim.validation.campaign.schema import description

SCHEMA_VERSION: Final = 1
CAMPAIGN: Final = "campaign.json"


@dataclass(frozen=True)
class Header:
    """What decides the results of a campaign, besides its items."""

    command: str
    seed: int
    config: Mapping[str, Any]


def described(header: Header, items: Sequence[Item]) -> dict[str, Any]:
    """Return what ``campaign.json`` holds."""
    keys = hashlib.sha256()
    for number, item in enumerate(items):
        keys.update(("\n" * (number > 0) + item.key).encode("utf-8", "backslashreplace"))
    found = {
        "schema_version": SCHEMA_VERSION,
        "command": header.command,
        "seed": header.seed,
        "versions": versions(),
        "config": header.config,
        "items": len(items),
        "keys": keys.hexdigest(),
    }
    loaded: dict[str, Any] = json.loads(json.dumps(plain(found)))
    return loaded


def read_header(path: Path) -> dict[str, Any]:
    """Return what a campaign's folder says that it is; raise InputError for a file that says nothing of the kind."""
    try:
        return description(read_bytes(path, HEADER), f"{path}: not a campaign's description")
    except InputError as error:
        raise InputError(f"{error}; choose another folder") from None


def differences(old: Any, new: Any, key: str = "") -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield the dotted names of what differs, with both values."""
    if isinstance(old, dict) and isinstance(new, dict):
        for name in sorted({*old, *new}):
            yield from differences(old.get(name), new.get(name), f"{key}.{name}" if key else name)
    elif old != new:
        yield key, (old, new)

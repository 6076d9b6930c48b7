"""Reading a finished campaign from its folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from craftsim.discrete.errors import InputError
from craftsim.validation.campaign.items import TrialRecord
from craftsim.validation.campaign.store import CAMPAIGN, TRIALS, read_header

_NEEDED = ("key", "agrees", "error", "attempts")


@dataclass(frozen=True)
class FinishedCampaign:
    """A campaign that has come to its end."""

    folder: Path
    header: Mapping[str, Any]
    """What the campaign was: command, seed, versions, config."""
    records: list[TrialRecord]


def read_finished(folder: Path, command: str) -> FinishedCampaign:
    """Return the finished campaign of a command.

    Raises:
        InputError: the folder holds no campaign, an unfinished one or another command's, or a line that is no record.
    """
    path = folder / CAMPAIGN
    if not path.is_file():
        raise InputError(f"{folder} holds no campaign; give the --out of an earlier 'craftsim {command}'")
    header = read_header(path)
    if header.get("command") != command:
        raise InputError(
            f"{folder} holds a campaign of 'craftsim {header.get('command')}'; give the --out of an earlier "
            f"'craftsim {command}'"
        )
    lines = folder / TRIALS
    texts = lines.read_bytes().split(b"\n")[:-1] if lines.is_file() else []
    if len(texts) < header["items"]:
        raise InputError(
            f"{folder} holds an unfinished campaign ({len(texts)} of {header['items']} trials); "
            f"finish it with 'craftsim {command} --resume --out {folder}' and the options that it was begun with"
        )
    return FinishedCampaign(
        folder, header, [_record(lines, i, text) for i, text in enumerate(texts, start=1)]
    )


def _record(path: Path, number: int, text: bytes) -> TrialRecord:
    try:
        record: TrialRecord = json.loads(text)
        if not record.keys() >= set(_NEEDED):
            raise KeyError
    except (ValueError, AttributeError, KeyError):
        raise InputError(
            f"{path}:{number}: not a trial's record; delete this line, and --resume runs its trial again"
        ) from None
    return record

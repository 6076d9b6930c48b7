"""A campaign that has come to its end, read back from its folder."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from craftsim.errors import InputError
from craftsim.storage.limits import TRIALS as TRIALS_LIMITS
from craftsim.storage.paths import exists
from craftsim.storage.reading import read_lines
from craftsim.validation.campaign.header import CAMPAIGN, read_header
from craftsim.validation.campaign.records import Lines, Records
from craftsim.validation.campaign.schema import ANY, Form
from craftsim.validation.campaign.store import TRIALS, read_record


@dataclass(frozen=True)
class FinishedCampaign:
    """A campaign that has come to its end."""

    folder: Path
    header: Mapping[str, Any]
    """What the campaign was: command, seed, versions, config."""
    records: Records


def read_finished(folder: Path, command: str, form: Form = ANY) -> FinishedCampaign:
    """Return the finished campaign of a command.

    Raises:
        InputError: the folder holds no campaign, an unfinished one or another command's, or a line that is no record.
    """
    path = folder / CAMPAIGN
    if not exists(path):
        raise InputError(f"{folder} holds no campaign; give the --out of an earlier 'craftsim {command}'")
    header = read_header(path)
    if header["command"] != command:
        raise InputError(
            f"{folder} holds a campaign of {reprlib.repr('craftsim ' + header['command'])}; "
            f"give the --out of an earlier 'craftsim {command}'"
        )
    lines, place = Lines(header["items"]), folder / TRIALS
    start = 0
    for number, line in read_lines(place, TRIALS_LIMITS) if exists(place) else ():
        if not line.endswith(b"\n"):
            break
        record = read_record(form, line, f"{place}:{number}", "--resume runs its trial again")
        if record["index"] >= len(lines):
            raise InputError(f"{place}:{number}: index: {record['index']}, but {path} has {len(lines)} items")
        lines.put(record["index"], start, len(line))
        start += len(line)
    if missing := sum(1 for _ in lines.missing()):
        raise InputError(
            f"{folder} holds an unfinished campaign ({len(lines) - missing} of {len(lines)} trials); "
            f"finish it with 'craftsim {command} --resume --out {folder}' and the options that it was begun with"
        )
    return FinishedCampaign(folder, header, Records(place, lines))

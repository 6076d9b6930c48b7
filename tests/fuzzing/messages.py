"""Damaged messages of robots and of those who drive them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgpack
import numpy as np

from craftsim.errors import InputError
from craftsim.models.measuring import CarMeasurement
from craftsim.robots.messages import Commands, Measurements, MessageError, TruePoses, pack, unpack
from craftsim.skills.skill import Command
from fuzzing.mutations import mutated_bytes, mutated_document

_CAR = CarMeasurement(0.5, 1.0, 2.0, 0.0, 3.0, 0.1, -0.1, (1.0, 2.0, 3.0, 4.0), 0.045, 30.0, 1, 3.1)
_POSE = (0.0, 1.0, 2.0, 0.5, -0.5, 0.5, 0.5)
_MESSAGES = [
    pack(message)
    for message in (
        Measurements(7, 0.5, 3, -0.01, 0, (_CAR, _CAR)),
        Commands(3, 0.6, (Command((1.0, 2.0, 3.0, 4.0), 0.05, -0.3),)),
        TruePoses(7, 0.5, (_POSE,), (_POSE, _POSE), (3.1,), 2),
    )
]


def message(rng: np.random.Generator, folder: Path) -> None:
    """Read a damaged message of a robot or of its driver."""
    del folder
    sent = _MESSAGES[rng.integers(len(_MESSAGES))]
    if rng.random() < 0.5:
        data = mutated_bytes(sent, rng)
    else:
        data = msgpack.packb(mutated_document(msgpack.unpackb(sent), rng), default=str)
    try:
        unpack(data)
    except MessageError as error:
        raise InputError(str(error)) from error


TARGETS: dict[str, Callable[[np.random.Generator, Path], None]] = {"message": message}

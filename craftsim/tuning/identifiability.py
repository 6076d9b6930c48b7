"""Which unknowns a log tells, and which it cannot: by the singular values of the residuals' Jacobian.

With every unknown in terms of how far it commonly is from what is assumed, a direction of the unknowns with the
singular value s is told to 1 / s of that. Where this is not well below 1 the log says little about the direction beyond
what was known before. The unknown in it that is easiest to measure otherwise is then held at its start, and the rest is
looked at again.

One direction is known beforehand: motion tells forces by the masses that they move and nothing else. A simulated log
would tell a little of it, since contacts and the bristles of simulated dry friction have a stiffness of their own; no
car's log should be taken to, so the direction is taken out of the Jacobian.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from craftsim.logs.log import Floats
from craftsim.tuning.unknowns import Unknown

TOLD: Final = 0.1
"""A direction counts as told where it is known to this share of its common error, or better."""
_MEMBER: Final = 0.2
"""Share of a direction's largest part that another part must have to be named with it."""


@dataclass(frozen=True)
class Untold:
    """A direction of the unknowns that a log does not tell."""

    held: str
    """The key of the unknown that is held because of it."""
    members: tuple[str, ...]
    """Keys of all that take part in it, the largest part first."""
    certainty: float
    """Standard deviation of the direction, as a share of its common error; infinite where the log says nothing."""
    text: str


def untold_directions(jacobian: Floats, unknowns: Sequence[Unknown]) -> list[Untold]:
    """Return what a log does not tell, worst first.

    Args:
        jacobian: (m, n) of the residuals in terms of their noise, by unknowns in terms of their common errors.
        unknowns: (n,) the unknowns.
    """
    scale = np.array([1 / one.usual if one.scales else 0.0 for one in unknowns])
    free, found = list(range(len(unknowns))), list[Untold]()
    while free:
        seen = jacobian[:, free]
        if all(k in free for k in np.flatnonzero(scale)) and scale.any():
            unit = scale[free] / np.linalg.norm(scale)
            seen = seen - np.outer(seen @ unit, unit)
        _, singular, directions = np.linalg.svd(seen, full_matrices=False)
        if singular[-1] * TOLD >= 1:
            break
        direction = np.abs(directions[-1])
        members = [free[k] for k in np.argsort(-direction) if direction[k] > _MEMBER * direction.max()]
        # The largest part first where none is easier to measure.
        held = max(members, key=lambda k: unknowns[k].weighed)
        certainty = 1 / float(singular[-1]) if singular[-1] > 1e-9 else float("inf")
        found.append(_untold(unknowns, held, members, certainty))
        free.remove(held)
    return found


def _untold(unknowns: Sequence[Unknown], held: int, members: Sequence[int], certainty: float) -> Untold:
    names = [unknowns[k].words for k in members]
    kept = unknowns[held].words
    if len(members) == 1:
        text = f"{kept}: the log does not tell it; it is held"
    else:
        ratio = all(unknowns[k].of_machine for k in members)
        what = "only as ratios to each other" if ratio else "only together"
        text = f"{', '.join(names[:-1])} and {names[-1]}: {what}; {kept} is held"
    return Untold(unknowns[held].key, tuple(unknowns[k].key for k in members), certainty, text)

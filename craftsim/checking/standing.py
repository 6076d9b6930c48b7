"""Where each car and thing was left by what last handled it, and how far it has been from there since."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.readback import Poses
from craftsim.models.measuring import Floats, PoseReader
from craftsim.models.world import Site

Numbers = NDArray[np.integer]


class Standing:
    """The places where cars and things should stand still, and the furthest that each has been from there.

    Machines are numbered as poses are: cars by id, then objects. A place is that of the start, or the one at which
    :meth:`leave` was called last; many small movements add up against it. What moves away and comes back counts as
    well: it is looked at after each control period.
    """

    def __init__(self, site: Site, poses: PoseReader) -> None:
        """Take the places where everything is now; the reader is one of this Site."""
        self._site = site
        self._places, self._starts = poses.places, poses.places[:, 0].copy()
        n = len(self._places)
        self._left = np.zeros((n, 7))
        self._furthest = np.zeros((n, 2))
        self.leave(range(n))

    def leave(self, machines: Sequence[int]) -> None:
        """From here on hold these against where they are now."""
        rows = list(machines)
        if rows:
            self._left[rows] = self._site.data.qpos[self._places[rows]]
            self._furthest[rows] = 0.0

    def begin(self) -> None:
        """Forget how far things have been from their places, and keep the places."""
        self.settle(range(len(self._places)))

    def settle(self, machines: Sequence[int]) -> None:
        """Forget how far these have been from their places: of what was meanwhile only where it ends counts."""
        self._furthest[list(machines)] = 0.0
        self.look()

    def look(self, _: Site | None = None) -> None:
        """Note how far everything is from its place; call it after each control period."""
        _note_away(self._site.data.qpos, self._starts, self._left, self._furthest)

    def furthest(self) -> Floats:
        """Return, (n, 2): by how many metres, and by what angle in radians, each has been away since the last begin.

        The angle is that of the one rotation that leads there.
        """
        return self._furthest.copy()


@compiled
def _note_away(qpos: Floats, places: Numbers, left: Floats, furthest: Floats) -> None:
    """Note how far each machine is from its place.

    Args:
        qpos: MjData.qpos.
        places: (n,) of each machine's free joint in qpos.
        left: (n, 7) position and quaternion of its place.
        furthest: (n, 2) metres and radians so far.
    """
    for i in range(len(places)):
        at = places[i]
        x, y, z = qpos[at] - left[i, 0], qpos[at + 1] - left[i, 1], qpos[at + 2] - left[i, 2]
        furthest[i, 0] = max(furthest[i, 0], math.sqrt(x * x + y * y + z * z))
        # From one unit quaternion to the other; the arc tangent is exact for small angles too.
        a, b, c, d = qpos[at + 3], qpos[at + 4], qpos[at + 5], qpos[at + 6]
        e, f, g, h = left[i, 3], left[i, 4], left[i, 5], left[i, 6]
        w = a * e + b * f + c * g + d * h
        x = a * f - b * e - c * h + d * g
        y = a * g - c * e - d * f + b * h
        z = a * h - d * e - b * g + c * f
        furthest[i, 1] = max(furthest[i, 1], 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(w)))


def turns(then: Poses, now: Poses) -> Floats:
    """Return, (n,), by what angle in radians each machine turned between two poses."""
    before, after = (np.concatenate((poses.car_quaternions, poses.quaternions)) for poses in (then, now))
    n, rows = len(before), np.arange(len(before))
    left, there, furthest = np.zeros((n, 7)), np.zeros((n, 7)), np.zeros((n, 2))
    left[:, 3:], there[:, 3:] = after, before
    _note_away(there.ravel(), 7 * rows, left, furthest)
    return furthest[:, 1].copy()

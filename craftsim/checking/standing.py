"""Where each car and thing was left by what last handled it, and how far it has been from there since."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.readback import Poses
from craftsim.models.measuring import Floats
from craftsim.models.sensing import PoseReader
from craftsim.models.site import Site

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
        self._places = poses.places
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
        _note_away(self._site.data.qpos, self._places[:, 0], self._left, self._furthest)

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
        furthest[i, 1] = max(furthest[i, 1], angle_between(qpos[at + 3 : at + 7], left[i, 3:7]))


def turns(then: Poses, now: Poses) -> Floats:
    """Return, (n,), by what angle in radians each machine turned between two poses."""
    before, after = (np.concatenate((poses.car_quaternions, poses.quaternions)) for poses in (then, now))
    angles = np.zeros(len(before))
    _note_turns(before, after, angles)
    return angles


@compiled
def _note_turns(before: Floats, after: Floats, angles: Floats) -> None:
    for i in range(len(before)):
        angles[i] = angle_between(before[i], after[i])


@compiled
def angle_between(one: Floats, other: Floats) -> float:
    """Return the angle in radians of the rotation from one unit quaternion to another, exact for small ones too."""
    w = one[0] * other[0] + one[1] * other[1] + one[2] * other[2] + one[3] * other[3]
    x = one[0] * other[1] - one[1] * other[0] - one[2] * other[3] + one[3] * other[2]
    y = one[0] * other[2] - one[2] * other[0] - one[3] * other[1] + one[1] * other[3]
    z = one[0] * other[3] - one[3] * other[0] - one[1] * other[2] + one[2] * other[1]
    return 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(w))

"""What the contact log does after every physics step, compiled: the net force between each two machines."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import compiled
from craftsim.models.measuring import Floats

Numbers = NDArray[np.integer]


@compiled
def note_contacts(
    geom1: Numbers,
    geom2: Numbers,
    frame: Floats,
    efc_address: Numbers,
    efc_force: Floats,
    time_s: float,
    machine: Numbers,
    n_machines: int,
    limit_n: float,
    net: Floats,
    touched: Numbers,
    since: Floats,
    peak: Floats,
    blows: Numbers,
) -> tuple[int, float]:
    """Note the pairs of machines of all contacts, and the net force of each.

    Normal forces are summed as vectors. A boss that is wedged between pads presses on them with forces that cancel
    out: they squeeze the two machines, and move neither.

    Args:
        geom1: of MuJoCo's contacts, as the next three.
        geom2: the geom that the normal points at.
        frame: (n, 9) the normal and two tangents.
        efc_address: of the first row; with elliptic cones that is the normal force (MuJoCo, mj_contactForce).
        efc_force: MjData.efc_force.
        time_s: simulated time.
        machine: (n_geom,) the machine of each geom.
        n_machines: how many there are; two of them, a < b, are the pair a * n_machines + b.
        limit_n: forces above are blows.
        net: (n_machines ** 2, 4) zeros, and zeros again afterwards.
        touched: (n_machines ** 2,) room for pairs.
        since: (n_machines ** 2,) when each pair was first seen to touch, inf for never.
        peak: (n_machines ** 2,) the hardest force of each so far.
        blows: (n_machines ** 2,) takes the pairs of blows that are new peaks.

    Returns:
        How many blows there are, and the hardest of all forces.
    """
    n_touched = 0
    for i in range(len(geom1)):
        row, one, other = efc_address[i], machine[geom1[i]], machine[geom2[i]]
        if row < 0 or one == other:
            continue
        pair = min(one, other) * n_machines + max(one, other)
        if not net[pair, 3]:
            net[pair, 3] = 1.0
            touched[n_touched] = pair
            n_touched += 1
        push = efc_force[row] if one < other else -efc_force[row]
        for k in range(3):
            net[pair, k] += push * frame[i, k]
    n_blows, hardest = 0, 0.0
    for i in range(n_touched):
        pair = touched[i]
        x, y, z = net[pair, 0], net[pair, 1], net[pair, 2]
        force = math.sqrt(x * x + y * y + z * z)
        for k in range(4):
            net[pair, k] = 0.0
        since[pair] = min(since[pair], time_s)
        hardest = max(hardest, force)
        if force > peak[pair]:
            peak[pair] = force
            if force > limit_n:
                blows[n_blows] = pair
                n_blows += 1
    return n_blows, hardest


@compiled
def note_motion(
    qpos: Floats,
    qvel: Floats,
    pose_address: Numbers,
    velocity_address: Numbers,
    fall: Floats,
    upright: Floats,
    worst: Floats,
) -> None:
    """Note how fast each machine moves down, and how upright it is.

    Args:
        qpos: MjData.qpos.
        qvel: MjData.qvel.
        pose_address: (n,) of each machine's free joint in qpos.
        velocity_address: (n,) and in qvel.
        fall: (n,) the least vertical speed of each so far.
        upright: (n,) the least cosine of its tilt.
        worst: the least fall and the least cosine of all.
    """
    for i in range(len(pose_address)):
        tilt_x, tilt_y = qpos[pose_address[i] + 4], qpos[pose_address[i] + 5]
        fall[i] = min(fall[i], qvel[velocity_address[i] + 2])
        upright[i] = min(upright[i], 1 - 2 * (tilt_x * tilt_x + tilt_y * tilt_y))
        worst[0], worst[1] = min(worst[0], fall[i]), min(worst[1], upright[i])

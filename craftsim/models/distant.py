"""Leaving out of the search for contacts what sleeps far from everything that moves.

MuJoCo sorts the bounding boxes of all bodies in each step, those of sleeping machines too, although it then finds no
contact between two that sleep, or of one with the ground. This takes most of the time of a world with hundreds of
blocks at rest. While steps run, the bodies of a machine that sleeps, and that nothing awake can reach, have therefore
neither a ``body_contype`` nor a ``body_conaffinity``; between calls of
:meth:`~craftsim.models.stepping.Stepping.run` the model is whole.

What can be reached follows from spheres around machines, and is judged again before a step as soon as anything has
moved by :data:`SLACK_M` or has woken. A machine takes part with all that fell asleep together with it, which MuJoCo
wakes together; machines that fell asleep apart do not touch, for a contact would have woken one of them. So a world
goes on bit for bit as without this, with three exceptions: a step in which MuJoCo starts over because the simulation
has broken down, one in which a callback of MuJoCo's pushes what sleeps, and a board that is out of its range by more
than its range.
"""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.arrays import Floats, Ints, Records
from craftsim.compiled.jit import Record, compiled, layout, records

SLACK_M: Final = 0.05
"""By how much what moves may have moved since distances were measured."""
_NEVER: Final = int(mujoco.mjtSleepPolicy.mjSLEEP_NEVER)
_AUTO_NEVER: Final = int(mujoco.mjtSleepPolicy.mjSLEEP_AUTO_NEVER)
_SLEEP: Final = int(mujoco.mjtEnableBit.mjENBL_SLEEP)
_SLIDE: Final = int(mujoco.mjtJoint.mjJNT_SLIDE)
_TREE: Final = layout(
    i8="qpos n_qpos dof n_dofs body n_bodies",
    f8="radius_m",
    f8x3="place",
    b1="may_move takes_part",
)
"""A machine: where its numbers lie, the sphere around its origin that holds it in any state of its joints, and where
that was when distances were measured; whether it is awake or about to wake, and whether contacts of it are looked
for."""

Bits = NDArray[np.int64]
"""Of floating-point numbers: minus zero is no zero to MuJoCo, which wakes what has it."""
WatchedArrays = tuple[
    Records, tuple[Floats, Floats], tuple[Bits, Bits, Bits], tuple[Ints, Ints], tuple[Ints, ...]
]
"""Machines; positions, and those after the last steps; velocities, applied forces by dof and by body; ``tree_asleep``
and ``tree_sleep_policy``; ``body_contype`` and ``body_conaffinity``, and both as the geoms have them."""


class Distant:
    """The sleeping machines of one world that are left out of the search for contacts, while steps run.

    Each tree of bodies is a machine with a free joint.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Watch a world."""
        self._model = model
        self._options = model.opt
        self._trees = records(model.ntree, _TREE)
        for number, tree in enumerate(self._trees):
            body = int(model.tree_bodyadr[number])
            tree["body"] = body
            tree["n_bodies"] = model.tree_bodynum[number]
            tree["dof"] = model.tree_dofadr[number]
            tree["n_dofs"] = model.tree_dofnum[number]
            tree["qpos"] = model.jnt_qposadr[model.body_jntadr[body]]
        ends = np.append(self._trees["qpos"][1:], model.nq)
        self._trees["n_qpos"] = ends - self._trees["qpos"]
        self._kept_qpos = np.empty(model.nq)
        whole_contypes = np.zeros_like(model.body_contype)
        whole_conaffinities = np.zeros_like(model.body_conaffinity)
        np.bitwise_or.at(whole_contypes, model.geom_bodyid, model.geom_contype)
        np.bitwise_or.at(whole_conaffinities, model.geom_bodyid, model.geom_conaffinity)
        forces = data.qfrc_applied, data.xfrc_applied.ravel()
        self.watched: WatchedArrays = (
            self._trees,
            (data.qpos, self._kept_qpos),
            (data.qvel.view(np.int64), forces[0].view(np.int64), forces[1].view(np.int64)),
            (data.tree_asleep, model.tree_sleep_policy),
            (model.body_contype, model.body_conaffinity, whole_contypes, whole_conaffinities),
        )
        """What the compiled functions take."""
        self.measure()

    def measure(self) -> None:
        """Measure the machines, whose sizes have changed; in the next steps all take part."""
        for tree in self._trees:
            bodies = range(tree["body"], tree["body"] + tree["n_bodies"])
            tree["radius_m"] = _radius_m(self._model, bodies)
        self.forget()

    def forget(self) -> None:
        """Let all machines take part in the next steps: the state is another one, and MuJoCo may wake any of them."""
        self._kept_qpos[:] = np.nan

    @property
    def is_on(self) -> bool:
        """Whether machines may sleep at all."""
        return bool(self._options.enableflags & _SLEEP)


def _radius_m(model: mujoco.MjModel, bodies: range) -> float:
    """Return the radius of the sphere around the origin of a machine that holds it in any state of its joints."""
    reach_m = {bodies[0]: 0.0}
    radius_m = 0.0
    for body in bodies:
        if body != bodies[0]:
            # A joint turns a body about its place, which need not be the body's origin.
            reach_m[body] = reach_m[int(model.body_parentid[body])]
            reach_m[body] += float(np.linalg.norm(model.body_pos[body]))
            first = int(model.body_jntadr[body])
            for joint in range(first, first + int(model.body_jntnum[body])):
                reach_m[body] += 2 * float(np.linalg.norm(model.jnt_pos[joint]))
                if model.jnt_type[joint] == _SLIDE:
                    reach_m[body] += _travel_m(model, joint)
        geom = int(model.body_geomadr[body])
        for number in range(geom, geom + int(model.body_geomnum[body])):
            size_m = float(np.linalg.norm(model.geom_pos[number])) + model.geom_rbound[number]
            size_m += model.geom_margin[number] + model.geom_gap[number]
            radius_m = max(radius_m, reach_m[body] + size_m)
    return radius_m


def _travel_m(model: mujoco.MjModel, joint: int) -> float:
    """Return how far a sliding joint can be from its zero; its stop may give way by its whole range."""
    if not model.jnt_limited[joint]:
        return np.inf
    low, high = model.jnt_range[joint].tolist()
    return max(abs(low), abs(high)) + high - low


@compiled
def leave_out(watched: WatchedArrays) -> None:
    """Leave out what nothing can reach that is awake, or that will be in the next step."""
    trees, positions, bits, sleep, filters = watched
    qpos, kept_qpos = positions
    velocities, forces, body_forces = bits
    asleep, policies = sleep
    for number in range(len(trees)):
        tree = trees[number]
        may_move = asleep[number] < 0 or policies[number] in (_NEVER, _AUTO_NEVER)
        # MuJoCo wakes what has been moved or is pushed from outside.
        for place in range(tree.qpos, tree.qpos + tree.n_qpos):
            may_move = may_move or qpos[place] != kept_qpos[place]
        for place in range(tree.dof, tree.dof + tree.n_dofs):
            may_move = may_move or velocities[place] != 0 or forces[place] != 0
        for place in range(6 * tree.body, 6 * (tree.body + tree.n_bodies)):
            may_move = may_move or body_forces[place] != 0
        tree.may_move = may_move
    _filter(trees, qpos, asleep, filters)


@compiled
def look_again(watched: WatchedArrays) -> None:
    """Judge again what can be reached, where something has woken or moved too far for the last judgement."""
    trees, positions, _, sleep, filters = watched
    qpos = positions[0]
    asleep = sleep[0]
    is_stale = False
    for number in range(len(trees)):
        tree = trees[number]
        if asleep[number] < 0 and not tree.may_move:
            tree.may_move = True
            is_stale = True
        if tree.may_move:
            way_2 = 0.0
            for axis in range(3):
                way_2 += (qpos[tree.qpos + axis] - tree.place[axis]) ** 2
            # Negated, so that NaN counts as too far.
            is_stale = is_stale or not way_2 <= SLACK_M**2
    if is_stale:
        _filter(trees, qpos, asleep, filters)


@compiled
def _filter(trees: Records, qpos: Floats, asleep: Ints, filters: tuple[Ints, ...]) -> None:
    """Measure all distances, and leave out what sleeps far from everything that moves."""
    for number in range(len(trees)):
        tree = trees[number]
        tree.takes_part = tree.may_move
        for axis in range(3):
            tree.place[axis] = qpos[tree.qpos + axis]
    for mover in range(len(trees)):
        if trees[mover].may_move:
            for number in range(len(trees)):
                if not trees[number].takes_part and not _is_far(trees[mover], trees[number]):
                    trees[number].takes_part = True
    # MuJoCo wakes together what fell asleep together: there ``asleep`` has the next one of a circle.
    for number in range(len(trees)):
        if trees[number].takes_part and asleep[number] >= 0:
            following = asleep[number]
            while following != number and following >= 0 and not trees[following].takes_part:
                trees[following].takes_part = True
                following = asleep[following]
    contypes, conaffinities, whole_contypes, whole_conaffinities = filters
    for number in range(len(trees)):
        tree = trees[number]
        for body in range(tree.body, tree.body + tree.n_bodies):
            if tree.takes_part:
                contypes[body] = whole_contypes[body]
                conaffinities[body] = whole_conaffinities[body]
            else:
                contypes[body] = 0
                conaffinities[body] = 0


@compiled
def _is_far(mover: Record, sleeper: Record) -> bool:
    """Return whether a machine that moves cannot reach one that sleeps before distances are measured again."""
    distance_2 = 0.0
    for axis in range(3):
        distance_2 += (mover.place[axis] - sleeper.place[axis]) ** 2
    reach_m = mover.radius_m + sleeper.radius_m + SLACK_M
    # A comparison with NaN is false: such a machine is near.
    return distance_2 > reach_m**2


@compiled
def put_back(watched: WatchedArrays) -> None:
    """Make the filters whole, and keep the positions, by which it is seen what is moved before the next steps."""
    _, positions, _, _, filters = watched
    qpos, kept_qpos = positions
    for place in range(len(qpos)):
        kept_qpos[place] = qpos[place]
    contypes, conaffinities, whole_contypes, whole_conaffinities = filters
    for body in range(len(contypes)):
        contypes[body] = whole_contypes[body]
        conaffinities[body] = whole_conaffinities[body]

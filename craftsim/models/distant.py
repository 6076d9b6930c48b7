"""Leaving out of the search for contacts what sleeps far from everything that moves.

MuJoCo sorts the bounding boxes of all bodies in each step, those of sleeping machines too, although it then finds no
contact between two that sleep, or of one with the ground. A world of hundreds of blocks at rest spends most of its time
so. While steps run, the bodies of a machine that sleeps, and that nothing awake can reach, have therefore neither a
``body_contype`` nor a ``body_conaffinity``; outside of :meth:`Distant.leave_out` and :meth:`Distant.put_back` the model
is as it was compiled.

What can be reached follows from spheres around machines, and is judged again before a step as soon as anything has
moved by :data:`SLACK_M` or has woken. It does not depend on speeds. A machine that has been near stays with all that
fell asleep together with it, which MuJoCo wakes together. So a world goes on bit for bit as without this.
"""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np

from craftsim.compiled.arrays import Floats, Ints, Records
from craftsim.compiled.jit import Record, compiled, layout, records

SLACK_M: Final = 0.05
"""By how much what moves may have moved since distances were measured."""
_NEVER: Final = int(mujoco.mjtSleepPolicy.mjSLEEP_NEVER)
_SLEEP: Final = int(mujoco.mjtEnableBit.mjENBL_SLEEP)
_FREE: Final = int(mujoco.mjtJoint.mjJNT_FREE)
_SLIDE: Final = int(mujoco.mjtJoint.mjJNT_SLIDE)
_TREE: Final = layout(
    i8="qpos n_qpos dof n_dofs body n_bodies",
    f8="radius_m",
    f8x3="place",
    b1="moves is_near",
)
"""A machine: where its numbers lie, the sphere around its origin that holds it in any state of its joints, and where
that was when distances were measured."""

WatchedArrays = tuple[
    Records, tuple[Floats, Floats, Floats, Floats, Floats], tuple[Ints, Ints], tuple[Ints, ...]
]
"""Machines; positions, those after the last steps, speeds, applied forces by dof and by body; ``tree_asleep`` and
``tree_sleep_policy``; ``body_contype`` and ``body_conaffinity``, and both as they were compiled."""


class Distant:
    """The sleeping machines of one world that are left out of the search for contacts, while steps run."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Watch a world."""
        self._model = model
        self._options = model.opt
        self._trees = records(model.ntree, _TREE)
        for number, tree in enumerate(self._trees):
            body = int(model.tree_bodyadr[number])
            joint = int(model.body_jntadr[body])
            tree["body"] = body
            tree["n_bodies"] = model.tree_bodynum[number]
            tree["dof"] = model.tree_dofadr[number]
            tree["n_dofs"] = model.tree_dofnum[number]
            tree["qpos"] = model.jnt_qposadr[joint]
        ends = np.append(self._trees["qpos"][1:], model.nq)
        self._trees["n_qpos"] = ends - self._trees["qpos"]
        self.measure()
        after_last_steps = data.qpos.copy()
        forces = data.qfrc_applied, data.xfrc_applied.ravel()
        filters = model.body_contype, model.body_conaffinity
        self.watched: WatchedArrays = (
            self._trees,
            (data.qpos, after_last_steps, data.qvel, *forces),
            (data.tree_asleep, model.tree_sleep_policy),
            (*filters, *(compiled_filter.copy() for compiled_filter in filters)),
        )
        """What the compiled functions take."""

    def measure(self) -> None:
        """Measure the machines, whose sizes have changed."""
        for tree in self._trees:
            bodies = range(tree["body"], tree["body"] + tree["n_bodies"])
            tree["radius_m"] = _radius_m(self._model, bodies)

    @property
    def is_on(self) -> bool:
        """Whether machines may sleep at all."""
        return bool(self._options.enableflags & _SLEEP)


def _radius_m(model: mujoco.MjModel, bodies: range) -> float:
    """Return the radius of the sphere around the origin of a machine that holds it in any state of its joints."""
    reach_m = dict.fromkeys(bodies, 0.0)
    radius_m = 0.0
    for body in bodies:
        first = int(model.body_jntadr[body])
        joints = range(first, first + int(model.body_jntnum[body]))
        if body == bodies[0]:
            if len(joints) != 1 or model.jnt_type[first] != _FREE:
                return np.inf
        else:
            # A joint turns a body about its place, which need not be the body's origin.
            reach_m[body] = reach_m[int(model.body_parentid[body])]
            reach_m[body] += float(np.linalg.norm(model.body_pos[body]))
            for joint in joints:
                reach_m[body] += 2 * float(np.linalg.norm(model.jnt_pos[joint]))
                if model.jnt_type[joint] == _SLIDE:
                    reach_m[body] += _travel_m(model, joint)
        geom = int(model.body_geomadr[body])
        for number in range(geom, geom + int(model.body_geomnum[body])):
            size_m = float(np.linalg.norm(model.geom_pos[number])) + model.geom_rbound[number]
            radius_m = max(radius_m, reach_m[body] + size_m + model.geom_margin[number])
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
    trees, state, sleep, filters = watched
    qpos, kept_qpos, speeds, forces, body_forces = state
    asleep, policies = sleep
    for number in range(len(trees)):
        tree = trees[number]
        moves = asleep[number] < 0 or policies[number] == _NEVER
        # MuJoCo wakes what has been moved or is pushed from outside.
        for place in range(tree.qpos, tree.qpos + tree.n_qpos):
            moves = moves or qpos[place] != kept_qpos[place]
        for place in range(tree.dof, tree.dof + tree.n_dofs):
            moves = moves or speeds[place] != 0.0 or forces[place] != 0.0
        for place in range(6 * tree.body, 6 * (tree.body + tree.n_bodies)):
            moves = moves or body_forces[place] != 0.0
        tree.moves = moves
    _filter(trees, qpos, asleep, filters)


@compiled
def look_again(watched: WatchedArrays) -> None:
    """Judge again what can be reached, where something has woken or moved too far for the last judgement."""
    trees, state, sleep, filters = watched
    qpos = state[0]
    asleep = sleep[0]
    is_stale = False
    for number in range(len(trees)):
        tree = trees[number]
        if asleep[number] < 0 and not tree.moves:
            tree.moves = True
            is_stale = True
        if tree.moves:
            way_2 = 0.0
            for axis in range(3):
                way_2 += (qpos[tree.qpos + axis] - tree.place[axis]) ** 2
            # So that a number that is none counts as well.
            is_stale = is_stale or not way_2 <= SLACK_M**2
    if is_stale:
        _filter(trees, qpos, asleep, filters)


@compiled
def _filter(trees: Records, qpos: Floats, asleep: Ints, filters: tuple[Ints, ...]) -> None:
    """Measure all distances, and leave out what sleeps far from everything that moves."""
    for number in range(len(trees)):
        tree = trees[number]
        tree.is_near = tree.moves
        for axis in range(3):
            tree.place[axis] = qpos[tree.qpos + axis]
    for mover in range(len(trees)):
        if trees[mover].moves:
            for number in range(len(trees)):
                if not trees[number].is_near and not _is_far(trees[mover], trees[number]):
                    trees[number].is_near = True
    # MuJoCo wakes together what fell asleep together: there ``asleep`` has the next one of a circle.
    for number in range(len(trees)):
        if trees[number].is_near and asleep[number] >= 0:
            following = asleep[number]
            while following != number and following >= 0 and not trees[following].is_near:
                trees[following].is_near = True
                following = asleep[following]
    contypes, conaffinities, whole_contypes, whole_conaffinities = filters
    for number in range(len(trees)):
        tree = trees[number]
        for body in range(tree.body, tree.body + tree.n_bodies):
            contypes[body] = whole_contypes[body] if tree.is_near else 0
            conaffinities[body] = whole_conaffinities[body] if tree.is_near else 0


@compiled
def _is_far(mover: Record, sleeper: Record) -> bool:
    """Return whether a machine that moves cannot reach one that sleeps before distances are measured again."""
    distance_2 = 0.0
    for axis in range(3):
        distance_2 += (mover.place[axis] - sleeper.place[axis]) ** 2
    reach_m = mover.radius_m + sleeper.radius_m + SLACK_M
    # So that a number that is none is near.
    return distance_2 > reach_m**2


@compiled
def put_back(watched: WatchedArrays) -> None:
    """Have the filters as they were compiled, and keep the positions."""
    _, state, _, filters = watched
    qpos = state[0]
    kept_qpos = state[1]
    for place in range(len(qpos)):
        kept_qpos[place] = qpos[place]
    contypes, conaffinities, whole_contypes, whole_conaffinities = filters
    for body in range(len(contypes)):
        contypes[body] = whole_contypes[body]
        conaffinities[body] = whole_conaffinities[body]

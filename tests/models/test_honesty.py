"""Nothing but motors and contacts moves the world: what the compiled models and the MJCF files hold."""

import itertools
import re
from dataclasses import replace
from importlib.resources import as_file, files
from pathlib import Path

import mujoco
import numpy as np
from discrete.drawn import draw

from craftsim.discrete.files.blueprint import read_blueprint
from craftsim.discrete.grid import Kind
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.world import PhysicsWorld

PARTS = ("ground", "block", "flag", "wall", "slope", "smartcar")
ALL_KINDS = draw(
    (4, 4, 2),
    [
        *((Kind.WALL, (0, 0, 1), 0), (Kind.WALL, (1, 0, 1), 0), (Kind.BLOCK, (0, 1, 1), 0)),
        *((Kind.FLAG, (1, 1, 1), 0), (Kind.BODY, (0, 2, 1), 0), (Kind.FSLOPE, (0, 3, 1), 0)),
    ],
    [(3, 0, 1, 0, 0, 0, 0), (3, 1, 1, 0, 0, 0, 0)],
)


def compiled(name: str) -> mujoco.MjModel:
    """Return a part alone, or the demo's scene."""
    if name.startswith("all kinds, "):
        machines = replace(NOMINAL, drive=name.removeprefix("all kinds, "))
        return PhysicsWorld(ALL_KINDS, machines=machines).model
    if name != "demo":
        with as_file(files("craftsim.mjcf")) as folder:
            return mujoco.MjModel.from_xml_path(str(folder / f"{name}.xml"))
    with as_file(files("craftsim.data")) as data:
        drawing = read_blueprint(data / "blueprints" / "simple_two_story.yaml")
    return PhysicsWorld(drawing.grid(np.random.default_rng(0))).model


def test_no_model_has_hidden_helpers():
    """No equality constraint, mocap body, gravity compensation, tendon, or contact taken out by hand."""
    for name in (*PARTS, "demo", "all kinds, rollers", "all kinds, wheels"):
        model = compiled(name)
        assert model.neq == 0
        assert model.nmocap == 0
        assert not model.body_gravcomp.any()
        assert model.nexclude == 0
        assert model.ntendon == 0
        assert model.opt.gravity.tolist() == [0, 0, -9.81]
        assert model.opt.disableflags == int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
        assert not model.opt.wind.any()
        assert (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT).all()
        assert (model.jnt_type[model.actuator_trnid[:, 0]] != mujoco.mjtJoint.mjJNT_FREE).all()


FAMILIES = {
    "ground": "ground",
    "(block|flag)/(deck|frame|leg|foot)": "table",
    "wall/(deck|frame|leg|foot)": "wall",
    "car/hull": "hull",
    "car/(plate|boss)": "board",
    "car/guard": "guard",
    "car/roller": "roller",
    "car/tyre": "tyre",
    "slope/(incline|wall)": "base",
    "slope/pad": "pad",
    "slope/gear": "gear",
    "slope/flap": "flap",
}
"""What geoms are, by their names without numbers and sides."""


def family(name: str) -> str:
    plain = re.sub(r"\d+(?=/)|(_(fl|fr|rl|rr|left|right|front|back))?\d*$", "", name)
    return next(kind for pattern, kind in FAMILIES.items() if re.fullmatch(pattern, plain))


def pairs_of(*lines: str, machine: str) -> set[tuple[str, str, str]]:
    """Return (machine, family, family) of lines such as "hull: guard board"."""
    found = set()
    for line in lines:
        first, others = line.split(": ")
        found |= {(machine, *sorted((first, other))) for other in others.split()}
    return found


ROLLERS_TOUCH = "on all that is no car the rollers themselves touch"
DROPPED = {
    "one rigid body": pairs_of(
        "table: table",
        "wall: wall",
        "board: board",
        "base: base pad gear",
        "pad: pad gear",
        "gear: gear",
        machine="same",
    ),
    "neither can move": pairs_of("ground: wall", "wall: wall", machine="other"),
    "they turn on the chassis, and slide in it": pairs_of("hull: guard board", machine="same"),
    "rollers turn in the wheel, within its envelope, which itself touches the rest of the car": pairs_of(
        "roller: roller guard hull board", machine="same"
    ),
    "the flap's root is notched for the gears about its axis, and its convex shape is not": pairs_of(
        "flap: gear", machine="same"
    ),
    "the incline is between the flap and the pads": pairs_of("flap: pad", machine="same"),
    "between cars the guard, the envelope of a wheel's rollers, touches in their place": pairs_of(
        "roller: roller guard hull board", machine="other"
    ),
    ROLLERS_TOUCH: pairs_of("guard: ground table wall base pad gear flap", machine="other"),
}
"""The pairs of solids that do not touch each other in physics, in one machine and of two, by the reason why not."""


def filtered(model: mujoco.MjModel) -> tuple[set[tuple[int, int]], set[tuple[int, int]]]:
    """Return the pairs of solid geoms that can touch, and those that a filter of MuJoCo drops.

    Filters are contype and conaffinity, one rigid body (the world and all that is fixed to it is one), and a body with
    its parent. An explicit pair overrides them all.
    """
    solid = np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist()
    explicit = {
        frozenset(p) for p in zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
    }
    rigid = model.body_weldid[model.geom_bodyid]
    parent = model.body_weldid[model.body_parentid[rigid]]
    touch, dropped = set(), set()
    for a, b in itertools.combinations(solid, 2):
        bits = (
            model.geom_contype[a] & model.geom_conaffinity[b]
            | model.geom_contype[b] & model.geom_conaffinity[a]
        )
        child = rigid[a] and rigid[b] and (parent[a] == rigid[b] or parent[b] == rigid[a])
        meet = frozenset((a, b)) in explicit or (bits and rigid[a] != rigid[b] and not child)
        (touch if meet else dropped).add((a, b))
    return touch, dropped


def named(
    model: mujoco.MjModel, pairs: set[tuple[int, int]], part: str
) -> set[tuple[str, str, str]]:
    """Return (machine, family, family) of pairs of geoms; those of a part alone have no prefix but its name."""
    root = model.body_rootid[model.geom_bodyid]
    found = set()
    for pair in pairs:
        names = (model.geom(g).name for g in pair)
        first, second = sorted(
            family(n if "/" in n or n == "ground" else f"{part}/{n}") for n in names
        )
        found.add(("same" if root[pair[0]] == root[pair[1]] else "other", first, second))
    return found


def listed(drive: str) -> set[tuple[str, str, str]]:
    """Return the pairs of a drive: a tyre takes the place of rollers, and guards do not turn and touch things."""
    pairs = set().union(*DROPPED.values())
    if drive == "rollers":
        return pairs
    pairs -= DROPPED[ROLLERS_TOUCH]
    swapped = {(m, *sorted("tyre" if f == "roller" else f for f in (a, b))) for m, a, b in pairs}
    return swapped | pairs_of("guard: guard board", machine="same")


def test_every_pair_that_a_filter_drops_is_listed_with_a_reason():
    for name in (*PARTS, "demo", "all kinds, rollers", "all kinds, wheels"):
        model = compiled(name)
        part = name.replace("smart", "")
        touch, dropped = (named(model, pairs, part) for pairs in filtered(model))
        expected = listed("wheels" if "wheels" in name or name == "demo" else "rollers")
        assert dropped <= expected
        assert not touch & expected
        if name.startswith("all kinds"):
            assert dropped == expected, "what is listed is dropped"


def test_mujoco_drops_exactly_these_pairs():
    """With margins so wide that all is near, MuJoCo itself says which pairs can touch."""
    for name in ("slope", "smartcar"):
        model = compiled(name)
        touch, _ = filtered(model)
        model.body_margin[:] = model.geom_margin[:] = model.pair_margin[:] = 1.0
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        assert {tuple(sorted(pair)) for pair in data.contact.geom.tolist()} == touch


def test_the_mjcf_files_ask_for_no_hidden_help():
    with as_file(files("craftsim.mjcf")) as folder:
        for path in sorted(Path(folder).glob("*.xml")):
            text = path.read_text(encoding="utf-8")
            for word in (
                "<equality",
                "mocap=",
                "gravcomp",
                "<exclude",
                "<weld",
                "<connect",
                "<key",
            ):
                assert word not in text, f"{path.name} has {word}"

"""Nothing but motors and contacts moves the world: in the compiled models, and in the source of the package."""

import ast
import itertools
import re
from importlib.resources import as_file, files
from pathlib import Path

import mujoco
import numpy as np
import pytest
from drawn import draw

import craftsim
from craftsim.discrete.files.blueprint import read_blueprint
from craftsim.discrete.grid import Kind
from craftsim.models.site import Site

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
    if name == "all kinds":
        return Site(ALL_KINDS).model
    if name != "demo":
        with as_file(files("craftsim.mjcf")) as folder:
            return mujoco.MjModel.from_xml_path(str(folder / f"{name}.xml"))
    with as_file(files("craftsim.data")) as data:
        drawing = read_blueprint(data / "blueprints" / "simple_two_story.yaml")
    return Site(drawing.grid(np.random.default_rng(0))).model


@pytest.mark.parametrize("name", [*PARTS, "demo"])
def test_no_model_has_hidden_helpers(name):
    """No equality constraint, mocap body, gravity compensation, tendon, or contact taken out by hand."""
    model = compiled(name)
    assert model.neq == 0
    assert model.nmocap == 0
    assert not model.body_gravcomp.any()
    assert model.nexclude == 0
    assert model.ntendon == 0
    assert model.opt.gravity.tolist() == [0, 0, -9.81]
    assert model.opt.disableflags == 0
    assert not model.opt.wind.any()
    assert (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)).all()


FAMILIES = {
    "ground": "ground",
    "(block|flag)/(deck|frame|leg|foot)": "table",
    "wall/(deck|frame|leg|foot)": "wall",
    "car/hull": "hull",
    "car/(plate|boss)": "board",
    "car/guard": "guard",
    "car/roller": "roller",
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
    "on all that is no car the rollers themselves touch": pairs_of(
        "guard: ground table wall base pad gear flap", machine="other"
    ),
}
"""The pairs of solids that do not touch each other in physics, in one machine and of two, by the reason why not."""


def filtered(model: mujoco.MjModel) -> tuple[set[tuple[int, int]], set[tuple[int, int]]]:
    """Return the pairs of solid geoms that can touch, and those that a filter of MuJoCo drops.

    Filters are contype and conaffinity, one rigid body (the world and all that is fixed to it is one), and a body with
    its parent. An explicit pair overrides them all.
    """
    solid = np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist()
    explicit = {frozenset(p) for p in zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)}
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


def named(model: mujoco.MjModel, pairs: set[tuple[int, int]], part: str) -> set[tuple[str, str, str]]:
    """Return (machine, family, family) of pairs of geoms; those of a part alone have no prefix but its name."""
    root = model.body_rootid[model.geom_bodyid]
    found = set()
    for pair in pairs:
        names = (model.geom(g).name for g in pair)
        first, second = sorted(family(n if "/" in n or n == "ground" else f"{part}/{n}") for n in names)
        found.add(("same" if root[pair[0]] == root[pair[1]] else "other", first, second))
    return found


@pytest.mark.parametrize("name", [*PARTS, "demo", "all kinds"])
def test_every_pair_that_a_filter_drops_is_listed_with_a_reason(name):
    model = compiled(name)
    touch, dropped = (named(model, pairs, name.replace("smart", "")) for pairs in filtered(model))
    listed = set().union(*DROPPED.values())
    assert dropped <= listed
    assert not touch & listed
    if name == "all kinds":
        assert dropped == listed, "what is listed is dropped"


@pytest.mark.parametrize("name", ["slope", "smartcar"])
def test_mujoco_drops_exactly_these_pairs(name):
    """With margins so wide that all is near, MuJoCo itself says which pairs can touch."""
    model = compiled(name)
    touch, _ = filtered(model)
    model.body_margin[:] = model.geom_margin[:] = model.pair_margin[:] = 1.0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert {tuple(sorted(pair)) for pair in data.contact.geom.tolist()} == touch


# The source ---------------------------------------------------------------------------------------------------------

STATE = {"qpos", "qvel"}
FORBIDDEN = {"xfrc_applied", "qfrc_applied", "mocap_pos", "mocap_quat", "gravcomp", "body_gravcomp", "nmocap"}
STATE_SETTERS = {
    *(
        "mj_setState",
        "mj_resetData",
        "mj_resetDataKeyframe",
        "mj_resetDataDebug",
        "mj_copyData",
        "mj_copyState",
    ),
    *("mj_setKeyframe", "mj_integratePos", "mj_extractState", "mj_applyFT"),
}
ARRAY_METHODS = {
    "fill",
    "put",
    "itemset",
    "sort",
    "partition",
    "setfield",
    "resize",
    "setflags",
    "__setitem__",
}
ARRAY_WRITERS = {"copyto", "put", "place", "putmask", "put_along_axis", "fill_diagonal"}
ALLOWED = {"craftsim/models/site.py": {"Site.reset", "Site.restore"}}


def live_view(node: ast.AST) -> bool:
    """Return whether an expression is the state array itself, or a part of it that writes through."""
    while isinstance(node, ast.Subscript):
        node = node.value
    return isinstance(node, ast.Attribute) and node.attr in STATE


def of_data(node: ast.AST) -> bool:
    """Return whether an expression is a live view of MjData's state, and not a handle's address of that name."""
    while isinstance(node, ast.Subscript):
        node = node.value
    if not (isinstance(node, ast.Attribute) and node.attr in STATE):
        return False
    owner = node.value
    name = owner.attr if isinstance(owner, ast.Attribute) else owner.id if isinstance(owner, ast.Name) else ""
    return name in {"data", "d", "mjdata"} or isinstance(owner, ast.Call)


def called(node: ast.Call) -> str:
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def targets_of(node: ast.AST) -> list[ast.expr]:
    match node:
        case ast.Assign():
            found = list(node.targets)
        case ast.AugAssign() | ast.AnnAssign() | ast.For() | ast.NamedExpr() | ast.comprehension():
            found = [node.target]
        case ast.withitem(optional_vars=ast.expr() as target):
            found = [target]
        case ast.Delete():
            found = list(node.targets)
        case _:
            found = []
    flat: list[ast.expr] = []
    while found:
        target = found.pop()
        if isinstance(target, ast.Tuple | ast.List):
            found += target.elts
        elif isinstance(target, ast.Starred):
            found.append(target.value)
        else:
            flat.append(target)
    return flat


def writes_state(node: ast.AST) -> bool:
    """Return whether one syntax node writes positions or velocities, or keeps a name through which one could."""
    if any(live_view(target) for target in targets_of(node)):
        return True
    if isinstance(node, ast.Assign | ast.NamedExpr | ast.AnnAssign):
        value = node.value
        whole = isinstance(value, ast.Attribute)
        part = isinstance(value, ast.Subscript) and isinstance(value.slice, ast.Slice)
        return (whole or part) and of_data(value)
    if not isinstance(node, ast.Call):
        return False
    name = called(node)
    passed = [*node.args, *(k.value for k in node.keywords)]
    if name in STATE_SETTERS:
        return True
    if name in ARRAY_METHODS and isinstance(node.func, ast.Attribute) and live_view(node.func.value):
        return True
    if name in ARRAY_WRITERS and any(live_view(a) for a in passed):
        return True
    if name == "setattr" and any(isinstance(a, ast.Constant) and a.value in STATE for a in passed):
        return True
    if name.startswith(("mju_", "mj_")) and any(of_data(a) for a in passed):
        return True
    if isinstance(node.func, ast.Attribute) and node.func.attr == "at" and any(of_data(a) for a in passed):
        return True
    return any(k.arg == "out" and live_view(k.value) for k in node.keywords)


def names_forbidden(node: ast.AST) -> bool:
    match node:
        case ast.Attribute(attr=name) | ast.Name(id=name) | ast.keyword(arg=name) | ast.Constant(value=name):
            return name in FORBIDDEN or name == "mocap"
    return False


def violations(source: str, allowed: set[str]) -> list[int]:
    """Return the lines that write the state outside the allowed functions, or apply a forbidden help anywhere."""
    found = []

    def visit(node: ast.AST, where: tuple[str, ...]) -> None:
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            where = (*where, node.name)
        if names_forbidden(node) or (writes_state(node) and ".".join(where) not in allowed):
            found.append(getattr(node, "lineno", 0))
        for child in ast.iter_child_nodes(node):
            visit(child, where)

    visit(ast.parse(source), ())
    return found


PLANTED = [
    "data.qpos[3] = 1.0",
    "site.data.qpos[:] = x",
    "site.data.qvel = x",
    "data.qvel[a:b] += 1",
    "data.qpos[a][b] = 1",
    "data.joint('x').qpos = 0",
    "a, (data.qpos[0], b) = 1, (2, 3)",
    "for data.qpos[0] in range(3): pass",
    "[0 for data.qvel[0] in x]",
    "with f() as data.qvel: pass",
    "data.qpos[0]: float = 3",
    "q = data.qpos",
    "q = self.data.qvel[0:7]",
    "(q := data.qpos)",
    "data.qpos.fill(0)",
    "data.qpos[0:3].put(0, 1)",
    "np.copyto(data.qpos, x)",
    "np.put(site.data.qvel, 0, 1)",
    "np.add(a, b, out=data.qpos)",
    "np.add.at(data.qpos, 0, 1)",
    "setattr(data, 'qpos', x)",
    "mujoco.mj_setState(model, data, x, 1)",
    "mj_resetData(model, data)",
    "mujoco.mj_copyData(a, model, b)",
    "mujoco.mju_copy(data.qpos, x)",
    "mujoco.mj_integratePos(model, data.qpos, v, 0.1)",
    "class Site:\n    def jump(self):\n        self.data.qpos[0] = 1",
    "def reset(self):\n    self.data.qpos[0] = 1",
    "data.xfrc_applied[1] = 1",
    "f = data.qfrc_applied",
    "data.mocap_pos[0] = x",
    "body.gravcomp = 1",
    "spec.worldbody.add_body(mocap=True)",
    "setattr(data, 'xfrc_applied', x)",
]
INNOCENT = [
    "x = float(data.qpos[3])",
    "pose = self.data.qpos[a : a + 7].copy()",
    "address = body.qpos",
    "speeds = data.qvel[handle.dofs].copy()",
    "data.ctrl[0] = 1",
    "class Site:\n    def reset(self):\n        self.data.qpos[0] = 1",
    "class Drive:\n    qpos: int",
    "Drive(qpos=int(joint.qposadr[0]))",
]


@pytest.mark.parametrize("source", PLANTED)
def test_the_check_catches_a_planted_violation(source):
    assert violations(source, {"Site.reset"})


@pytest.mark.parametrize("source", INNOCENT)
def test_the_check_lets_reading_pass(source):
    assert not violations(source, {"Site.reset"})


def test_only_reset_and_restore_write_positions_and_velocities():
    package = Path(craftsim.__file__).parent
    paths = sorted(package.rglob("*.py"))
    assert len(paths) > 30
    found = {}
    for path in paths:
        name = path.relative_to(package.parent).as_posix()
        lines = violations(path.read_text(encoding="utf-8"), ALLOWED.get(name, set()))
        if lines:
            found[name] = lines
    assert found == {}


def test_the_allowed_writers_exist():
    """The check would pass for the wrong reason if reset and restore wrote nothing under these names."""
    package = Path(craftsim.__file__).parent
    source = (package / "models" / "site.py").read_text(encoding="utf-8")
    assert violations(source, set())
    assert violations(source, {"Site.reset"})
    assert violations(source, {"Site.restore"})


def test_the_mjcf_files_ask_for_no_hidden_help():
    with as_file(files("craftsim.mjcf")) as folder:
        for path in sorted(Path(folder).glob("*.xml")):
            text = path.read_text(encoding="utf-8")
            for word in ("<equality", "mocap=", "gravcomp", "<exclude", "<weld", "<connect", "<key"):
                assert word not in text, f"{path.name} has {word}"

"""No code of the package but reset and restore writes positions or velocities, or applies a forbidden help."""

import ast
from pathlib import Path

import craftsim

STATE = {"qpos", "qvel"}
FORBIDDEN = {
    "xfrc_applied",
    "qfrc_applied",
    "mocap_pos",
    "mocap_quat",
    "gravcomp",
    "body_gravcomp",
    "nmocap",
}
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
WORDS = {*STATE, *FORBIDDEN, *STATE_SETTERS, "mocap"}
"""Without one of these a file has nothing that is looked for."""
ARRAY_METHODS = {
    *(
        "fill",
        "put",
        "itemset",
        "sort",
        "partition",
        "setfield",
        "resize",
        "setflags",
        "__setitem__",
    )
}
ARRAY_WRITERS = {"copyto", "put", "place", "putmask", "put_along_axis", "fill_diagonal"}
ALLOWED = {
    "craftsim/models/world.py": {
        "PhysicsWorld.reset",
        "PhysicsWorld.restore",
        "PhysicsWorld.awake_copy",
    },
    "craftsim/rendering/trajectory.py": {"show_at"},
    "craftsim/robots/link.py": {"Mirror.show"},
    "craftsim/mjcf/car_reading.py": {"_Parts.__init__"},
}
"""PhysicsWorld.awake_copy writes a copy, and leaves the world as it is (tests/checking/test_contact_log.py); what is
posed has data of its own, to be drawn; a mirror shows robots elsewhere, and is never stepped,
nor is a car whose measures are read from a file, its lift at the lower end."""
DECLARED = {
    "craftsim/skills/fleet.py": {"DisturbedFleet._push", "DisturbedFleet._let_go"},
    "craftsim/models/distant.py": {"Distant.__init__"},
}
"""Where a force is applied that somebody asked for as a disturbance (``craftsim validate --disturb shove``), and where
it is read, for what is pushed wakes."""


def live_view(node: ast.AST) -> bool:
    """Return whether an expression is the state array itself, or a part of it that writes through."""
    part = isinstance(node, ast.Subscript)
    while isinstance(node, ast.Subscript):
        node = node.value
    if part and isinstance(node, ast.Name):
        # Compiled functions are given the arrays under these names.
        return node.id in STATE
    return isinstance(node, ast.Attribute) and node.attr in STATE


def of_data(node: ast.AST) -> bool:
    """Return whether an expression is a live view of MjData's state, and not a handle's address of that name."""
    while isinstance(node, ast.Subscript):
        node = node.value
    if not (isinstance(node, ast.Attribute) and node.attr in STATE):
        return False
    owner = node.value
    name = (
        owner.attr
        if isinstance(owner, ast.Attribute)
        else owner.id
        if isinstance(owner, ast.Name)
        else ""
    )
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
    if (
        name in ARRAY_METHODS
        and isinstance(node.func, ast.Attribute)
        and live_view(node.func.value)
    ):
        return True
    if name in ARRAY_WRITERS and any(live_view(a) for a in passed):
        return True
    if name == "setattr" and any(isinstance(a, ast.Constant) and a.value in STATE for a in passed):
        return True
    if name.startswith(("mju_", "mj_")) and any(of_data(a) for a in passed):
        return True
    if (
        isinstance(node.func, ast.Attribute)
        and node.func.attr == "at"
        and any(of_data(a) for a in passed)
    ):
        return True
    return any(k.arg == "out" and live_view(k.value) for k in node.keywords)


def names_forbidden(node: ast.AST) -> bool:
    match node:
        case (
            ast.Attribute(attr=name)
            | ast.Name(id=name)
            | ast.keyword(arg=name)
            | ast.Constant(value=name)
        ):
            return name in FORBIDDEN or name == "mocap"
    return False


def violations(source: str, allowed: set[str], declared: frozenset[str] = frozenset()) -> list[int]:
    """Return the lines that write the state outside the allowed functions, or apply a forbidden help anywhere."""
    found = []

    def visit(node: ast.AST, where: tuple[str, ...]) -> None:
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            where = (*where, node.name)
        helps = names_forbidden(node) and ".".join(where) not in declared
        if helps or (writes_state(node) and ".".join(where) not in allowed):
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
    "def compiled(qpos, qvel):\n    qpos[0], x = 1, 2",
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
    "class PhysicsWorld:\n    def jump(self):\n        self.data.qpos[0] = 1",
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
    "class PhysicsWorld:\n    def reset(self):\n        self.data.qpos[0] = 1",
    "class Drive:\n    qpos: int",
    "Drive(qpos=int(joint.qposadr[0]))",
]


def test_the_check_catches_a_planted_violation():
    for source in PLANTED:
        assert violations(source, {"PhysicsWorld.reset"})


def test_the_check_lets_reading_pass():
    for source in INNOCENT:
        assert not violations(source, {"PhysicsWorld.reset"})


def test_only_reset_and_restore_write_positions_and_velocities():
    package = Path(craftsim.__file__).parent
    paths = sorted(package.rglob("*.py"))
    assert len(paths) > 30
    found = {}
    for path in paths:
        name, source = path.relative_to(package.parent).as_posix(), path.read_text(encoding="utf-8")
        if not any(word in source for word in WORDS):
            continue
        declared = frozenset(DECLARED.get(name, ()))
        lines = violations(source, ALLOWED.get(name, set()), declared)
        if lines:
            found[name] = lines
    assert found == {}


def test_the_allowed_writers_exist():
    """The check would pass for the wrong reason if reset and restore wrote nothing under these names."""
    package = Path(craftsim.__file__).parent
    source = (package / "models" / "world.py").read_text(encoding="utf-8")
    assert violations(source, set())
    assert violations(source, {"PhysicsWorld.reset"})
    assert violations(source, {"PhysicsWorld.restore"})

"""Imports follow the one-way arrows between the package's rooms."""

import ast
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import craftsim

PACKAGE = Path(craftsim.__file__).parent

ROOMS = {
    "errors": "errors that a user can cause and fix",
    "version": "the version that is installed",
    "storage": "reading within limits, YAML and JSON as typed records, writing whole or not at all; optional packages",
    "compiled": "a small library over numba: one signature a function, a cache named by content, progress",
    "workers": "processes and Ray actors, with time limits; interrupts, copies, modules of a user",
    "discrete": "the grid: state, rules as codes (`kernel/`), readback, blueprints, designs, schedules; never MuJoCo",
    "tasks": "starts, goals, rewards, observations, episodes in ticks and asynchronous, registry",
    "designs": "what to build: library, random, pictures, meshes; starts for it",
    "planning": "plan files, and from start and goal to a plan",
    "mjcf": "machines: parameters with sources, builders, exported MJCF",
    "models": "worlds composed from a grid; sensors, noise, floors, randomization",
    "skills": "controllers, state estimation, executor",
    "checking": "the one judge: sets up a world, performs, reads, compares",
    "robots": "robots that are not the simulator: interface, messages, sockets; logs of cars",
    "reports": "one report, rendered as JSON, on the terminal and as HTML",
    "experiments": "trials by key, resume, bundles, statistics, comparison, minimization",
    "rendering": "trajectories, films, figures, viewer",
    "envs": "PettingZoo, Gymnasium, batches; planner as a policy",
    "learning": "networks, algorithms, demonstrations, policies, studies",
    "validation": "plans, policies and play in physics",
    "audit": "rules against physics: situations, rows, margins; recordings of CraftEnv",
    "tuning": "gains, identification",
    "reality": "recordings of real motion beside simulation",
    "testing": "conformance tests for users",
    "cli": "commands, and the options that they share",
    "__main__": "`python -m craftsim`",
}
"""What each room does. A room imports from those above it."""
TESTS = {
    "errors": ["test_choices.py"],
    "storage": ["test_storage.py", "test_yaml.py", "test_records.py", "test_writers.py"],
    "compiled": ["test_compiling.py"],
    "mjcf": ["models"],
    "reports": ["test_report.py", "test_tables.py"],
    "experiments": ["validation"],
    "testing": ["envs"],
    "cli": ["test_cli.py"],
}
"""Tests of rooms that have no folder of their name."""
ORDER = {room: number for number, room in enumerate(ROOMS)}

FORBIDDEN_IN_DISCRETE = {"mujoco", "cv2", "av", "matplotlib", "trimesh", "gymnasium", "pettingzoo"}


@cache
def _trees() -> dict[Path, ast.Module]:
    return {
        path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.rglob("*.py"))
    }


@cache
def _nodes() -> dict[Path, list[ast.AST]]:
    """Return of each file what imports, calls by a name, or defines."""
    kinds = ast.Import | ast.ImportFrom | ast.Call | ast.ClassDef | ast.FunctionDef
    return {
        path: [n for n in ast.walk(tree) if isinstance(n, kinds)] for path, tree in _trees().items()
    }


def _imports(nodes: Iterable[ast.AST], module: str) -> set[str]:
    """Return the full names of all modules that a module imports, wherever it does so."""
    names: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = ".".join([*module.split(".")[: -node.level], *([base] if base else [])])
            names.update(f"{base}.{alias.name}" for alias in node.names)
    return names


def _violations(module: str, nodes: Iterable[ast.AST]) -> list[str]:
    """Return the imports of a module (by its name in the package) that go against the arrows."""
    room = module.split(".")[1]
    imported = _imports(nodes, module)
    wrong = []
    for name in sorted(imported):
        top, *inside = name.split(".")
        if room == "discrete" and top in FORBIDDEN_IN_DISCRETE:
            wrong.append(name)
        if top != "craftsim" or not inside or inside[0] == "__version__":
            continue
        if ORDER[inside[0]] > ORDER[room]:
            wrong.append(name)
    return wrong


def test_a_module_imports_only_what_its_room_may():
    wrong = {}
    for path, nodes in _nodes().items():
        if path == PACKAGE / "__init__.py":
            assert not any(name.startswith("craftsim") for name in _imports(nodes, "craftsim"))
            continue
        module = ".".join(["craftsim", *path.relative_to(PACKAGE).with_suffix("").parts])
        wrong[module] = _violations(module, nodes)
    assert {module: names for module, names in wrong.items() if names} == {}


def _import_graph() -> dict[str, set[str]]:
    """Return which modules each module imports from anywhere in it, also for type checking alone."""
    names_by_module = {}
    for path, nodes in _nodes().items():
        module = ".".join(["craftsim", *path.relative_to(PACKAGE).with_suffix("").parts])
        imported = _imports(nodes, module)
        parents = {name.rpartition(".")[0] for name in imported}
        names_by_module[module] = imported | parents
    return {module: names & names_by_module.keys() for module, names in names_by_module.items()}


def _circles(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return what is left of a graph without all modules that lead to no circle."""
    leaves = set(graph)
    while leaves:
        leaves = {module for module, names in graph.items() if not names & graph.keys()}
        graph = {module: names for module, names in graph.items() if module not in leaves}
    return {module: names & graph.keys() for module, names in graph.items()}


def test_modules_import_each_other_in_no_circle():
    assert _circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == {}
    assert _circles({"a": {"b"}, "b": {"c", "d"}, "c": {"b"}, "d": set()}).keys() == {"a", "b", "c"}
    assert _circles(_import_graph()) == {}


def _table() -> str:
    """Return the rooms as a table."""
    lines = ["| room | what it does |", "| --- | --- |"]
    for room, what in ROOMS.items():
        if room in ("version", "__main__"):
            continue
        is_folder = (PACKAGE / room).is_dir()
        lines.append(f"| `{room}/` | {what} |" if is_folder else f"| `{room}.py` | {what} |")
    return "\n".join(lines)


def test_contributing_has_the_table_of_rooms():
    text = (PACKAGE.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert _table() in text, f"CONTRIBUTING.md should have this table:\n{_table()}"


def _map_of_tests() -> str:
    """Return the tests of rooms that have no folder of their name as a table."""
    lines = ["| room | tests |", "| --- | --- |"]
    for room, places in TESTS.items():
        lines.append(f"| `{room}` | {', '.join(f'`{place}`' for place in places)} |")
    return "\n".join(lines)


def test_each_room_has_tests_that_import_it_and_contributing_says_where():
    tests = Path(__file__).parent
    for room in ROOMS:
        if room in ("version", "__main__"):
            continue
        for place in TESTS.get(room, [room]):
            files = [tests / place]
            if files[0].is_dir():
                files = sorted(files[0].rglob("*.py"))
            text = "\n".join(path.read_text(encoding="utf-8") for path in files)
            assert re.search(rf"\bcraftsim(\.| import ){room}\b", text), (room, place)
    text = (PACKAGE.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert _map_of_tests() in text, f"CONTRIBUTING.md should have this table:\n{_map_of_tests()}"


def test_what_contributing_says_to_edit_and_to_run_exists():
    root = PACKAGE.parent
    text = (root / "CONTRIBUTING.md").read_text(encoding="utf-8")
    table = text.split("## To change something")[1].split("Work that may")[0]
    rows = [line.strip("|").split(" | ") for line in table.splitlines() if line.startswith("| ")]
    assert len(rows) > 10
    for _, edited, run, *_ in rows[1:]:
        for folder, cell in ((PACKAGE, edited), (root / "tests", run)):
            for place in re.findall(r"`([\w/]+(?:\.py|/))`", cell):
                assert list(folder.glob(f"**/{place}")), place


def _calling(*names: str) -> list[Path]:
    """Return the files that call any of some functions, or of classes."""
    return [
        path
        for path, nodes in _nodes().items()
        if {*names}
        & {n.func.id for n in nodes if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)}
    ]


def test_a_world_in_physics_is_set_up_in_one_place():
    joined = sorted({*_calling("Executor")} & {*_calling("Sensors")})
    assert joined == _calling("Judge") == [PACKAGE / "checking" / "setup.py"]


def test_there_is_one_record_of_an_attempt_one_of_an_episode_and_one_judge():
    places: dict[str, list[str]] = {}
    for path, nodes in _nodes().items():
        for node in nodes:
            if isinstance(node, ast.ClassDef | ast.FunctionDef):
                places.setdefault(node.name, []).append(str(path.relative_to(PACKAGE)))
    assert places["Attempt"] == places["Verdict"] == places["verdict_of"] == ["checking/attempt.py"]
    assert places["Episode"] == ["validation/episode.py"]
    assert places["Judge"] == ["checking/judge.py"]


def test_a_class_has_a_name_of_its_own():
    names = [
        node.name
        for tree in _trees().values()
        for node in tree.body
        if isinstance(node, ast.ClassDef)
    ]
    public = [name for name in names if not name.startswith("_")]
    assert sorted(public) == sorted(set(public))


def test_docstrings_can_be_encoded_without_which_python_3_13_compiles_no_module():
    for path, tree in _trees().items():
        for node in (tree, *_nodes()[path]):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                (ast.get_docstring(node) or "").encode()


def test_only_the_judge_compares_what_is_read_with_what_is_predicted():
    assert _calling("compare_reading", "own_differences") == [
        PACKAGE / "checking" / "judge.py",
        PACKAGE / "checking" / "pose_judge.py",
    ]


def test_an_import_against_the_arrows_is_found_and_one_along_them_is_fine():
    for module, source, wrong in [
        ("craftsim.discrete.grid", "import mujoco", 1),
        ("craftsim.discrete.grid", "def f():\n    from mujoco import MjModel", 1),
        ("craftsim.discrete.grid", "from craftsim.models import world", 1),
        ("craftsim.discrete.grid", "from craftsim import models", 1),
        ("craftsim.discrete.grid", "from ..models import world", 1),
        ("craftsim.models.world", "import craftsim.skills.move", 1),
        ("craftsim.skills.move", "from craftsim.rendering.film import Frames", 1),
        ("craftsim.reports.report", "from craftsim.experiments.session import Session", 1),
        ("craftsim.skills.move", "from craftsim.models.world import PhysicsWorld", 0),
        ("craftsim.models.world", "import mujoco\nfrom .parameters import Car", 0),
        ("craftsim.reports.report", "from craftsim.errors import InputError", 0),
        ("craftsim.cli.demo", "from craftsim.skills.move import Move", 0),
    ]:
        assert len(_violations(module, ast.walk(ast.parse(source)))) == wrong, source

"""Imports follow the one-way arrows between the package's rooms."""

import ast
from pathlib import Path

import pytest

import craftsim

PACKAGE = Path(craftsim.__file__).parent

ALLOWED = {
    "errors": set(),
    "choices": set(),
    "options": {
        "storage",
        "discrete",
        "mjcf",
        "models",
        "skills",
        "checking.setup",
        "experiments.experiment",
    },
    "extras": set(),
    "modules": set(),
    "compiling": set(),
    "workers": set(),
    "storage": set(),
    "discrete": {"storage"},
    "designs": {"storage", "discrete"},
    "mjcf": {"storage", "discrete"},
    "models": {"storage", "discrete", "mjcf"},
    "skills": {"storage", "mjcf", "models", "discrete"},
    "planning": {"discrete"},
    "logs": {"storage", "skills", "mjcf", "models", "discrete"},
    "robots": {"storage", "skills", "mjcf", "models", "discrete"},
    "checking": {"storage", "skills", "mjcf", "models", "discrete"},
    "experiments": {
        "storage",
        "checking",
        "skills",
        "models",
        "discrete",
        "mjcf",
        "reports",
    },
    "audit": {"storage", "checking", "skills", "mjcf", "models", "discrete"},
    "validation": {
        "options",
        "storage",
        "audit",
        "experiments",
        "checking",
        "rendering",
        "envs",
        "skills",
        "mjcf",
        "models",
        "discrete",
        "reports",
        "training.policy",
        "logs",
        "planning",
    },
    "tuning": {
        "storage",
        "audit",
        "experiments",
        "validation",
        "checking",
        "envs",
        "rendering",
        "skills",
        "mjcf",
        "models",
        "discrete",
        "reports",
        "logs",
    },
    "envs": {
        "planning",
        "storage",
        "checking",
        "skills",
        "mjcf",
        "models",
        "discrete",
        "rendering",
        "reports",
    },
    "studies": {"storage", "discrete", "training", "experiments", "reports"},
    "training": {
        "storage",
        "discrete",
        "mjcf.parameters",
        "checking.setup",
        "envs",
        "planning",
        "reports",
    },
    "rendering": {"storage", "checking", "skills", "mjcf", "models", "discrete", "reports"},
    "testing": {"envs", "discrete"},
    "reports": {"storage"},
    "__main__": {"cli"},
}
"""What each room may import of ours, besides itself, the version and those of SHARED; cli may import all."""

SHARED = {"choices", "compiling", "errors", "extras", "modules", "workers"}
"""What every room may import."""

FORBIDDEN_IN_DISCRETE = {"mujoco", "cv2", "av", "matplotlib", "trimesh", "gymnasium", "pettingzoo"}

FILES = sorted(PACKAGE.rglob("*.py"))


def _imports(tree: ast.AST, module: str) -> set[str]:
    """Return the full names of all modules that a module imports, wherever it does so."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = ".".join([*module.split(".")[: -node.level], *([base] if base else [])])
            names.update(f"{base}.{alias.name}" for alias in node.names)
    return names


def _violations(module: str, source: str) -> list[str]:
    """Return the imports of a module (by its name in the package) that go against the arrows."""
    room = module.split(".")[1]
    imported = _imports(ast.parse(source), module)
    wrong = []
    for name in sorted(imported):
        top, *inside = name.split(".")
        if room == "discrete" and top in FORBIDDEN_IN_DISCRETE:
            wrong.append(name)
        if top != "craftsim" or not inside or room == "cli":
            continue
        target = ".".join(inside)
        allowed = ALLOWED[room] | SHARED | {room, "__version__"}
        if not any(target == entry or target.startswith(f"{entry}.") for entry in allowed):
            wrong.append(name)
    return wrong


def _module(path: Path) -> str:
    return ".".join(["craftsim", *path.relative_to(PACKAGE).with_suffix("").parts])


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_a_module_imports_only_what_its_room_may(path):
    if path == PACKAGE / "__init__.py":
        assert not any(
            name.startswith("craftsim") for name in _imports(ast.parse(path.read_text()), "craftsim")
        )
        return
    assert _violations(_module(path), path.read_text(encoding="utf-8")) == []


def _calls(path: Path) -> set[str]:
    """Return the names of all that a file calls."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    return {node.id for node in found if isinstance(node, ast.Name)}


def test_a_world_in_physics_is_set_up_in_one_place():
    joined = [path for path in FILES if {"Executor", "Sensors"} <= _calls(path)]
    judging = [path for path in FILES if "Judge" in _calls(path)]
    assert joined == judging == [PACKAGE / "checking" / "setup.py"]


def test_there_is_one_record_of_an_attempt_one_of_an_episode_and_one_judge():
    places: dict[str, list[str]] = {}
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef | ast.FunctionDef):
                places.setdefault(node.name, []).append(str(path.relative_to(PACKAGE)))
    assert places["Attempt"] == places["Verdict"] == places["verdict_of"] == ["checking/attempt.py"]
    assert places["Episode"] == ["checking/episode.py"]
    assert places["Judge"] == ["checking/judge.py"]
    gone = {"ActionRecord", "CheckedRun", "ScheduledRun", "StepRecord", "JointStep", "CarStep", "JointSite"}
    gone |= {"EpisodeRecord", "JobRecord", "JobResult", "TrialSettings", "Evidence", "Finding"}
    assert not gone & set(places)


def test_a_class_has_a_name_of_its_own():
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in FILES]
    names = [node.name for tree in trees for node in tree.body if isinstance(node, ast.ClassDef)]
    public = [name for name in names if not name.startswith("_")]
    assert sorted(public) == sorted(set(public))


def test_only_the_judge_compares_what_is_read_with_what_is_predicted():
    assert [path for path in FILES if {"compare", "own_differences"} & _calls(path)] == [
        PACKAGE / "checking" / "judge.py"
    ]


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("craftsim.discrete.grid", "import mujoco"),
        ("craftsim.discrete.grid", "def f():\n    from mujoco import MjModel"),
        ("craftsim.discrete.grid", "from craftsim.models import world"),
        ("craftsim.discrete.grid", "from craftsim import models"),
        ("craftsim.discrete.grid", "from ..models import world"),
        ("craftsim.models.world", "import craftsim.skills.move"),
        ("craftsim.skills.move", "from craftsim.rendering.film import Frames"),
        ("craftsim.reports.report", "from craftsim.discrete.grid import Grid"),
    ],
)
def test_an_import_against_the_arrows_is_found(module, source):
    assert len(_violations(module, source)) == 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        (
            "craftsim.skills.move",
            "from craftsim.models.world import PhysicsWorld\nfrom craftsim.discrete import grid",
        ),
        ("craftsim.models.world", "import mujoco\nfrom .parameters import Car"),
        ("craftsim.reports.report", "from craftsim.errors import InputError"),
        ("craftsim.cli.demo", "from craftsim.skills.move import Move"),
    ],
)
def test_an_import_along_the_arrows_is_fine(module, source):
    assert _violations(module, source) == []

"""What several files say of the project is the same in all of them."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml
from test_rooms import ALLOWED

from craftsim.rendering.backend import DEBIAN_PACKAGES

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def _yaml(name: str):
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


@pytest.fixture
def job():
    return _yaml(".github/workflows/test.yml")["jobs"]["test"]


def test_the_citation_is_of_this_version_and_licence():
    citation = _yaml("CITATION.cff")
    assert citation["version"] == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    assert citation["title"].split(":")[0] == PROJECT["name"]


def test_the_workflow_tests_every_python_that_the_package_claims(job):
    claimed = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    assert job["strategy"]["matrix"]["python"] == claimed
    assert PROJECT["requires-python"] == f">={claimed[0]}"


def test_the_workflow_runs_make_test_with_the_libraries_of_the_renderer(job):
    commands = [step["run"] for step in job["steps"] if "run" in step]
    assert "make test" in commands
    assert any(all(name in command for name in DEBIAN_PACKAGES) for command in commands)


def test_the_hooks_are_the_checks_of_make_lint():
    hooks = [
        hook["entry"].split()[0]
        for repo in _yaml(".pre-commit-config.yaml")["repos"]
        for hook in repo["hooks"]
    ]
    lint = re.search(
        r"^lint:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert lint
    assert {Path(entry).name for entry in hooks} == set(re.findall(r"\$\(BIN\)/(\w+)", lint[1]))
    assert {"ruff", "mypy", "pre-commit"} <= {
        re.split(r"[>=!<]", name)[0] for name in PROJECT["optional-dependencies"]["dev"]
    }


def test_contributing_draws_the_rooms_as_they_are():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w.]+?)(?:/|\.py)` \| .* \| (.*) \|$", text, re.MULTILINE)
    drawn = {room: set(re.findall(r"`([\w.]+)`", imports)) for room, imports in rows}
    assert drawn.pop("__init__") == set()
    assert drawn == {room: ALLOWED[room] for room in ALLOWED if room not in ("cli", "__main__")}

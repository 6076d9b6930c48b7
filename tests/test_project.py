"""What several files say of the project is the same in all of them."""

import re
import tomllib
from importlib.metadata import requires
from itertools import chain
from pathlib import Path

import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from sizes import sizes

from craftsim.rendering.offscreen import DEBIAN_PACKAGES

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def _yaml(name: str):
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def test_the_citation_and_the_changelog_are_of_this_version_and_licence():
    citation = _yaml("CITATION.cff")
    released = re.search(
        r"^## \[(\d[^]]*)\] - (\S+)",
        (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    assert released
    assert (released[1], released[2]) == (PROJECT["version"], str(citation["date-released"]))
    assert citation["version"] == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    assert citation["title"].split(":")[0] == PROJECT["name"]


def test_the_workflow_runs_make_test_on_every_python_with_the_libraries_of_the_renderer():
    job = _yaml(".github/workflows/test.yml")["jobs"]["test"]
    claimed = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    assert job["strategy"]["matrix"]["python"] == claimed
    assert PROJECT["requires-python"] == f">={claimed[0]}"
    commands = [step["run"] for step in job["steps"] if "run" in step]
    assert "make test" in commands
    assert any(all(name in command for name in DEBIAN_PACKAGES) for command in commands)


def test_the_hooks_are_the_checks_of_make_lint():
    hooks = [
        hook["entry"].split()[0]
        for repo in _yaml(".pre-commit-config.yaml")["repos"]
        for hook in repo["hooks"]
    ]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    lint = "".join(re.findall(r"^(?:style|types):.*\n((?:\t.*\n)+)", makefile, re.MULTILINE))
    assert {Path(entry).name for entry in hooks} == set(re.findall(r"\$\(BIN\)/(\w+)", lint))
    assert {"ruff", "mypy", "pre-commit"} <= {
        re.split(r"[>=!<]", name)[0] for name in PROJECT["optional-dependencies"]["dev"]
    }


def _tested_extras() -> dict[str, list[str]]:
    """Return the extras but the one that scripts/recipes alone installs, for its size."""
    extras = PROJECT["optional-dependencies"]
    return {name: lines for name, lines in extras.items() if name != "rerun"}


def _name(requirement: str) -> str:
    return canonicalize_name(Requirement(requirement).name)


def test_the_constraints_pin_every_dependency_within_its_range_on_every_python():
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = [Requirement(line) for line in lines if not line.startswith("#")]
    versions = {
        canonicalize_name(one.name): str(one.specifier).removeprefix("==") for one in pinned
    }
    assert len(versions) == len(pinned)
    for one in pinned:
        assert re.fullmatch(r"==[0-9][0-9a-z.]*", str(one.specifier)), (
            f"{one}: one version, without a build"
        )
        assert one.marker is None
        assert one.url is None
    asked = [*PROJECT["dependencies"], *chain(*_tested_extras().values())]
    for requirement in (Requirement(line) for line in asked):
        if (name := canonicalize_name(requirement.name)) != "craftsim":
            assert requirement.specifier.contains(versions[name]), requirement
    torch = re.search(
        r"^TORCH \?= torch==(.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert torch
    assert torch[1] == versions["torch"]


def test_what_make_test_installs_needs_nothing_that_is_not_pinned():
    text = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    pinned = {_name(line) for line in text.splitlines() if not line.startswith("#")}
    requirements = map(Requirement, chain(*_tested_extras().values()))
    elsewhere = {
        canonicalize_name(requirement.name)
        for requirement in requirements
        if requirement.marker and not requirement.marker.evaluate()
    }
    for name in pinned - elsewhere:
        for line in requires(name) or []:
            requirement = Requirement(line)
            wanted = requirement.marker is None or requirement.marker.evaluate({"extra": ""})
            # A build of torch for GPUs, which CPU builds need nothing of, brings libraries of its version.
            if wanted and name != "torch":
                assert canonicalize_name(requirement.name) in pinned, f"{name} needs {line}"


def test_no_page_says_to_install_an_extra_such_that_a_copy_takes_the_place_of_the_checkout():
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")):
        for line in page.read_text(encoding="utf-8").splitlines():
            assert not re.search(r"pip install '(\.|craftsim)\[", line), f"{page.name}: {line}"


def test_the_table_of_sizes_counts_each_file_once():
    *parts, together = sizes(ROOT / "craftsim" / "discrete").values()
    assert [sum(column) for column in zip(*((row[:3]) for row in parts), strict=True)] == list(
        together[:3]
    )


def test_make_installs_within_the_constraints():
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    recipe = text[text.index("$(VENV)/installed: ") :]
    assert "$(CONSTRAINTS)" in recipe.splitlines()[0]
    assert recipe.count("$(PIP)") == 3
    assert "-m pip" not in recipe

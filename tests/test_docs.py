"""Commands, targets, options and files that the documents name exist, and their examples run."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from craftsim.cli.commands import COMMANDS

ROOT = Path(__file__).parents[1]
DOCUMENTS = (
    "README.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "CHANGELOG.md",
    "craftsim/mjcf/README.md",
    "examples/README.md",
    *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")),
)


def test_the_readme_lists_every_command_in_the_order_of_the_help():
    rows = re.findall(r"^\| `craftsim (\w+)", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert rows[: len(COMMANDS)] == list(COMMANDS)


@pytest.mark.parametrize("document", DOCUMENTS)
def test_commands_targets_and_files_exist(document):
    text = (ROOT / document).read_text(encoding="utf-8")
    if document == "CHANGELOG.md":  # older versions had other commands and files
        text = "".join(text.split("\n## [")[:2])
    code = " ; ".join(re.findall(r"`([^`\n]+)`", text) + re.findall(r"^    (.+)$", text, re.MULTILINE))
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert set(re.findall(r"\bmake ([a-z]+)", code)) <= targets
    assert set(re.findall(r"\bcraftsim ([a-z]+)", code)) <= set(COMMANDS)
    for path in re.findall(r"\b(?:tests|scripts|craftsim|examples|docs)/[\w/]+\.\w+", code):
        assert (ROOT / path).exists(), path


def test_the_examples_of_the_readme_run_and_keep_their_promises(capsys):
    """They run one after the other, as in one session."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    names: dict[str, object] = {}
    for example in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(compile(example, "README.md", "exec"), names)
    assert names["result"].agrees
    assert len(names["result"].to_frame()) == 24
    assert capsys.readouterr().out.splitlines()[-1] == "the same world: True"


def test_the_examples_of_the_environments_run():
    text = (ROOT / "docs/envs.md").read_text(encoding="utf-8")
    for example in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        # As a module of its own name, so that what is meant for a main program only is not run here.
        exec(compile(example, "docs/envs.md", "exec"), {"__name__": "example"})


def test_the_examples_of_the_validation_run_as_programs(tmp_path):
    text = (ROOT / "docs/validation.md").read_text(encoding="utf-8")
    for number, example in enumerate(re.findall(r"```python\n(.*?)```", text, re.DOTALL)):
        path = tmp_path / f"example_{number}.py"
        path.write_text(example, encoding="utf-8")
        done = subprocess.run(
            [sys.executable, path], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr

"""What the documents say can be typed exists, and what they point to is there."""

import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from craftsim.cli import COMMANDS

ROOT = Path(__file__).parents[1]
DOCUMENTS = (
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "craftsim/mjcf/README.md",
    *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")),
)


def test_the_readme_lists_every_command_in_the_order_of_the_help():
    rows = re.findall(r"^\| `craftsim (\w+)", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert rows[: len(COMMANDS)] == list(COMMANDS)


@pytest.mark.parametrize("document", DOCUMENTS)
def test_commands_targets_and_files_exist(document):
    text = (ROOT / document).read_text(encoding="utf-8")
    code = " ; ".join(re.findall(r"`([^`\n]+)`", text) + re.findall(r"^    (.+)$", text, re.MULTILINE))
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert set(re.findall(r"\bmake ([a-z]+)", code)) <= targets
    assert set(re.findall(r"\bcraftsim ([a-z]+)", code)) <= set(COMMANDS)
    for path in re.findall(r"\b(?:tests|scripts|craftsim)/[\w/]+\.\w+", code) + re.findall(
        r"\]\((?!http)([^)#]+)", text
    ):
        assert ((ROOT / document).parent / path).exists() or (ROOT / path).exists(), path


def test_the_example_of_training_moves_from_the_grid_to_physics(capsys):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    section = text.split("## Training on it", 1)[1].split("\n## ", 1)[0]
    example = "\n".join(line for line in section.splitlines() if not line or line.startswith("    "))
    exec(compile(textwrap.dedent(example), "README.md", "exec"), {})
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


def test_the_example_of_the_readme_runs_and_builds(capsys):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    example = text.split("From Python:", 1)[1].split("\n## ", 1)[0]
    exec(compile(textwrap.dedent(example), "README.md", "exec"), {})
    assert capsys.readouterr().out == "24 of 24 actions agree; built: True\n"

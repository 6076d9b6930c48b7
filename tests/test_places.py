"""What containers, installers and assistants read agrees with the project."""

import os
import re
import subprocess
import tomllib
from pathlib import Path

import yaml

from craftsim.cli.commands import COMMANDS
from craftsim.rendering.offscreen import DEBIAN_PACKAGES

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


def _text(name):
    return (ROOT / name).read_text("utf-8")


def test_the_container_installs_what_rendering_needs_and_runs_as_nobody():
    text = _text("Dockerfile")
    for package in DEBIAN_PACKAGES:
        assert package in text
        assert package in _text(".devcontainer/devcontainer.json")
    copied = re.findall(r"^COPY (.+) \S+$", text, re.MULTILINE)
    names = [name for line in copied for name in line.split()]
    allowed = re.findall(r"^!(.+)$", _text(".dockerignore"), re.MULTILINE)
    assert names == allowed
    assert all((ROOT / name).exists() for name in names)
    assert re.search(r"^USER \d+:\d+$", text, re.MULTILINE)
    assert "python scripts/make_wheel.py" in text
    assert re.search(r"FROM python:(3\.\d+)", text)[1] in _text("pyproject.toml")
    assert "docker build" in _text(".github/workflows/test.yml")


def test_the_recipe_for_conda_asks_for_what_the_package_asks_for():
    # Jinja's lines and values are no YAML.
    lines = [line for line in _text("packaging/meta.yaml").splitlines() if "{%" not in line]
    recipe = yaml.safe_load("\n".join(lines).replace("{{", "").replace("}}", ""))
    other_names = {
        "mujoco": "mujoco-python",
        "lazy_loader": "lazy-loader",
        "opencv-python-headless": "py-opencv",
        "matplotlib": "matplotlib-base",
    }
    expected = []
    for requirement in PROJECT["dependencies"]:
        name, bounds = re.fullmatch(r"([\w-]+)(.*)", requirement).groups()
        expected.append(f"{other_names.get(name, name)} {bounds}".lower())
    assert recipe["requirements"]["run"] == [f"python {PROJECT['requires-python']}", *expected]
    assert f'version = "{PROJECT["version"]}"' in _text("packaging/meta.yaml")


def test_a_release_is_published_without_a_stored_secret():
    release = yaml.safe_load(_text(".github/workflows/release.yml"))
    publish = release["jobs"]["publish"]
    assert publish["permissions"] == {"id-token": "write"}
    assert "secrets." not in _text(".github/workflows/release.yml")
    assert publish["needs"] == "build"


def test_a_release_adds_its_site_beside_those_of_earlier_ones(tmp_path):
    release = yaml.safe_load(_text(".github/workflows/release.yml"))
    *_, step = release["jobs"]["site"]["steps"]
    remote = tmp_path / "remote"
    author = ("-c", "user.name=a", "-c", "user.email=a@localhost")
    begin = ("commit", "--quiet", "--allow-empty", "--message", "first")
    subprocess.run(("git", "init", "--quiet", "--bare", remote), check=True)
    for version in ("v1.0", "v1.1"):
        clone = tmp_path / version
        subprocess.run(("git", "clone", "--quiet", remote, clone), check=True)
        subprocess.run(("git", *author, *begin), cwd=clone, check=True)
        (clone / "out" / "docs").mkdir(parents=True)
        (clone / "out" / "docs" / "index.html").write_text(version)
        environment = os.environ | {"GITHUB_REF_NAME": version}
        subprocess.run(("bash", "-e", "-c", step["run"]), cwd=clone, env=environment, check=True)
    site = tmp_path / "site"
    subprocess.run(("git", "clone", "--quiet", "--branch", "gh-pages", remote, site), check=True)
    assert [(site / name / "index.html").read_text() for name in ("v1.0", "v1.1")] == [
        "v1.0",
        "v1.1",
    ]
    assert "url=v1.1/" in (site / "index.html").read_text()


def test_the_page_for_assistants_names_commands_and_files_that_there_are():
    text = _text("AGENTS.md")
    commands = set(re.findall(r"`craftsim (\w+)", text))
    assert commands <= set(COMMANDS)
    for name in re.findall(r"`((?:docs/[\w/-]+|CONTRIBUTING)\.md)`", text):
        assert (ROOT / name).is_file(), name


def test_the_list_for_assistants_has_every_page_of_the_documentation():
    index = _text("docs/index.md")
    expected = []
    for block in re.findall(r"```\{toctree\}\n(.*?)```", index, re.DOTALL):
        for page in re.findall(r"^[a-z][\w/-]+$", block, re.MULTILINE):
            title = re.search(r"^# (.+)$", _text(f"docs/{page}.md"), re.MULTILINE)[1]
            expected.append((title, f"{page}.html"))
    assert re.findall(r"^- \[(.+)\]\((.+)\)$", _text("docs/llms.txt"), re.MULTILINE) == expected

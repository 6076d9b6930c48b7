"""The documentation builds without a warning, its links lead somewhere, and its reference is the public API."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from generated import command_names

import craftsim

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [
    *ROOT.glob("*.md"),
    *DOCS.rglob("*.md"),
    ROOT / "examples/README.md",
    ROOT / "craftsim/mjcf/README.md",
]


def _without_code(text: str) -> str:
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"`[^`\n]*`", "code", text)


def _links(path: Path) -> list[str]:
    """Return the targets of a page's links and pictures."""
    return re.findall(r"\]\(([^)\s]+)\)", _without_code(path.read_text(encoding="utf-8")))


def _anchors(path: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub and MyST make them."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.strip().lower()).replace(" ", "-") for title in titles}


def test_links_within_the_repository_lead_somewhere():
    broken = []
    for page in PAGES:
        for link in _links(page):
            if re.match(r"[a-z]+:", link):
                continue
            name, _, anchor = link.partition("#")
            target = (page.parent / name).resolve() if name else page
            missing = not target.exists() or (anchor and anchor not in _anchors(target))
            broken += [(page.name, link)] if missing else []
    assert broken == []


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("[a](b.md#c)", ["b.md#c"]),
        ("![a picture](x.jpg) and [b](#d)", ["x.jpg", "#d"]),
        ("`grid[0](1)`", []),
        ("```\n[a](b)\n```", []),
    ],
)
def test_links_are_found_and_code_is_not_taken_for_one(tmp_path, line, found):
    page = tmp_path / "page.md"
    page.write_text(line)
    assert _links(page) == found


@pytest.fixture(scope="module")
def physics(tmp_path_factory):
    """Build the site as 'make docs' does; a warning is an error."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", DOCS, folder]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def test_every_page_is_built(physics):
    pages = {
        path.relative_to(DOCS).with_suffix("") for path in DOCS.rglob("*.md") if path.parent.name != "results"
    }
    assert pages <= {path.relative_to(physics).with_suffix("") for path in physics.rglob("*.html")}


def test_the_reference_documents_every_public_name(physics):
    reference = (physics / "reference" / "api.html").read_text(encoding="utf-8")
    for name in set(craftsim.__all__) - {"__version__"}:
        assert f'id="craftsim.{name}"' in reference, name
        assert (getattr(craftsim, name).__doc__ or "").strip(), f"{name} has no docstring"


def test_the_reference_has_the_help_of_every_command(physics):
    reference = (physics / "reference" / "commands.html").read_text(encoding="utf-8")
    for words in command_names():
        assert f"<h2>{' '.join(words)}<" in reference


def test_a_link_that_leads_nowhere_fails_the_build(tmp_path):
    (tmp_path / "conf.py").write_text('extensions = ["myst_parser"]\n')
    (tmp_path / "index.md").write_text("# A page\n\n[nowhere](missing.md)\n")
    command = [sys.executable, "-m", "sphinx", "-W", "-q", tmp_path, tmp_path / "out"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "missing.md" in done.stderr

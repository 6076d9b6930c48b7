"""What documents name exists, links lead somewhere, examples run, tables are of what is stored, words are plain; the
site builds without a warning, and its reference is the public API."""

import dataclasses
import json
import re
import runpy
import shlex
import types
from pathlib import Path

import forked
import pytest
from actions_page import ENTRIES, durations
from generated import TABLES, command_names, help_text
from pygments.lexers import get_lexer_by_name
from results import tables

import craftsim
from craftsim import Action
from craftsim.cli import main
from craftsim.cli.app import bind
from craftsim.discrete.files.blueprint import KEYS, parse_blueprint
from craftsim.discrete.rules import REASONS
from craftsim.envs.text import TextConstruction
from craftsim.models.sensing import SensorNoise
from craftsim.skills.gains import SECTIONS
from craftsim.storage import limits

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = ["README.md", *sorted(str(path.relative_to(ROOT)) for path in DOCS.rglob("*.md"))]
DOCUMENTS = [
    *PAGES,
    "CONTRIBUTING.md",
    "SECURITY.md",
    "CHANGELOG.md",
    "craftsim/mjcf/README.md",
    "examples/README.md",
]
MADE = ("docs/reference/actions.md", "docs/gallery.md", "docs/results/")
"""Pages that scripts write."""
ACTIONS = DOCS / "reference" / "actions.md"
MOST_WORDS = 32_000
MOST_WORDS_OF_A_RELEASE = 2_000
LONGEST_LINE = 160
LONGEST_COMMAND = 102


def _text(document: str) -> str:
    return (ROOT / document).read_text(encoding="utf-8")


def _blocks(document: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", _text(document), re.DOTALL | re.MULTILINE)


def _command_lines(document: str) -> list[list[str]]:
    """Return the words of each call of craftsim in the shell blocks of a page."""
    lines = [
        line
        for block in _blocks(document, "sh")
        for line in block.replace("\\\n", " ").splitlines()
        if line.startswith("craftsim ")
    ]
    return [shlex.split(line, comments=True)[1:] for line in lines]


def test_the_readme_lists_every_command_in_the_order_of_the_help():
    rows = re.findall(r"^\|[^|]*\| `craftsim (\w+)` \|", _text("README.md"), re.MULTILINE)
    assert rows == [words[0] for words in command_names() if len(words) == 1]


def test_commands_targets_and_files_exist():
    targets = set(re.findall(r"^([a-z]+):", _text("Makefile"), re.MULTILINE))
    commands = {*(words[0] for words in command_names()), "completion"}
    for document in DOCUMENTS:
        text = _text(document)
        if document == "CHANGELOG.md":  # older versions had other commands and files
            text = "".join(text.split("\n## [")[:2])
        code = " ; ".join(
            re.findall(r"`([^`\n]+)`", text) + re.findall(r"^    (.+)$", text, re.MULTILINE)
        )
        assert set(re.findall(r"\bmake ([a-z]+)", code)) <= targets, document
        assert set(re.findall(r"\bcraftsim ([a-z]+)", code)) <= commands, document
        for path in re.findall(
            r"\b(?:tests|scripts|craftsim|examples|docs)/[\w/-]+(?:\.\w+)+", code
        ):
            assert (ROOT / path).exists(), path


def test_every_command_line_of_a_page_is_understood():
    for words in map(list, {tuple(words) for page in PAGES for words in _command_lines(page)}):
        words = words[2:] if words[0] == "--plugins" else words
        if words[0] != "completion" and words[0] != "--version":
            bind(words)


@pytest.mark.parametrize("document", [page for page in PAGES[1:] if _blocks(page, "python")])
def test_the_python_of_a_page_runs(document, tmp_path):
    """Blocks that name a file at their start run each as that file, the others one after the other as one program.

    The smallest plan is performed in one world without rollers; the README has a test of its own.
    """
    files: dict[str, str] = {}
    for block in _blocks(document, "python"):
        named = re.match(r"# (\w+\.py)\n", block)
        name = named[1] if named else "page.py"
        files[name] = files.get(name, "") + block + "\n"
    for example in ("yard/yard.yaml", "yard/yard_goal.yaml", "overlap/ramp.yaml"):
        (tmp_path / Path(example).name).write_text(_text(f"examples/{example}"), encoding="utf-8")
    for name, text in files.items():
        text = re.sub(r"trials=\d+", "trials=1", text)
        text = re.sub(r'validate\("\w+"', 'validate("strip", drive="wheels"', text)
        (tmp_path / name).write_text(text, encoding="utf-8")
        done = forked.run(tmp_path / name, cwd=tmp_path)
        assert done.returncode == 0, done.stderr


def test_the_ten_lines_of_the_readme_and_its_notebook_print_what_they_promise(capsys):
    (example,) = _blocks("README.md", "python")
    assert len([line for line in example.splitlines() if line.strip()]) <= 10
    notebook = json.loads(_text("examples/ten_lines.ipynb"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    texts = ["".join(cell["source"]) for cell in cells]
    assert "\n\n".join(texts) == example.strip()
    assert all(cell["outputs"] == [] for cell in cells)
    names: dict[str, object] = {}
    for text in texts:
        small = text.replace('"simple_two_story", trials=2', '"strip", drive="wheels", trials=1')
        exec(compile(small, "ten_lines.ipynb", "exec"), names)
    assert names["result"].agrees
    assert len(names["result"].to_frame()) == 22
    assert "LIFT is forbidden: there is nothing to lift" in capsys.readouterr().out


def test_the_blueprint_example_is_a_blueprint_with_every_kind_of_list():
    text = _text("docs/reference/world-files.md")
    assert parse_blueprint(
        _blocks("docs/reference/world-files.md", "yaml")[0], "world-files.md"
    ).is_fixed
    for key in KEYS:
        assert re.search(rf"\b{key}\b", text), key


def test_the_observation_of_the_page_on_text_is_that_of_the_environment():
    env = TextConstruction("strip", backend="grid")
    env.reset(seed=0)
    env.step("car_0: move left")
    text = env.step("car_0: move back; car_1: fold")[0]
    assert text.startswith(_blocks("docs/how-to/language-models.md", "text")[0])


PATH_AND_HEADING = re.compile(r"docs/([\w/-]+\.md)(?:#([\w-]+))?")


def _prose(document: str) -> str:
    """Return a page without its code, which has names of its own."""
    text = re.sub(r"^```.*?^```", "", _text(document), flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"`[^`\n]*`", "code", text)


def _anchors(document: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub and MyST make them."""
    text = re.sub(
        r"^```.*?^```", "", document.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.strip().lower()).replace(" ", "-") for title in titles}


def test_links_within_the_repository_lead_somewhere():
    broken = []
    for document in DOCUMENTS:
        for link in re.findall(r"\]\(([^)\s]+)\)", _prose(document)):
            name, _, anchor = link.partition("#")
            target = ((ROOT / document).parent / name).resolve() if name else ROOT / document
            if not re.match(r"[a-z]+:", link) and (
                not target.exists() or (anchor and anchor not in _anchors(target))
            ):
                broken.append((document, link))
    assert broken == []


def test_pages_that_the_code_names_exist_and_every_oddity_is_named():
    named = {
        found
        for path in (ROOT / "craftsim").rglob("*.py")
        for found in PATH_AND_HEADING.findall(path.read_text(encoding="utf-8"))
    }
    assert {("rules.md", "marks"), ("rules.md", "drop-overwrites")} <= named
    for page, heading in named:
        assert (DOCS / page).exists(), page
        assert not heading or heading in _anchors(DOCS / page), heading
    oddities = _text("docs/rules.md").split("## Oddities")[1]
    explained = {
        title.lower().replace(" ", "-")
        for title in re.findall(r"^### (.+)$", oddities, re.MULTILINE)
    }
    assert explained == {heading for page, heading in named if page == "rules.md" and heading}


def test_tables_of_results_and_the_gallery_are_those_of_what_is_stored():
    for name, text in tables().items():
        assert _text(f"docs/results/{name}.md") == text, "python scripts/results.py writes them"
    results = runpy.run_path(str(ROOT / "scripts/results.py"))
    for text in results["readme_tables"]().values():
        assert text in _text("README.md"), "python scripts/results.py writes it"
    gallery = runpy.run_path(str(ROOT / "scripts/gallery.py"))
    assert gallery["page_text"](
        gallery["json"].loads(gallery["STORED"].read_text("utf-8"))
    ) == _text("docs/gallery.md")


def test_each_result_is_stored_with_the_command_that_measures_it():
    measure = runpy.run_path(str(ROOT / "scripts/measure_results.py"))
    stored = {
        path.stem: json.loads(path.read_text("utf-8")) for path in measure["RUNS"].glob("*.json")
    }
    earlier = {name for name in stored if name.startswith("execution_trained_")}
    # What needs policies that are trained for it may be missing.
    expected = measure["MEASURED"].keys() - (measure["OF_POLICIES"].keys() - stored.keys())
    assert stored.keys() - earlier == expected
    for name in expected:
        assert stored[name]["command"] == measure["MEASURED"][name]
    assert all(re.fullmatch("[0-9a-f]{8}", one["revision"]) for one in stored.values())


WORDS_TO_AVOID = re.compile(
    r"""\b(?:told|tells?\ (?:you\ )?whether|untold|things?|crews?|errands?|sightings?|outings?|knobs?|suspects?
    |shrinks?|shrunk|shrinking|pilots?|players?|planted|guidance|judged\ on\ seeds\ held\ out|doors
    |(?:goes|go)\ in\ by\ the\ same\ doors?|physics\ that\ is\ only\ physics|decides\ all\ that\ is\ drawn
    |(?:stands?|stood)\ (?:a|an|it|all|none|that)\ (?:delay|bias|lag)|came\ to\ no\ end|prefers\ the\ rare
    |let\ cars\ learn|those\ who\ read\ and\ do\ not\ look|whatever\ happens\ next|tell\ most|learnt)\b""",
    re.IGNORECASE | re.VERBOSE,
)
"""Words that the field does not use for what they meant here."""


def test_pages_and_help_texts_have_the_words_of_the_field():
    texts = {page: _prose(page) for page in DOCUMENTS if page != "CHANGELOG.md"}
    texts["help"] = " ".join(help_text(*words) for words in ((), *command_names()))
    found = {page: WORDS_TO_AVOID.findall(text) for page, text in texts.items()}
    assert {page: words for page, words in found.items() if words} == {}


def test_no_line_of_prose_is_longer_than_a_screen():
    for document in (one for one in DOCUMENTS if not one.startswith(MADE)):
        lines = [line for line in _prose(document).splitlines() if not line.startswith(("|", "!["))]
        assert [line for line in lines if len(line) > LONGEST_LINE] == [], document


def test_a_command_fits_its_box():
    """At a width of 1280 pixels, in the site's font; further words go on in the next line."""
    for page in PAGES:
        lines = [line for block in _blocks(page, "sh") for line in block.splitlines()]
        assert [line for line in lines if len(line) > LONGEST_COMMAND] == [], page


def test_the_sidebar_stays_short():
    entries = re.findall(r"^(?!:)[\w/-]+$", _text("docs/index.md"), re.MULTILINE)
    assert 15 < len(entries) <= 25


def test_the_documentation_stays_small():
    pages = " ".join(map(_text, (*PAGES, "CONTRIBUTING.md")))
    assert _n_words(pages) <= MOST_WORDS
    # The changelog grows with each release; what it says of one is short.
    for release in _text("CHANGELOG.md").split("\n## "):
        assert _n_words(release) <= MOST_WORDS_OF_A_RELEASE, release.splitlines()[0]


def _n_words(text: str) -> int:
    return sum(bool(re.search(r"\w", word)) for word in text.split())


def test_a_guide_is_short():
    for page in (page for page in PAGES if page.startswith("docs/how-to/")):
        text = re.sub(r"^```.*?^```", "", _text(page), flags=re.DOTALL | re.MULTILINE)
        assert len([word for word in text.split() if re.search(r"\w", word)]) <= 500, page


# References that are built with the site, and the page of actions.


def _rows(name: str) -> list[list[str]]:
    return [
        line.strip("| ").split(" | ")
        for line in TABLES[name]().splitlines()
        if line.startswith("| ")
    ]


def test_a_table_has_rows_of_one_width():
    for name in [name for name in TABLES if name != "commands"]:
        for part in TABLES[name]().split("\n\n"):
            widths = {
                line.replace("\\|", "").count("|")
                for line in part.splitlines()
                if line.startswith("|")
            }
            assert len(widths) <= 1


def test_every_limit_is_in_the_reference():
    named = {row[0] for row in _rows("limits")}
    numbers = {
        name
        for name, value in vars(limits).items()
        if name.isupper() and isinstance(value, int | float)
    }
    assert named - {"constant", "---"} == {f"`{name}`" for name in numbers - {"KIB", "MIB"}}


def test_every_gain_and_every_kind_of_noise_is_in_the_reference():
    gains = {row[0] for row in _rows("gains")}
    assert {
        f"`{field.name}`" for kind in SECTIONS.values() for field in dataclasses.fields(kind)
    } <= gains
    assert {f"`{field.name}`" for field in dataclasses.fields(SensorNoise)} <= {
        row[0] for row in _rows("noise")
    }


def test_every_reason_is_in_the_reference_without_fields():
    rows = _rows("reasons")
    assert len(rows) == len(REASONS) + 2
    assert not any("{" in cell for row in rows for cell in row)


def test_an_action_has_its_section_and_its_film():
    for entry in ENTRIES:
        text = (
            ACTIONS.read_text(encoding="utf-8").split(f"## {entry.title}\n", 1)[1].split("\n## ")[0]
        )
        assert f"Takes: {durations(entry)}." in text
        assert all(f"- {line}" in text for line in entry.needs)
        film = text.split(f"![{entry.title}](")[1].split(")")[0]
        assert 1000 < (ACTIONS.parent / film).stat().st_size < 200_000


def test_every_action_has_its_number():
    text = ACTIONS.read_text(encoding="utf-8")
    assert all(f"{int(action)} `{action.name}`" in text for action in Action)


TUTORIALS = {
    "own-world": "yard",
    "own-building": "house",
    "failure": "corner",
    "asynchronous": "overlap",
}


@pytest.mark.parametrize("tutorial", TUTORIALS)
def test_a_tutorial_can_be_walked(tutorial, tmp_path, capsys, monkeypatch):
    """Each of its commands in turn, with one trial, few bodies and no films; what the text says of them is so."""
    for path in (ROOT / "examples" / TUTORIALS[tutorial]).iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "400")
    statuses = []
    for words in _command_lines(f"docs/tutorials/{tutorial}.md"):
        if words[0] in ("render", "train", "bench"):
            continue
        if (
            words[0] == "show" and "--out" in words
        ):  # films of plans are those of tests/rendering/test_film.py
            words = words[: words.index("--out")]
        words = (
            [*words, "--video", "none", "--drive", "wheels"] if words[0] == "validate" else words
        )
        command = shlex.join(words).replace("CHECKOUT", str(ROOT))
        command = re.sub(r"--trials \d+", "--trials 1", command)
        command = re.sub(r"--attempts \d+", "--attempts 1", command)
        statuses.append(main(shlex.split(command)))
    said = capsys.readouterr().out
    entered = "tick 0, car 1 MOVE_FORWARD: not tried: the rules forbid it: a block in (3, 1, 1) cannot be entered"
    turned = "corner/corner/0000: tick 3, car 0 ROTATE_LEFT: failed: the load is"
    left = "it fails when car 1 is in the next cell to the left"
    large = "building: 3 x 2 cells, 2 levels: 0.97 x 0.65 x 0.37 m; a cell is 0.3225 m wide and 0.185 m high"
    expected = {
        "own-world": ([entered], [0, 1, 0, 0, 0, 0, 0]),
        "own-building": ([large], [0, 0, 0, 0]),
        "failure": ([turned, left], [1, 0, 0, 1, 1]),
        "asynchronous": (["24 of 24 actions agree with the rules"], [0, 0]),
    }[tutorial]
    text, shown = (" ".join(one.split()) for one in (_text(f"docs/tutorials/{tutorial}.md"), said))
    assert all(words in shown for words in expected[0])
    assert all(words in text for words in expected[0] if tutorial != "asynchronous")
    assert statuses == expected[1]


def test_the_notebook_of_the_tutorial_runs(capsys):
    module = types.ModuleType("notebook")
    path = ROOT / "examples/yard/notebook.py"
    module.__dict__["__file__"] = str(path)
    text = re.sub(r"trials=\d+", "trials=1", path.read_text(encoding="utf-8"))
    exec(compile(text, str(path), "exec"), module.__dict__)
    assert "cannot be entered sideways" in capsys.readouterr().out
    assert module.__dict__["result"].agrees


SITE = """
import json, sys
from docutils import nodes
from sphinx.application import Sphinx

docs, out = sys.argv[1:]
site = Sphinx(docs, docs, out, out, "dummy", status=None)
site.build()
titles = site.env.get_doctree("reference/commands").findall(nodes.title)
documented = {name: one.docname for name, one in site.env.domains["py"].objects.items()}
print(json.dumps([[*site.env.found_docs], documented, [title.astext() for title in titles]]))
"""


def test_the_site_is_built_without_a_warning_and_has_every_page_public_name_and_command(tmp_path):
    """All but writing the pages, which takes longer: every reference is resolved, and every block of code read."""
    (tmp_path / "site.py").write_text(SITE)
    done = forked.run(tmp_path / "site.py", DOCS, tmp_path / "site")
    assert (done.returncode, done.stderr) == (0, "")
    found, documented, titles = json.loads(done.stdout)
    pages = {str(path.relative_to(DOCS).with_suffix("")) for path in DOCS.rglob("*.md")}
    assert {page for page in pages if not page.startswith("results")} <= set(found)
    for name in set(craftsim.__all__) - {"__version__"}:
        assert documented[f"craftsim.{name}"] == "reference/api", name
        assert (getattr(craftsim, name).__doc__ or "").strip(), f"{name} has no docstring"
    assert {" ".join(words) for words in command_names()} <= set(titles)
    for page in DOCS.rglob("*.md"):
        for language, code in re.findall(
            r"^```(\w+)\n(.*?)^```", page.read_text("utf-8"), re.DOTALL | re.M
        ):
            assert list(get_lexer_by_name(language, filters=["raiseonerror"]).get_tokens(code))

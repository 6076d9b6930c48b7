"""What the documents on the grid world say is so: their examples run, and the code's references lead somewhere."""

import re
from pathlib import Path

import numpy as np

from craftsim.discrete.files.blueprint import KEYS, parse_blueprint

ROOT = Path(__file__).parents[2]
REFERENCE = re.compile(r"docs/([a-z]+\.md)#([a-z-]+)")


def anchors(document):
    headings = re.findall(r"^#+ (.+)$", (ROOT / "docs" / document).read_text(), re.MULTILINE)
    return {heading.lower().replace(" ", "-") for heading in headings}


def test_every_oddity_that_the_code_names_is_explained_and_every_one_explained_is_named():
    sources = [path.read_text() for path in (ROOT / "craftsim").rglob("*.py")]
    named = {match for source in sources for match in REFERENCE.findall(source)}
    assert {("rules.md", "marks"), ("rules.md", "drop-overwrites")} <= named
    for document, anchor in named:
        assert anchor in anchors(document), anchor
    text = (ROOT / "docs" / "rules.md").read_text().split("# Oddities")[1]
    explained = {
        heading.lower().replace(" ", "-") for heading in re.findall(r"^## (.+)$", text, re.MULTILINE)
    }
    assert explained == {anchor for document, anchor in named if document == "rules.md"}


EXAMPLES = re.findall(r"```python\n(.+?)```", (ROOT / "docs" / "tasks.md").read_text(), re.DOTALL)


def test_the_examples_run():
    for example in EXAMPLES:
        exec(compile(example, "docs/tasks.md", "exec"), {})


def test_a_task_of_ones_own_takes_fewer_than_twenty_lines_beside_its_layout():
    own = next(example for example in EXAMPLES if "Task(" in example)
    code = [line for line in re.sub(r'""".+?"""', "", own, flags=re.DOTALL).splitlines() if line.strip()]
    assert len(code) < 20


def test_the_blueprint_example_is_a_blueprint_with_every_kind_of_list():
    text = (ROOT / "docs" / "blueprints.md").read_text()
    example = re.findall(r"```yaml\n(.+?)```", text, re.DOTALL)[0]
    blueprint = parse_blueprint(example, "docs/blueprints.md")
    assert blueprint.is_fixed
    assert blueprint.grid(np.random.default_rng(0)).n_cars == 2
    for key in KEYS:
        assert re.search(rf"\b{key}\b", text), key


def test_links_between_documents_lead_somewhere():
    for document in ("rules.md", "tasks.md", "blueprints.md"):
        for target, anchor in re.findall(
            r"\]\(([a-z]+\.md)#([a-z-]+)\)", (ROOT / "docs" / document).read_text()
        ):
            assert anchor in anchors(target)

"""The page of actions names each of them, has its films, and its durations are the shipped ones."""

from pathlib import Path

from actions_page import ENTRIES, durations

from craftsim import Action

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "actions.md"


def test_an_action_has_its_section_and_its_film():
    for entry in ENTRIES:
        text = PAGE.read_text(encoding="utf-8").split(f"## {entry.title}\n", 1)[1].split("\n## ")[0]
        assert f"Takes: {durations(entry)}." in text
        assert all(f"- {line}" in text for line in entry.needs)
        film = text.split(f"![{entry.title}](")[1].split(")")[0]
        assert 1000 < (PAGE.parent / film).stat().st_size < 200_000


def test_every_action_has_its_number():
    text = PAGE.read_text(encoding="utf-8")
    assert all(f"{int(action)} `{action.name}`" in text for action in Action)

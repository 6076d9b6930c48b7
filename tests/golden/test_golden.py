"""What craftsim does is what the golden records say; ``make golden`` compares the long ones, too."""

import pytest

from .golden import KINDS, compute, differences, digest, names, stored, where


@pytest.mark.parametrize("name", [name for name in names() if KINDS[name].fast])
def test_a_record_is_as_it_is_stored(name):
    old = stored(name)
    if old["machine"] != where(name):
        pytest.skip(f"recorded on {old['machine']}")
    assert list(differences(old["value"], compute(name)[0])) == []


def test_differences_are_shown_by_lines_of_a_text():
    old = {"train": ["Usage: train", "--seed", "--steps"], "same": 1}
    new = {"train": ["Usage: train", "--steps", "--worlds"], "same": 1}
    assert list(differences(old, new)) == ["/train:2 - --seed", "/train:3 + --worlds"]


def test_differences_of_digests_are_shown_by_lines_where_both_texts_are_there(tmp_path):
    folders = []
    digests = []
    for name, content in (("old", "a\nb\nc\n"), ("new", "a\nc\n")):
        folder = tmp_path / name
        folder.mkdir()
        digests.append(digest(content))
        (folder / f"{digests[-1]}.txt").write_text(content)
        folders.append(folder)
    old = {"plans": [digests[0]]}
    new = {"plans": [digests[1]]}
    assert list(differences(old, new, texts=tuple(folders))) == ["/plans[0]:2 - b"]
    assert list(differences(old, new)) == [f'/plans[0]: "{digests[0]}" -> "{digests[1]}"']

"""The check of how plain the package is counts by its definitions, and lets no figure get worse."""

import json

import plainness
import pytest

PLAIN = "def area(radius):\n    pi = 3.14\n    return pi * radius * radius\n"
WORSE = "from tiny.shapes import area\n\n\ndef volume(one):\n    return area(one) if one else 0\n"


@pytest.fixture
def tiny(tmp_path):
    """Return a function that writes a package of some modules and returns its folder."""

    def write(**modules):
        package = tmp_path / "tiny"
        package.mkdir(exist_ok=True)
        for name, source in modules.items():
            (package / f"{name}.py").write_text(source)
        return package

    return write


@pytest.mark.parametrize(
    ("source", "name", "figure"),
    [
        ("a, b = 1, 2\n", "a, b = x, y", 1e4 / 7),
        ("a, b = pair\n", "a, b = x, y", 0),
        ("f(*(1, 2))\n", "star-tuple arguments", 1e4 / 9),
        ("f(*pair)\n", "star-tuple arguments", 0),
        ("a = 1 if b else 2\n", "conditional expressions", 1e4 / 7),
        ("if (a := b):\n    pass\n", "walrus", 1e4 / 8),
        ("[c for a in b for c in a]\n", "nested comprehensions", 1e4 / 11),
        ("[a for a in b]\n", "comprehensions", 1e4 / 7),
        ('import math\n"""Text."""\na = f"{b + c}"  # comment\n', "tokens a code line", 3),
        ("def f(one, radius): ...\n", "vague names, %", 50),
        ("_other = 1\n", "vague names, %", 100),
    ],
)
def test_each_figure_counts_what_its_name_says(source, name, figure, tiny):
    assert plainness.figures(tiny(shapes=source))[name] == round(figure, 1)


def test_public_names_of_several_modules_and_circles_of_imports_are_counted(tiny):
    first = "from tiny.second import area\n\n\nclass Shape: ...\n"
    second = "Shape: int = 1\n\n\ndef f():\n    from .first import Shape\n"
    third = "from . import first\n\n_Shape = Shape = 2\n"
    figures = plainness.figures(tiny(first=first, second=second, third=third))
    assert figures["public names defined twice"] == 1
    assert figures["circles of imports"] == 1


def test_a_worse_module_fails_and_a_plainer_one_can_be_stored(tiny, tmp_path, capsys):
    stored = tmp_path / "plainness.json"
    stored.write_text(json.dumps(plainness.figures(tiny(shapes=PLAIN, volumes=WORSE))))
    assert plainness.main([], tiny(more=WORSE), stored) == 1
    assert "Worse than plainness.json has it: " in capsys.readouterr().out
    before = stored.read_text()
    assert plainness.main(["--store"], tiny(more=WORSE), stored) == 1
    assert stored.read_text() == before
    plain = tiny(volumes=PLAIN.replace("area", "volume"), more="")
    assert plainness.main([], plain, stored) == 0
    assert stored.read_text() == before
    assert plainness.main(["--store"], plain, stored) == 0
    assert json.loads(stored.read_text()) == plainness.figures(plain)

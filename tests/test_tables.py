"""Tables on the terminal: names stay whole at any width, and each number has a unit."""

import contextlib
import io
import re
from collections import Counter
from pathlib import Path

import pytest

from craftsim import cli
from craftsim.reports import terminal
from craftsim.reports.report import Column, DataTable, cell_text, numbers
from craftsim.tuning import tune

PLAN = "breaking_barrier_from_the_left"
WORLD = "complex_two_story_without_slopes"
STUDY = "title: small\ntasks: [strip]\nalgos: [ippo, vdn]\nseeds: 1\nsteps: 1000\n"
ROW = "MOVE/scene=on* a second ramp"
FAST = "--video none --trials 2"
COMMANDS = {
    "validate": f"validate {WORLD}.yaml --plan {PLAN}.plan {FAST} --out first",
    "validate with failures": f"validate {WORLD}.yaml --plan forbidden.plan {FAST} --out failing",
    "validate of buildings": f"validate strip --plan auto {FAST} --out built",
    "compare": "compare first first --out compared",
    "demo": "demo strip --no-video --randomize none --out demo",
    "audit": "audit --rules published --trials 1 --out audit --situations",
    "margins": "audit margins --trials 1 --imperfections motor-lag --out margins --situations",
    "tune": "tune board --evaluations 1 --trials 1 --out tune",
    "train": "train strip --steps 1000 --episodes 5 --out train",
    "study": "train study small.yaml --out study",
    "plan": "plan strip --time-limit 2 --out plan",
    "bench": "bench rules --seconds 0.01 --worlds 4",
    "doctor": "doctor",
}
"""Cheap runs of each command; the last option of some is a row or a scenario, whose name has spaces."""
SITUATIONS = {"audit": ROW, "margins": "lift a block"}
WITHOUT_TABLES = {"train", "plan"}
BEFORE = {"compare": ["validate"]}
"""Commands whose results others read."""
NAMES = {
    "validate": [PLAN, WORLD, "first/report.json"],
    "validate with failures": [f"{WORLD}/forbidden/0000", "failing/report.json"],
    "validate of buildings": ["strip/auto/0000"],
    "compare": [PLAN, f"{WORLD}:"],
    "demo": ["strip", "MOVE_RIGHT"],
    "tune": ["board.acceleration", "tune/gains.yaml"],
    "train": ["train/policy.safetensors"],
    "plan": ["plan/strip-gantt.png"],
    "bench": ["complex_two_story"],
}
"""Names that are printed whole at 80 columns."""


def _printed(command, patch):
    """Return what a command prints on a terminal of 80 columns, and the tables of that."""
    patch.setenv("COLUMNS", "80")
    Path("small.yaml").write_text(STUDY)
    Path(f"{PLAN}.plan").write_text("0 0 MOVE_RIGHT\n")
    Path("forbidden.plan").write_text("0 0 DROP\n")
    Path(f"{WORLD}.yaml").write_text(
        "area_length: 3\narea_width: 3\narea_height: 2\nblock_num: 0\nslope_num: 0\nsmartcar_num: 1\n"
        "smartcar:\n  - {id: 0, x: 1, y: 1, z: 1, yaw: 0}\n"
    )
    tables = []
    print_table = terminal.print_table

    def keeping(console, table):
        tables.append(table)
        print_table(console, table)

    patch.setattr(terminal, "print_table", keeping)
    for name in (*BEFORE.get(command, ()), command):
        arguments = COMMANDS[name].split()
        if name in SITUATIONS:
            arguments.append(SITUATIONS[name])
        tables.clear()
        output = io.StringIO()
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
            status = cli.main(arguments)
        assert status in (0, 1), output.getvalue()
    return output.getvalue(), tables


def words_of(table):
    """Return the words of a table's headings and cells, as often as each is there."""
    shown = [number for number, column in enumerate(table.columns) if column.terminal]
    texts = [table.columns[number].name for number in shown]
    for row in table.rows[: table.most]:
        texts += ["-" if row[number] is None else cell_text(row[number]) for number in shown]
    texts += [table.title, table.note]
    return Counter(word for text in texts for word in text.split())


def rendered(table, width):
    """Return what is printed of a table on a terminal of so many columns."""
    output = io.StringIO()
    terminal.print_table(terminal.Terminal(file=output, width=width), table)
    return output.getvalue()


def assert_whole(table, width):
    """Assert that each word is printed whole, and that only words that are too long make a line too long."""
    text = rendered(table, width)
    missing = words_of(table) - Counter(text.split())
    assert not missing, text
    too_long = [line for line in text.splitlines() if len(line) > width and len(line.split()) > 1]
    assert too_long == [], text


UNITLESS = re.compile(
    r"runs|agree|actions|good|goal|rules|errors|empty|replans|ticks|tick|car|failed|trials|starts|steps|pairs|rows"
    r"|retried|side effect|unsafe|numerics|steps/s|times|n|p|IQM|algo|published|as predicted|95th|KS distance"
    r"|detectable|second"
)
"""Headings of counts, numbers of things, ratios and shares from 0 to 1."""
UNIT = re.compile(r"(^|, |\b)(s|mm|mrad|N|J|%|steps/s)$|%")


def without_unit(tables):
    """Return the columns of numbers without a unit: in the heading, the row's name, each number, or the note."""
    lacking = []
    for table in tables:
        row_units = all(
            re.search(r", (?:s|mm|mrad|N|J|ms)\b| in [sJN]\b|share of|failed", cell_text(row[0]))
            for row in table.rows
        )
        for number, column in enumerate(table.columns):
            if (
                column.kind != "number"
                or UNITLESS.fullmatch(column.name)
                or UNIT.search(column.name)
            ):
                continue
            cells = [cell_text(row[number]) for row in table.rows if row[number] not in (None, "")]
            cell_units = all(re.search(r"[a-z%/]", cell) for cell in cells)
            if not row_units and not cell_units and "Units: " not in table.note:
                lacking.append((table.title, column.name))
    return lacking


@pytest.mark.parametrize("command", COMMANDS)
def test_a_report_breaks_no_word_prints_names_whole_and_gives_units(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, few in (
        ("FINALISTS", 1),
        ("FINAL_BLOCKS", 1),
        ("HELD_OUT_BLOCKS", 2),
        ("PLANS", ("block",)),
    ):
        monkeypatch.setattr(tune, name, few)
    text, tables = _printed(command, monkeypatch)
    shown = [table for table in tables if table.rows and table.most]
    assert bool(shown) == (command not in WITHOUT_TABLES)
    for width in (80, 60, 40):
        for table in shown:
            assert_whole(table, width)
    for name in NAMES.get(command, ()):
        assert re.search(rf"(?:^|\s){re.escape(name)}(?:\s|$|[.,:;])", text), text
    assert without_unit(tables) == []


LONG = "smallest/small/0000"
SAMPLES = [
    DataTable(
        numbers("world", "plan", "runs", "makespan, s"), [(LONG, "a/very/long/plan", 3, "1.0")] * 2
    ),
    DataTable(
        (
            Column("run", "path"),
            Column("tick", "number"),
            Column("cause", "wide"),
            Column("replay", "path"),
        ),
        [(LONG, "3", "the load is 15.81 mm off its seat", f"out/validate/bundles/{LONG}")],
        note="see out/validate/a/folder/with/a/name/that/is/longer/than/any/terminal/of/eighty/columns/is/wide",
    ),
    DataTable((Column("name"), Column("other")), [("建筑" * 12, "\x1b[31mred"), (None, "")]),
    DataTable(
        (Column("command", "path"),), [("craftsim replay out/validate/bundles/" + "long" * 30,)]
    ),
]


@pytest.mark.parametrize("width", [100, 80, 60, 40])
@pytest.mark.parametrize("table", SAMPLES, ids=range(len(SAMPLES)))
def test_no_width_breaks_a_word(table, width):
    text = rendered(table, width)
    for word in words_of(table):
        assert word.replace("\x1b", "\\x1b") in text.split()


def test_a_row_that_does_not_fit_has_its_names_above_its_numbers():
    name = "a_world_with_a_name_of_33_letters"
    table = DataTable(numbers("world", "runs", "agree"), [(name, 20, 19)])
    assert rendered(table, 50) == f"world{' ' * 28}  runs  agree\n{name}    20     19\n"
    assert rendered(table, 40) == f"world\n  runs  agree\n{name}\n    20     19\n"


def test_sentences_give_way_before_names():
    columns = (Column("name"), Column("reason", "wide"))
    table = DataTable(
        columns, [("a name of three words", "a sentence that is too long for one line")]
    )
    assert (
        rendered(table, 50).splitlines()[1] == "a name of three words  a sentence that is too long"
    )

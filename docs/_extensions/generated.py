"""The directive ``generated``: tables of the reference that follow from types, limits and help texts of the package.

A page names a table, such as ``gains``; it is written when the site is built, so that it cannot differ from the code.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import inspect
import io
import math
import os
import re
from collections.abc import Callable, Iterable
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, get_args, get_type_hints

import plants
from builders import BuilderCase, chosen_rows
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from craftsim.checking.measurements import MEASUREMENTS, MeasuredValues
from craftsim.checking.setup import RANDOMIZE, nominal_gains
from craftsim.checking.thresholds import Thresholds, thresholds_of
from craftsim.cli import main
from craftsim.discrete.geometry import INCLINE_RAD
from craftsim.discrete.rules import REASONS
from craftsim.learning.algorithms import ALGORITHMS
from craftsim.learning.config import FORK, FORK_EPISODES, FORK_SETTINGS
from craftsim.learning.settings import Settings
from craftsim.mjcf.machines import NOMINAL, load_machines
from craftsim.mjcf.parameters import (
    BlockParameters,
    ContactParameters,
    SlopeParameters,
    SmartcarParameters,
)
from craftsim.models.randomization import DomainRandomization
from craftsim.models.sensing import ASSUMED
from craftsim.skills.gains import SECTIONS, load_gains
from craftsim.skills.limits import MOVE_LIMITS, TURN_LIMITS
from craftsim.storage import limits
from craftsim.storage.limits import Range, size_text

HELP_COLUMNS: Final = "110"
GRAVITY_M_S2: Final = 9.81
EXAMPLES: Final = Path(__file__).parents[2] / "examples"


def table(*rows: Iterable[object]) -> str:
    """Return rows as a table in Markdown; the first is the head."""
    head, *body = ([str(cell).replace("|", "\\|") for cell in row] for row in rows)
    return (
        "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *body)) + "\n"
    )


def docstrings(kind: type) -> dict[str, str]:
    """Return what stands below each field of a class in its source, in one line."""
    found: dict[str, str] = {}
    for one in reversed(kind.__mro__[:-1]):
        if dataclasses.is_dataclass(one):
            (tree,) = ast.parse(inspect.cleandoc(inspect.getsource(one))).body
            found |= _below(tree.body)  # type: ignore[attr-defined]
    return found


def _below(statements: list[Any]) -> dict[str, str]:
    found = {}
    for field, below in pairwise(statements):
        if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
            words = " ".join(str(below.value.value).split())  # type: ignore[attr-defined]
            found[field.target.id] = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", words)  # type: ignore[union-attr]
    return found


def allowed(kind: type) -> dict[str, str]:
    """Return in words what the numbers of a class may be."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: str(found) for name, hint in hints.items() if (found := _range(hint))}


def _range(annotation: object) -> Range | None:
    if isinstance(annotation, Range):
        return annotation
    return next(filter(None, map(_range, get_args(annotation))), None)


def _number(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _files() -> str:
    rows = []
    for file in limits.FILE_LIMITS:
        unpacked = size_text(file.content_bytes) if file.content_bytes != file.file_bytes else ""
        rows.append(
            (
                file.noun,
                size_text(file.file_bytes),
                unpacked,
                (file.line_bytes and size_text(file.line_bytes)) or "",
            )
        )
    return table(("file", "on disk", "unpacked", "a line"), *rows)


def _motion() -> str:
    rows = []
    for limit in dict.fromkeys((*MOVE_LIMITS, *TURN_LIMITS)):
        words = " ".join(inspect.getdoc(limit).split())  # type: ignore[union-attr]
        rows.append((f"`{limit.__name__}`", words.removeprefix("Return the ")))
    return table(("limit", "what it is"), *rows)


def _statics() -> str:
    """Return what motors and tyres of the nominal car and of the examples have to give, from statics."""
    rows = [("car", "wheel motors", "to climb", "with a slope", "spare on one axle", "tyres")]
    rows.append(
        (
            "",
            "",
            "gear friction + m g sin(16°) R / 4",
            "the same, its mass added",
            "2 (torque - gear friction) / R - m g sin(16°)",
            "friction above sqrt(2) tan(16°)",
        )
    )
    examples = {"nominal": NOMINAL}
    for name in ("light_car", "weak_car"):
        examples[f"`{name}.yaml`"] = load_machines(EXAMPLES / f"{name}.yaml")
    for name, machines in examples.items():
        car = machines.car(0)
        along_m_s2 = GRAVITY_M_S2 * math.sin(INCLINE_RAD)
        quarter_m = car.wheel_radius_m / 4
        loaded_kg = car.mass_kg + machines.slope.mass_kg
        axle_n = 2 * (car.wheel_torque_nm - car.gear_friction_nm) / car.wheel_radius_m
        rows.append(
            (
                f"{name}, {car.mass_kg:.1f} kg",
                f"{car.wheel_torque_nm:g} Nm",
                f"{car.gear_friction_nm + car.mass_kg * along_m_s2 * quarter_m:.2f} Nm",
                f"{car.gear_friction_nm + loaded_kg * along_m_s2 * quarter_m:.2f} Nm",
                f"{axle_n - car.mass_kg * along_m_s2:.0f} N",
                f"{car.roller_friction:g} where {math.sqrt(2) * math.tan(INCLINE_RAD):.2f} climbs",
            )
        )
    return table(*rows)


def _limits() -> str:
    found = _below(ast.parse(inspect.getsource(limits)).body)
    rows = [
        (
            f"`{name}`",
            size_text(value) if name.endswith("_BYTES") else f"{value:,.0f}",
            found.get(name, ""),
        )
        for name, value in vars(limits).items()
        if name.isupper() and isinstance(value, int | float) and name not in ("KIB", "MIB")
    ]
    return table(("constant", "value", "what it limits"), *rows)


def _gains() -> str:
    robust, fast = load_gains("robust"), load_gains("fast")
    parts = []
    for section, kind in SECTIONS.items():
        of, other, words = getattr(robust, section), getattr(fast, section), docstrings(kind)
        rows = [
            (
                f"`{name}`",
                _number(getattr(of, name)),
                _number(getattr(other, name)),
                words.get(name, ""),
            )
            for name in (field.name for field in dataclasses.fields(kind))
        ]
        parts.append(
            f"**`{section}`**\n\n" + table(("gain", "robust", "fast", "what it is"), *rows)
        )
    return "\n".join(parts)


def _parameters() -> str:
    parts = []
    for kind in (SmartcarParameters, BlockParameters, SlopeParameters, ContactParameters):
        ranges, rows = allowed(kind), []
        for field in dataclasses.fields(kind):
            if origin := field.metadata.get("origin"):
                note, fixed = field.metadata["note"], field.metadata["fixed"]
                may_be = f"fixed: {fixed}" if fixed else ranges.get(field.name, "any")
                rows.append(
                    (
                        f"`{field.name}`",
                        _number(field.default),
                        may_be,
                        f"{origin}{note and ': '}{note}".replace("``", "`"),
                    )
                )
        parts.append(
            f"**{kind.__name__}**\n\n" + table(("parameter", "nominal", "allowed", "origin"), *rows)
        )
    return "\n".join(parts)


def _noise() -> str:
    parts = []
    for title, part in (
        ("Physics", ""),
        ("Floor", "floor"),
        ("Drivetrain", "drivetrain"),
        ("Making", "making"),
        ("Sensors", "sensors"),
    ):
        drawn = {name: getattr(one, part) if part else one for name, one in RANDOMIZE.items()}
        if part == "sensors":
            drawn["assumed"] = ASSUMED
        kind = type(drawn["none"])
        words = docstrings(kind)
        names = [
            field.name
            for field in dataclasses.fields(kind)
            if part or field.name in allowed(DomainRandomization)
        ]
        rows = [
            (
                f"`{name}`",
                *(_number(getattr(one, name)) for one in drawn.values()),
                words.get(name, ""),
            )
            for name in names
        ]
        parts.append(f"## {title}\n\n" + table(("parameter", *drawn, "what it is"), *rows))
    return "\n".join(parts)


def _thresholds() -> str:
    limits = thresholds_of()
    words = docstrings(Thresholds)
    rows = []
    for field in dataclasses.fields(Thresholds):
        limit = getattr(limits, field.name)
        rows.append((f"`{field.name}`", f"{limit:.3g}", words[field.name]))
    return table(("limit", "value", "of what"), *rows)


def _measurements() -> str:
    words = docstrings(MeasuredValues)
    rows = []
    for name, row in MEASUREMENTS.items():
        limit = f"`{row.limit}`" if row.limit else ""
        rows.append((f"`{name}`", limit, words[name]))
    return table(("value", "limit", "what it is"), *rows)


def _settings() -> str:
    names: dict[type[Settings], list[str]] = {}
    for name, algorithm in ALGORITHMS.items():
        names.setdefault(algorithm.settings, []).append(f"`{name}`")
    rows = [
        (
            ", ".join(algorithms),
            f"`{of.name}`",
            of.default,
            allowed(kind)[of.name],
            docstrings(kind)[of.name],
        )
        for kind, algorithms in names.items()
        for of in dataclasses.fields(kind)
    ]
    return table(("algorithms", "setting", "default", "allowed", "what it is"), *rows)


def _fork() -> str:
    rows = []
    for name, (value, place) in {**FORK, **FORK_SETTINGS}.items():
        rows.append((f"`{name}`", value, f"`{place}`"))
    for name, (episodes, place) in FORK_EPISODES.items():
        rows.append((f"`{name}`", f"{episodes} episodes", f"`{place}`"))
    return table(("setting", "value", "in CraftEnv's code"), *rows)


def _reasons() -> str:
    rows = []
    for reason in REASONS.values():
        link = f"[`{reason.correction.name}`](#{reason.heading})" if reason.correction else ""
        words = re.sub(r"\{[^{}]*:if any\}", "", reason.words)
        words = (
            re.sub(r"\{[^{}]*:[^{}]*\}", "*object*", words)
            .replace("{car}", "*n*")
            .replace("{load}", "*load*")
        )
        rows.append((re.sub(r"\{[^{}]*\}", "*cell*", words), link))
    return table(("reason", "correction"), *rows)


def _commands() -> str:
    return "\n".join(
        f"## {' '.join(words)}\n\n```text\n{help_text(*words)}\n```\n" for words in command_names()
    )


def _prompt() -> str:
    (row, *_), *_ = chosen_rows().values()
    env = BuilderCase("", "grid", row, row).world()
    return f"```text\n{env.instructions}\n```\n\n```text\n{env.reset(seed=row)[0]}\n```\n"


def command_names() -> list[tuple[str, ...]]:
    """Return the commands that ``craftsim --help`` lists, each with those below it."""
    text = help_text()
    names = re.findall(r"^  ([a-z]+) +[A-Z]", text, re.MULTILINE)
    below = re.search(r"Subcommands: ([^.]*)\.", text)
    pairs = [tuple(words.split()) for words in below[1].split(",")] if below else []
    return [
        words for name in names for words in ((name,), *(pair for pair in pairs if pair[0] == name))
    ]


def help_text(*words: str) -> str:
    """Return what ``craftsim WORDS --help`` prints."""
    said, columns = io.StringIO(), os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = HELP_COLUMNS
    try:
        with contextlib.redirect_stdout(said):
            main([*words, "--help"])
    finally:
        if columns is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = columns
    return "\n".join(line.rstrip() for line in said.getvalue().strip().splitlines())


def _clearances() -> str:
    """Return how far the nominal machine passes below what it drives under, and the lippage that uses it up.

    Two wheels on a tile that is higher by h raise what lies x before the middle by h / 2 + x h / wheelbase. A stiff
    wheel that meets a step of h at speed v continues at right angles to its radius there, upwards with
    v sqrt(2 h / R), and rises by v^2 h / (g R).
    """
    car, block, slope = NOMINAL.cars[0], NOMINAL.block, NOMINAL.slope
    board_m = car.board_rest_m
    boss_m, pads_m = board_m + car.boss_height_m, slope.underside_m + slope.stop_back_rise_m
    speed = nominal_gains().drive.max_speed
    flown = max(speed**2 / (GRAVITY_M_S2 * car.wheel_radius_m), 1.0)
    rows = []
    for what, clearance_m, reach_m in (
        ("boss below the back bar of a slope's pads", pads_m - boss_m, car.boss_top_side_m / 2),
        ("board below a slope's rails", slope.underside_m - board_m, car.board_length_m / 2),
        ("boss below a block's frame", block.underside_m - boss_m, car.boss_top_side_m / 2),
        ("board below a block's frame", block.underside_m - board_m, car.board_length_m / 2),
    ):
        astride_m = clearance_m / (0.5 + reach_m / (2 * car.wheel_x_m))
        rows.append(
            (
                what,
                *(
                    f"{1e3 * length:.1f} mm"
                    for length in (clearance_m, astride_m, clearance_m / flown)
                ),
            )
        )
    return table(
        ("what", "clearance", "lippage with two wheels on it", f"lippage met at {speed:g} m/s"),
        *rows,
    )


def _plants(*instruments: str) -> str:
    """Return what instruments say of each fault, with the figures of the package without it."""
    stored = plants.read_stored()
    return "\n".join(f"**{name}**\n\n{table(*plants.row_of(stored, name))}" for name in instruments)


def _faults() -> str:
    rows = [(name, fault.words) for name, fault in plants.FAULTS.items() if name != plants.HEALTHY]
    return table(("fault", "what is wrong"), *rows)


TABLES: Final[dict[str, Callable[[], str]]] = {
    "clearances": _clearances,
    "commands": _commands,
    "faults": _faults,
    "files": _files,
    "fork": _fork,
    "gains": _gains,
    "limits": _limits,
    "measurements": _measurements,
    "motion": _motion,
    "noise": _noise,
    "parameters": _parameters,
    **{f"plants_{name.replace(' ', '_')}": partial(_plants, name) for name in plants.INSTRUMENTS},
    "prompt": _prompt,
    "reasons": _reasons,
    "settings": _settings,
    "statics": _statics,
    "thresholds": _thresholds,
}


class Generated(SphinxDirective):
    """Emit a table of :data:`TABLES`."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the table as it follows from the package now."""
        return self.parse_text_to_nodes(TABLES[self.arguments[0]](), allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("generated", Generated)
    return {"parallel_read_safe": False}

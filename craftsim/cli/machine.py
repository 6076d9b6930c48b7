"""A machine of your own: ``craftsim machine new`` and ``check``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

from craftsim.cli.options import Dir, File
from craftsim.cli.progress import working
from craftsim.cli.text import print_error, print_safe
from craftsim.errors import InputError
from craftsim.reports.publishing import publish
from craftsim.reports.report import (
    Block,
    Column,
    DataTable,
    Headline,
    Report,
    Section,
    TableCell,
    Tone,
    Value,
)
from craftsim.storage.folders import owning
from craftsim.storage.paths import exists

if TYPE_CHECKING:
    from craftsim.mjcf.car_reading import CarReading
    from craftsim.skills.limits import BindingLimits
    from craftsim.skills.requirements import Requirement

_MachineFile = Annotated[Path, Parameter(metavar="FILE")]
_ORIGINS: Final = {"read": Tone.GOOD, "assumed": Tone.CAUTION, "left out": Tone.BAD}
_TONES: Final = {"works": Tone.GOOD, "tight": Tone.CAUTION, "fails": Tone.BAD}


def new(
    out: _MachineFile = Path("machine.yaml"),
    *,
    source: Annotated[Path | None, Parameter(name="--from", metavar="MJCF")] = None,
    mapping: File = None,
) -> int:
    """Write a file with every parameter of the machines, to be edited, for --machines.

    Each line has a value, with its unit, meaning and origin as a comment; the first lines say what such a machine can
    do. Values are nominal, or read from a car's MJCF. Exit status: 0, 1 if something of the car cannot be represented,
    2 for invalid input, such as a file that is there already.

    Args:
        out: file to write.
        source: MJCF file of a car to read masses, motors, lift and sizes from; it needs --mapping.
        mapping: YAML file with the names of the car's parts in it (docs/how-to/machine.md).
    """
    from craftsim.mjcf.template import machines_text
    from craftsim.skills.requirements import remarks
    from craftsim.storage.writing import write_whole

    if exists(out) or out.is_symlink():
        raise InputError(f"{out} is there already; choose another name, or remove it")
    if (source is None) != (mapping is None):
        raise InputError("--from and --mapping go together: a car, and the names of its parts")
    again = f"Edit what differs, then see what that changes: craftsim machine check {out.name}"
    if source is None or mapping is None:
        first = ["Parameters of the machines, for --machines. The nominal ones can do this:", ""]
        write_whole(out, machines_text(remarks=[*first, *remarks(), "", again]))
        print_safe(f"{out}: the nominal machines. {again}")
        return 0
    from craftsim.mjcf.car_reading import read_car

    reading = read_car(source, mapping)
    first = [f"Parameters of the machines, for --machines; the car is that of {source.name}.", ""]
    origins = {}
    left_out = []
    for figure in reading.figures:
        if figure.origin == "left out":
            left_out.append(f"not represented: {figure.name}: {figure.words}")
        else:
            origins[figure.name] = f"{figure.origin}: {figure.words}"
    try:
        abilities = remarks(reading.machines)
    except InputError as error:
        # A loop that craftsim's steps cannot take; the file is to be edited.
        abilities = []
        left_out.append(f"not represented: {error}")
        print_error(error)
    lines = [*first, *abilities, *left_out, "", again]
    # What is read is named by its file, which is no comment's end.
    safe_lines = [" ".join(line.split()) for line in lines]
    write_whole(out, machines_text(reading.machines, safe_lines, origins))
    _print_reading(reading)
    print_safe(f"{out}: the car of {source}. {again}")
    return min(len(left_out), 1)


def _print_reading(reading: CarReading) -> None:
    """Print what was read, assumed and left out."""
    from craftsim.mjcf.machines import NOMINAL
    from craftsim.reports.terminal import Terminal, print_table

    rows: list[tuple[Value, ...]] = []
    for figure in reading.figures:
        value = ""
        nominal = ""
        if figure.value is not None:
            value = f"{figure.value:.4g}"
            nominal = f"{getattr(NOMINAL.cars[0], figure.name):.4g}"
        origin = TableCell(figure.origin, _ORIGINS[figure.origin])
        rows.append((figure.name, value, nominal, origin, figure.words))
    columns = (
        Column("parameter"),
        Column("value", "number"),
        Column("nominal", "number"),
        Column("origin"),
        Column("from", "wide"),
    )
    print_table(Terminal(), DataTable(columns, rows, "The car", most=100))


@owning
def check(machines: _MachineFile, *, out: Dir = Path("out/machine")) -> int:
    """Compare a machine with what tasks need, from its parameters alone, before any simulation.

    The table says what works, what works only in the nominal world, what fails, and what would have to change. Exit
    status: 0 if nothing fails, 1 if something does, 2 for invalid input, such as machines that do not fit each other.

    Args:
        machines: YAML file of machine parameters.
        out: folder for report.json and report.html.
    """
    with working(f"machine check {machines.name}"):
        report = _checked(machines)
    return publish(report, out)


def _checked(machines: Path) -> Report:
    """Return what the machines of a file can do."""
    from craftsim.mjcf.machines import NOMINAL, load_machines, machine_file
    from craftsim.reports.json_file import document
    from craftsim.skills.gains import Gains, load_gains
    from craftsim.skills.requirements import following_gains, motion_limits, requirements

    file = machine_file(machines)
    parameters = load_machines(file)
    gains = load_gains(file)
    nominal = motion_limits(NOMINAL, 0, Gains())
    cars: list[dict[str, Any]] = []
    sections = []
    verdicts = []
    for number, car in enumerate(parameters.cars):
        listed = requirements(parameters, number, gains)
        limits = motion_limits(parameters, number, gains)
        following = following_gains(parameters, number, gains)
        verdicts += [requirement.verdict for requirement in listed]
        cars.append(
            {
                "car": number,
                "mass_kg": car.mass_kg,
                "requirements": {item.key: _requirement_figures(item) for item in listed},
                "motions": {name: limit._asdict() for name, limit in limits.items()},
                "gains": {name: values[1] for name, values in following.items()},
            }
        )
        title = f"Car {number}, {car.mass_kg:.3g} kg"
        blocks: list[Block] = [
            _requirements_table(listed),
            _motions_table(limits, nominal),
            _gains_words(following),
        ]
        sections.append(Section(f"car{number}", title, "From statics.", blocks, terminal=True))
    failing = verdicts.count("fails")
    tight = verdicts.count("tight")
    if failing:
        headline = Headline("Fails", Tone.BAD, f"Needs of tasks that are not met: {failing}.")
    elif tight:
        headline = Headline("Tight", Tone.CAUTION, f"Nothing fails; tight: {tight}.")
    else:
        headline = Headline("Works", Tone.GOOD, "Tasks get what they need.")
    figures = {"failing": failing, "tight": tight, "cars": cars}
    config = {
        "machines": parameters,
        "digests": {"machines": parameters.digest, "gains": gains.digest},
    }
    return Report(
        "What a machine can do",
        str(machines),
        headline,
        sections=sections,
        document=document(figures, command="machine check", seed=0, config=config),
        exit_code=min(failing, 1),
    )


def _gains_words(following: dict[str, tuple[float, float]]) -> str:
    """Return which gains follow from the machine, before and after."""
    changed = []
    for name, (before, after) in following.items():
        if after != before:
            changed.append(f"{name} becomes {after:.3g}, not {before:.3g}")
    if not changed:
        return "No gain changes with this machine."
    return f"Gains that change with this machine: {'; '.join(changed)}."


def _requirement_figures(requirement: Requirement) -> dict[str, Any]:
    """Return a need as the report has it; its key is that of the mapping."""
    figures: dict[str, Any] = {
        "gives": requirement.gives,
        "least": requirement.least,
        "sure": requirement.sure,
        "unit": requirement.unit,
        "verdict": requirement.verdict,
        "parameter": requirement.parameter,
        "changes": [],
    }
    if requirement.verdict != "works":
        figures["changes"] = requirement.changes
    return figures


def _requirements_table(car_requirements: list[Requirement]) -> DataTable:
    rows: list[tuple[Value, ...]] = []
    for requirement in car_requirements:
        least = ""
        if requirement.least is not None:
            least = f"{requirement.least:.3g}"
        changes = ""
        if requirement.verdict != "works":
            changes = ", or ".join(requirement.changes)
        verdict = TableCell(requirement.verdict, _TONES[requirement.verdict])
        gives = f"{requirement.gives:.3g} {requirement.unit}".rstrip()
        rows.append((requirement.words, gives, least, f"{requirement.sure:.3g}", verdict, changes))
    columns = (
        Column("need"),
        Column("gives", "number"),
        Column("fails below", "number"),
        Column("sure from", "number"),
        Column("verdict"),
        Column("to change", "wide"),
    )
    return DataTable(columns, rows, "Needs of tasks")


def _motions_table(
    limits: dict[str, BindingLimits], nominal: dict[str, BindingLimits]
) -> DataTable:
    rows: list[tuple[Value, ...]] = []
    for name, limit in limits.items():
        usual = nominal[name]
        speeds = f"{limit.speed:.3g} ({usual.speed:.3g})"
        accelerations = f"{limit.acceleration:.3g} ({usual.acceleration:.3g})"
        causes = limit.speed_cause
        if limit.acceleration_cause != causes:
            causes += f", {limit.acceleration_cause}"
        rows.append((name, speeds, accelerations, causes))
    columns = (
        Column("motion"),
        Column("speed (nominal)", "number"),
        Column("acceleration (nominal)", "number"),
        Column("limited by", "wide"),
    )
    return DataTable(
        columns, rows, "Limits: of paths in m/s and m/s², of turns in rad/s and rad/s²"
    )

"""Recorded runs again: ``craftsim replay`` and ``compare``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from craftsim.cli.options import Dir
from craftsim.cli.progress import counting, working
from craftsim.errors import InputError
from craftsim.reports.publishing import publish
from craftsim.reports.report import Block, Headline, KeyFigure, Report, Section, Tone
from craftsim.storage.folders import owning
from craftsim.storage.paths import resolved
from craftsim.validation.options import Seeded

if TYPE_CHECKING:
    from craftsim.experiments.bundle import Recorded, Replay


@owning
def replay(
    bundle: Annotated[Path, Parameter(metavar="BUNDLE")],
    *,
    video: bool = False,
    minimize: bool = False,
    skills: Annotated[str | None, Parameter(metavar="MODULE:NAME")] = None,
    out: Dir = Path("out/replay"),
) -> int:
    """Re-run a replay bundle and compare it with the recording.

    With the versions of the bundle everything must be bit-equal; with others, poses must agree within 2 mm and 10 mrad,
    and every action must have the same result. Exit status: 0 if it is reproduced, 1 if it differs, 2 for an invalid
    bundle.

    Args:
        bundle: folder of the bundle.
        video: film it, three seconds.
        minimize: instead of comparing, reduce its first failure to the smallest world in which it occurs.
        skills: the user-defined skills with which the bundle was made; nothing named in a bundle is imported.
        out: folder for report.json and the film, or for the smallest world.
    """
    if video and minimize:
        raise InputError("--video and --minimize exclude each other; give one of them")
    if skills is not None:
        from craftsim.skills.library import own_skills

        own_skills(skills)
    if minimize:
        return _minimize(bundle, out)
    from craftsim.cli.films import film_failure, record_bundle, rendering_works
    from craftsim.experiments.bundle import read_bundle
    from craftsim.experiments.bundle import replay as run_again

    filming = video and rendering_works()
    recorded = read_bundle(bundle)
    files: dict[str, Path] = {}
    if filming:
        files["Film"] = out / f"{resolved(bundle).name}.mp4"
        with working(f"replay and film {bundle.name}"):
            result, trajectory = record_bundle(recorded)
            film_failure(trajectory, files["Film"])
    else:
        with working(f"replay {bundle.name}"):
            result = run_again(recorded)
    return publish(_report(recorded, result, bundle.name, files), out)


def _minimize(folder: Path, out: Path) -> int:
    """Shrink what a bundle shows; exit status 0 when it fails from a fresh start, too."""
    from craftsim.experiments.bundle import read_bundle
    from craftsim.experiments.minimize import MOST_TRIALS, minimize_bundle
    from craftsim.reports.json_file import document
    from craftsim.validation.report import smallest_section

    bundle = read_bundle(folder).bundle
    with counting("trials", bool)(MOST_TRIALS) as on_trial:
        smallest = minimize_bundle(bundle, out, ".", on_trial)
    headline = Headline("Not made smaller", Tone.CAUTION, smallest.sentence)
    if smallest.cells is not None:
        size = " x ".join(map(str, smallest.cells))
        headline = Headline(
            "Smallest world", Tone.GOOD, f"It fails in a world of {size} cells, too."
        )
    figures = {"bundle": folder.name, "smallest": smallest}
    report = Report(
        "Smallest world of a failure",
        bundle.key,
        headline,
        sections=smallest_section([smallest]),
        document=document(figures, command="replay", config={"shrink": True}),
        exit_code=1 if smallest.cells is None else 0,
    )
    return publish(report, out)


def _report(recorded: Recorded, result: Replay, name: str, files: dict[str, Path]) -> Report:
    from craftsim.reports.json_file import document, versions
    from craftsim.validation.report import actions_table

    bundle = recorded.bundle
    apart = f"{1e3 * result.position_m:.2g} mm and {1e3 * result.angle_rad:.2g} mrad apart at most"
    notes = []
    for package, (recorded_version, version) in result.changed.items():
        notes.append(
            f"Recorded with {package} {recorded_version}, replayed with {version}: bits may differ."
        )
    if not result.differing:
        headline = Headline("Reproduced", Tone.GOOD, "Reproduced: the same bit for bit.")
    elif result.reproduced:
        headline = Headline("Reproduced", Tone.GOOD, f"Reproduced within the tolerance: {apart}.")
    else:
        differing = f"DIFFERS: {apart}. Not the same: {', '.join(result.differing)}."
        headline = Headline("Differs", Tone.BAD, differing)
        platform = bundle.versions.get("platform")
        if platform != versions()["platform"]:
            notes.append(
                f"It was recorded on {platform}; bits are the same on one kind of machine only."
            )
    blocks: list[Block] = [bundle.key, actions_table(bundle.attempts, "As recorded")]
    if headline.tone is not Tone.GOOD:
        blocks.append(actions_table(result.attempts, "Now"))
    for attempt in bundle.attempts:
        if attempt.reason:
            blocks.append(f"car {attempt.car} {attempt.action}: {attempt.result}. {attempt.reason}")
    figures = {"bundle": name, "key": bundle.key, "changed_versions": result.changed}
    names = ("reproduced", "differing", "position_m", "angle_rad", "attempts")
    return Report(
        "Replay of a failure",
        bundle.key,
        headline,
        [KeyFigure(f"{1e3 * result.position_m:.2g} mm", "apart at most")],
        [Section("actions", "Actions", "Of the last step of the bundle.", blocks, terminal=True)],
        notes,
        files,
        document(figures | {name: getattr(result, name) for name in names}, command="replay"),
        0 if result.reproduced else 1,
    )


@owning
def compare(
    run: Path,
    other: Path,
    *,
    control: bool = True,
    chance: Seeded = Seeded(),  # noqa: B008
    out: Dir = Path("out/compare"),
) -> int:
    """Compare two runs of the same trials, such as a simulation and a laboratory.

    Trials are paired by world, plan or policy, and number; outcomes, durations, errors and ranks are compared. The
    control arm pairs trials of the first run, between which nothing is changed. The seed is that of the bootstrap. Exit
    status: 0 if neither the share of trials that agree nor the duration of an action differs at the 5 % level, 1 if one
    does, 2 for runs that cannot be compared.

    Args:
        run: folder of 'craftsim validate' or 'craftsim audit'.
        other: folder of the other run.
        control: show the control arm.
        out: folder for report.json.
    """
    from craftsim.experiments.compare import compare_with_reality
    from craftsim.experiments.compare_report import gap_report
    from craftsim.validation.record_schemas import read_run

    with working(f"compare {run.name} and {other.name}"):
        gap = compare_with_reality(read_run(run), read_run(other), chance.seed, control=control)
    return publish(gap_report(gap, run, other, chance.seed), out)

"""What ``craftsim demo`` says on the screen; everything fits in 80 columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from rich.table import Table

from craftsim.cli.terminal import cell
from craftsim.cli.text import say
from craftsim.validation.building import Building

_OTHER_GOALS: Final[dict[str, tuple[str, str]]] = {
    "free_building": ("all blocks form one platform", "the blocks do NOT form one platform"),
    "breaking_barrier": ("the flag is at the goal", "the flag is NOT at the goal"),
}
"""What to say of goals that are no building, reached and missed."""


def actions_table(building: Building) -> Table:
    """Return a table with a row for each action."""
    caption = "cell, heading, load, low or high on a slope; mm, mrad: error of the car"
    table = Table(title="Predicted by the rules, read from poses", caption=caption, box=None, pad_edge=False)
    for heading in ("tick", "car", "action", "predicted", "read", "result"):
        table.add_column(heading, no_wrap=heading != "result", overflow="fold")
    for heading in ("s", "mm", "mrad"):
        table.add_column(heading, justify="right", no_wrap=True)
    for attempt in building.attempts:
        table.add_row(
            str(attempt.tick),
            str(attempt.car),
            attempt.action,
            attempt.predicted,
            "same" if attempt.read == attempt.predicted else attempt.read,
            f"[{'green' if attempt.agrees else 'red'}]{'agrees' if attempt.agrees else attempt.result}[/]",
            f"{attempt.duration_s:.2f}",
            f"{attempt.car_error_m * 1e3:.2f}",
            f"{attempt.heading_error_rad * 1e3:.2f}",
        )
    return table


def summary(buildings: Sequence[Building]) -> Table:
    """Return a table with a row for each building."""
    caption = "s: makespan; at worst: mm, mrad of cars, set: mm of things set down, others: mm that bystanders moved"
    table = Table(title="Built in physics, checked by the rules", caption=caption, box=None, pad_edge=False)
    table.add_column("task", no_wrap=True)
    for heading in ("ticks", "agree", "goal", "s", "mm", "mrad", "set", "others"):
        table.add_column(heading, justify="right", no_wrap=True)
    for one in buildings:
        figures = one.figures
        worst = ("car_error_mm", "car_heading_error_mrad", "placed_error_mm", "bystander_displacement_mm")
        goal = {None: "none", True: "[green]reached[/]", False: "[red]missed[/]"}[one.reached]
        table.add_row(
            cell(one.name),
            str(figures["ticks"]),
            f"[{'green' if one.n_agree == one.n_actions else 'red'}]{one.n_agree} of {one.n_actions}[/]",
            goal,
            f"{figures['makespan_s']:.1f}",
            *("-" if (value := figures[f"max_{name}"]) is None else f"{value:.2f}" for name in worst),
        )
    return table


def print_worst(figures: dict[str, Any]) -> None:
    """Say how inexact the worst action of a run was; nothing of what was not set down."""
    placed = figures["max_placed_error_mm"]
    say(
        f"At worst: cars {figures['max_car_error_mm']:.2f} mm and "
        f"{figures['max_car_heading_error_mrad']:.2f} mrad off, "
        + ("" if placed is None else f"things set down {placed:.2f} mm off, ")
        + f"bystanders moved {figures['max_bystander_displacement_mm']:.2f} mm. "
        f"{figures['simulated_s']:.1f} s simulated."
    )


def print_disagreements(building: Building, name_task: bool) -> None:
    """Print for each action that does not agree why."""
    prefix = f"{building.name}, " if name_task else ""
    for attempt in building.attempts:
        if not attempt.agrees:
            where = f"{prefix}tick {attempt.tick}, car {attempt.car} {attempt.action}"
            lines = dict.fromkeys((attempt.reason, *attempt.differences))
            say(f"{where}: {'; '.join(lines)}")


def conclusion(buildings: Sequence[Building]) -> str:
    """Return the last line: how many actions agree, and whether the goal, or each goal, is reached."""
    agree, total = sum(one.n_agree for one in buildings), sum(one.n_actions for one in buildings)
    actions = f"{agree} of {total} actions agree with the rules"
    if len(buildings) > 1:
        return f"{actions}; {sum(one.reached is True for one in buildings)} of {len(buildings)} goals are reached."
    return f"{actions}; {_goal_words(buildings[0])}."


def _goal_words(building: Building) -> str:
    if building.reached is None:
        return "no goal was given"
    words = ("the building matches its goal", "the building does NOT match its goal")
    if building.task.design is None:
        words = _OTHER_GOALS.get(building.name, ("the goal is reached", "the goal is NOT reached"))
    return words[0] if building.reached else words[1]

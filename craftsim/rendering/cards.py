"""What the cards at the start and at the end of a film say."""

from __future__ import annotations

from collections import Counter

from craftsim.discrete.grid import Kind
from craftsim.rendering.panel import BAD, GOOD, Frame, card
from craftsim.rendering.trajectory import Trajectory

_SHOWN = 3
"""Reasons of disagreements that an end card lists."""


def title_card(trajectory: Trajectory, size: tuple[int, int], title: str) -> Frame:
    """Return the card that says what comes."""
    story = trajectory.story
    recipe, setup = story.recipe, story.recipe.setup
    kinds = Counter(name.split()[0] for name in story.poses)
    things = [f"{n} {kind}{'s' * (n != 1)}" for kind, n in kinds.items()]
    if walls := int((recipe.grid.kind == Kind.WALL).sum()):
        things.append(f"{walls} wall{'s' * (walls != 1)}")
    drawn = "nominal physics" if setup.randomization.nominal else "randomized physics"
    lines = [
        ", ".join(things),
        f"{sum(a.performed for a in story.attempts)} actions, predicted by the {setup.rules} rules",
        f"{setup.machines.drive} drive, {drawn}",
        f"craftsim {story.versions.get('craftsim', '?')}, MuJoCo {story.versions.get('mujoco', '?')}",
    ]
    return card(size, title, lines)


def end_card(trajectory: Trajectory, size: tuple[int, int]) -> Frame:
    """Return the card that says what was found."""
    attempts = [a for a in trajectory.story.attempts if a.performed]
    good = sum(a.agrees for a in attempts)
    lines = [f"{trajectory.duration_s:.1f} s of simulated time"]
    if attempts:
        off = 1e3 * max(a.car_error_m for a in attempts)
        moved = 1e3 * max(a.bystander_displacement_m for a in attempts)
        lines.append(
            f"cars at most {off:.2g} mm off their cells' centres, bystanders moved by {moved:.2g} mm"
        )
    wrong = [a for a in attempts if not a.agrees]
    lines += [f"car {a.car} {a.action}: {a.result}. {a.reason}" for a in wrong[:_SHOWN]]
    return card(size, f"{good} of {len(attempts)} actions as predicted", lines, BAD if wrong else GOOD)

"""Text in films: captions beside the picture, the title card and the end card."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont, ImageOps

from craftsim.checking.attempt import SAME_TIME_S, Attempt
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.drawing import car_colour
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.rendering.encode import Frame
from craftsim.rendering.trajectory import Trajectory

Colour = tuple[int, int, int]

PAPER: Final[Colour] = (250, 250, 248)
_INK: Final[Colour] = (38, 42, 48)
_PALE: Final[Colour] = (140, 146, 154)
_RULE: Final[Colour] = (214, 216, 218)
_GOOD: Final[Colour] = (34, 128, 74)
_BAD: Final[Colour] = (192, 48, 40)
_SHOWN_S: Final = 6.0
"""Simulated time for which a verdict on an action that went well stays; others stay until the car's next one."""
_CARS: Final = 8  # cars that a panel has room for
_CAR: Final = 3.9
"""Units of a car with a verdict of one line."""
_NARROW: Final = 8  # units that a car takes from top to bottom, and at least from left to right
_HEAD: Final = 9.0
"""Units of a panel's title in two lines, clock and progress."""
_WITH_VERDICT: Final = 5.2
"""Units of a car with a verdict of two lines."""
_WIDE: Final = 12.4
"""Units of the width of a panel in which every action is in one line."""
_LISTED: Final = 16
"""Latest actions that a panel may list."""
_TEXT: Final = 0.44  # share of a card's width for its text; of a tall card's height
_REASONS: Final = 3  # disagreements that an end card lists


class CarCaption(NamedTuple):
    """The caption of one car."""

    car: int
    action: str = "waits"
    verdict: str = ""
    """On its last action; empty where it is long ago, or none has ended."""
    agrees: bool = True
    """That verdict."""


class EndedAction(NamedTuple):
    """An action that has ended."""

    car: int
    words: str
    agrees: bool
    time_s: float


class Caption(NamedTuple):
    """The captions of one moment."""

    title: str
    step: int
    """Actions begun so far."""
    n_steps: int
    cars: tuple[CarCaption, ...]
    ended: tuple[EndedAction, ...]
    """The latest actions that have ended, the last one first."""
    time_s: float
    factor: float | None
    """Simulated seconds in a second of film; none in a picture, and after the end."""


def caption_of(trajectory: Trajectory, time_s: float, factor: float | None) -> Caption:
    """Return the captions of a trajectory at a simulated time; after its end the clock stands still."""
    story = trajectory.story
    performed = sorted((a for a in story.attempts if a.performed), key=lambda a: a.start_s)
    started = [a for a in performed if a.has_begun(time_s)]
    n_cars = trajectory.measured.shape[1]
    cars = tuple(_car(car, [a for a in started if a.car == car], time_s) for car in range(n_cars))
    ends_s = float(trajectory.time[-1])
    if time_s > ends_s + SAME_TIME_S:
        cars = tuple(car._replace(action="has finished") for car in cars)
        time_s = ends_s
        factor = None
    ended = [a for a in started if a.has_ended(time_s)]
    ended.sort(key=lambda a: a.start_s + a.duration_s, reverse=True)
    latest = tuple(
        EndedAction(a.car, ACTIONS[Action[a.action]].words, a.agrees, a.start_s + a.duration_s)
        for a in ended[:_LISTED]
    )
    return Caption(story.title, len(started), len(performed), cars, latest, time_s, factor)


def _car(car: int, started: Sequence[Attempt], time_s: float) -> CarCaption:
    running = [a for a in started if not a.has_ended(time_s)]
    action = "waits"
    if running:
        action = ACTIONS[Action[running[-1].action]].words
    ended = [a for a in started if a.has_ended(time_s)]
    if not ended or (
        ended[-1].agrees and time_s - ended[-1].start_s - ended[-1].duration_s > _SHOWN_S
    ):
        return CarCaption(car, action)
    last = ended[-1]
    reason = ""
    if last.reason:
        reason = f" - {last.reason}"
    return CarCaption(
        car, action, f"{ACTIONS[Action[last.action]].words}: {last.result}{reason}", last.agrees
    )


def draw_panel(caption: Caption, size: tuple[int, int], side: int) -> Frame:
    """Return a panel of ``size`` (width, height) in pixels with a caption; ``side`` is the shorter side of the film."""
    unit = _unit(size, side, len(caption.cars))
    still, y = _without_clock(size, unit, *caption[:5])
    picture = still.copy()
    speed = ""
    if caption.factor is not None:
        speed = f"   x{caption.factor:.2g}"
    face = _font(round(1.15 * unit), "bold")
    ImageDraw.Draw(picture).text((unit, y), f"{caption.time_s:.1f} s{speed}", _INK, face)
    return np.asarray(picture)


@lru_cache(maxsize=8)
def _unit(size: tuple[int, int], side: int, n_cars: int) -> int:
    """Return the size of a panel's text in pixels: as large as leaves room for each car, so that it fills the panel.

    It is the same for all moments of a film.
    """
    width, height = size
    smallest = max(9, round(side / 42))
    for unit in range(round(side / 22), smallest, -1):
        if width >= _WIDE * unit and height >= (_HEAD + _WITH_VERDICT * n_cars) * unit:
            return unit
    return smallest


@lru_cache(maxsize=8)
def _without_clock(
    size: tuple[int, int],
    unit: int,
    title: str,
    step: int,
    n_steps: int,
    cars: tuple[CarCaption, ...],
    ended: tuple[EndedAction, ...],
) -> tuple[Image.Image, int]:
    """Return all of a panel but the clock, and the row at which that begins; many frames share it."""
    picture = Image.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(picture)
    width, height = size
    inner = width - 2 * unit
    bold = _font(round(1.25 * unit), "bold")
    y = unit
    for line in _wrap(draw, title, bold, inner, 3):
        draw.text((unit, y), line, _INK, bold)
        y += round(1.65 * unit)
    clock_at = y
    y += round(1.8 * unit)
    if n_steps:
        draw.text((unit, y), f"action {step} of {n_steps}", _PALE, _font(unit))
        y += round(1.5 * unit)
        done = round(inner * step / n_steps)
        draw.rectangle((unit, y, unit + inner, y + unit // 4), _RULE)
        draw.rectangle((unit, y, unit + done, y + unit // 4), _INK)
        y += round(1.3 * unit)
    shown_cars = cars[:_CARS]
    a_column = max(1, min(len(shown_cars), int((height - y) / (_CAR * unit))))
    columns = max(1, min(-(-len(shown_cars) // a_column), inner // (_NARROW * unit)))
    a_column = -(-len(shown_cars) // columns)
    wide = inner // columns
    room = (height - y) // (round(1.35 * unit) * max(1, a_column)) - 2
    room = min(5, max(1 if columns > 1 else 2, room))
    top = y
    for number, car in enumerate(shown_cars):
        if number % a_column == 0:
            y = top
        y = _draw_car(draw, car, (unit + number // a_column * wide, y), unit, wide, room)
    if len(cars) > len(shown_cars):
        draw.text((unit, y), f"and {len(cars) - len(shown_cars)} more cars", _PALE, _font(unit))
    elif columns == 1:
        # From the lowest place that the cars' captions may reach, so that the list does not move.
        y = max(y, top + round(_WITH_VERDICT * unit * len(cars)))
        _draw_ended(draw, ended, (unit, y), unit, inner, height - unit)
    return picture, clock_at


def _draw_ended(
    draw: ImageDraw.ImageDraw,
    ended: Sequence[EndedAction],
    corner: tuple[int, int],
    unit: int,
    inner: int,
    lowest: int,
) -> None:
    """Draw the latest actions from a corner on, as many as are above a row of the picture."""
    x, y = corner
    face = _font(round(0.9 * unit))
    line = round(1.5 * unit)
    for action in ended:
        if y + line > lowest:
            return
        red, green, blue = (round(255 * channel) for channel in car_colour(action.car))
        middle = y + line // 2
        dot = round(0.3 * unit)
        draw.ellipse((x, middle - dot, x + 2 * dot, middle + dot), (red, green, blue))
        ink = _GOOD if action.agrees else _BAD
        draw.text((x + unit, middle), action.words, ink, face, anchor="lm")
        draw.text((x + inner, middle), f"{action.time_s:.1f} s", _PALE, face, anchor="rm")
        y += line


def _draw_car(
    draw: ImageDraw.ImageDraw,
    car: CarCaption,
    corner: tuple[int, int],
    unit: int,
    inner: int,
    room: int,
) -> int:
    """Draw the caption of a car from a corner on, with ``room`` lines for its verdict; return where it ends."""
    x, y = corner
    badge = round(1.7 * unit)
    red, green, blue = (round(255 * channel) for channel in car_colour(car.car))
    draw.rounded_rectangle((x, y, x + badge, y + badge), unit // 3, (red, green, blue))
    middle = x + badge / 2, y + badge / 2
    draw.text(middle, str(car.car), (255, 255, 255), _font(unit, "bold"), anchor="mm")
    if car.action == "waits":
        ink = _PALE
    else:
        ink = _INK
    face = _font(round(1.1 * unit))
    draw.text((x + badge + unit // 2, middle[1]), car.action, ink, face, anchor="lm")
    y += round(2.1 * unit)
    small = _font(round(0.9 * unit))
    for line in _wrap(draw, car.verdict, small, inner, room):
        draw.text((x, y), line, _GOOD if car.agrees else _BAD, small)
        y += round(1.25 * unit)
    return y + unit // 2


def title_card(trajectory: Trajectory, size: tuple[int, int], picture: Frame) -> Frame:
    """Return the title card: the world, the rules and the physics, beside a picture."""
    story = trajectory.story
    recipe = story.recipe
    setup = story.recipe.setup
    counts = Counter(name.split()[0] for name in story.poses)
    counts["wall"] = int((recipe.grid.kind == Kind.WALL).sum())
    if setup.randomization.nominal:
        physics = "nominal physics"
    else:
        physics = "randomized physics"
    lines = [
        ", ".join(f"{n} {kind}{'s' * (n != 1)}" for kind, n in counts.items() if n),
        f"{sum(a.performed for a in story.attempts)} actions by the {setup.rules} rules",
        f"{setup.machines.drive} drive, {physics}",
        f"craftsim {story.versions.get('craftsim', '?')}, MuJoCo {story.versions.get('mujoco', '?')}",
    ]
    return _card(size, picture, story.title, lines)


def end_card(trajectory: Trajectory, size: tuple[int, int], picture: Frame) -> Frame:
    """Return the end card: how many actions did as predicted, and the largest errors, beside a picture."""
    attempts = [a for a in trajectory.story.attempts if a.performed]
    lines = [f"{trajectory.duration_s:.1f} s of simulated time"]
    if attempts:
        off = 1e3 * max(a.car_error_m for a in attempts)
        moved = 1e3 * max(a.bystander_displacement_m for a in attempts)
        lines += [
            f"cars within {off:.2g} mm of cell centres",
            f"bystanders moved by {moved:.2g} mm",
        ]
    wrong = [a for a in attempts if not a.agrees]
    lines += [f"car {a.car} {a.action}: {a.result}. {a.reason}" for a in wrong[:_REASONS]]
    good = f"{len(attempts) - len(wrong)} of {len(attempts)} actions as predicted"
    return _card(size, picture, good, lines, _BAD if wrong else _GOOD)


def label(picture: Frame, text: str) -> Frame:
    """Return a picture with a short text in its lower left corner."""
    labelled = Image.fromarray(picture)
    unit = max(9, picture.shape[0] // 16)
    place = (unit // 2, picture.shape[0] - unit // 2)
    ImageDraw.Draw(labelled).text(place, text, _INK, _font(unit), anchor="ls")
    return np.asarray(labelled)


def _card(
    size: tuple[int, int], picture: Frame, title: str, lines: Sequence[str], colour: Colour = _INK
) -> Frame:
    """Return a card of a size, text at its left and a picture at its right, or below where it is tall."""
    width, height = size
    if width >= height:
        wide = round(_TEXT * width)
        high = height
    else:
        wide = width
        high = round(_TEXT * height)
    card = Image.new("RGB", size, PAPER)
    if width >= height:
        picture_size = (width - wide, height)
    else:
        picture_size = (width, height - high)
    fitted_picture = ImageOps.pad(
        Image.fromarray(picture), picture_size, color=tuple(picture[0, 0].tolist())
    )
    card.paste(fitted_picture, (width - picture_size[0], height - picture_size[1]))
    draw = ImageDraw.Draw(card)
    unit = max(9, round(min(0.8 * high, wide) / 30))
    large = _font(round(2.1 * unit), "bold")
    small = _font(round(1.25 * unit))
    head = _wrap(draw, title, large, wide - 5 * unit, 3)
    body = []
    for line in lines:
        for wrapped in _wrap(draw, line, small, wide - 5 * unit, 3):
            body.append(wrapped)
    y = (high - round(2.8 * unit) * len(head) - 2 * unit * len(body) - unit) // 2
    for line in head:
        draw.text((3 * unit, y), line, colour, large)
        y += round(2.8 * unit)
    draw.line((3 * unit, y + unit // 4, 9 * unit, y + unit // 4), colour, max(1, unit // 6))
    y += unit
    for line in body:
        draw.text((3 * unit, y), line, _INK, small)
        y += 2 * unit
    return np.asarray(card)


_SPACE: Final = re.compile(
    r"\s+(?!(?<=\d )(?:mm|m|ms|s|N|rad|mrad|%)(?!\w))"
)  # where a line may end


@lru_cache(maxsize=32)
def _font(size: int, weight: Literal["regular", "bold"] = "regular") -> ImageFont.FreeTypeFont:
    import matplotlib  # here, since most of what imports this module draws no text

    if weight == "bold":
        name = "DejaVuSans-Bold.ttf"
    else:
        name = "DejaVuSans.ttf"
    return ImageFont.truetype(Path(matplotlib.get_data_path(), "fonts", "ttf", name), size)


def _wrap(
    draw: ImageDraw.ImageDraw, text: str, face: ImageFont.FreeTypeFont, width: int, max_lines: int
) -> list[str]:
    """Return a text in lines that fit into a width in pixels, at most ``max_lines``; what is left out shows as an
    ellipsis, a word that is too long is broken, and a number stays with its unit."""
    lines = [""]
    for word in _SPACE.split(text):
        joined = f"{lines[-1]} {word}".strip()
        if draw.textlength(joined, face) <= width:
            lines[-1] = joined
            continue
        if lines[-1]:
            lines += [""]
        while draw.textlength(word, face) > width and len(word) > 1:
            sizes = range(len(word) - 1, 0, -1)
            fits = next((n for n in sizes if draw.textlength(word[:n], face) <= width), 1)
            fits = max(word.rfind(mark, 1, fits) + 1 for mark in "/_-") or fits
            lines[-1] = word[:fits]
            lines.append("")
            word = word[fits:]
        lines[-1] = word
    lines = [line for line in lines if line]
    if len(lines) > max_lines:
        lines = [*lines[: max_lines - 1], lines[max_lines - 1] + "\N{HORIZONTAL ELLIPSIS}"]
    return lines

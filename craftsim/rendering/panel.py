"""The panel beside a film's picture, and the cards at its start and its end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from craftsim.discrete.drawing import CAR_COLOURS
from craftsim.rendering.captions import Caption, CarCaption
from craftsim.rendering.text import Colour, font, wrap

Frame = NDArray[np.uint8]
"""A picture, shape (height, width, 3), red green blue."""

PAPER: Final[Colour] = (250, 250, 248)
INK: Final[Colour] = (38, 42, 48)
PALE: Final[Colour] = (140, 146, 154)
RULE: Final[Colour] = (214, 216, 218)
GOOD: Final[Colour] = (34, 128, 74)
BAD: Final[Colour] = (192, 48, 40)
_CARS: Final = 8
"""Cars that a panel has room for."""


def car_colour(car: int) -> Colour:
    """Return a car's colour in films."""
    red, green, blue = (round(255 * part) for part in CAR_COLOURS[car % len(CAR_COLOURS)])
    return red, green, blue


class Panel:
    """Draws captions; what has not changed since the last one is not drawn again."""

    def __init__(self, size: tuple[int, int], tall: int) -> None:
        """Prepare for a panel of ``size`` (width, height) in pixels of a film that is ``tall`` pixels high."""
        self.size = size
        self._unit = max(9, round(tall / 42))
        self._drawn: tuple[object, ...] = ()
        self._picture = Image.new("RGB", size, PAPER)
        self._clock_at = 0

    def draw(self, caption: Caption) -> Frame:
        """Return the panel with a caption."""
        content = caption.title, caption.step, caption.n_steps, caption.cars
        if content != self._drawn:
            self._drawn, self._picture = content, self._still(caption)
        picture = self._picture.copy()
        draw = ImageDraw.Draw(picture)
        unit = self._unit
        draw.text((unit, self._clock_at), caption.clock, INK, font(round(1.15 * unit), "bold"))
        return np.asarray(picture)

    def _still(self, caption: Caption) -> Image.Image:
        """Return all but the clock."""
        picture = Image.new("RGB", self.size, PAPER)
        draw = ImageDraw.Draw(picture)
        unit, (width, height) = self._unit, self.size
        inner = width - 2 * unit
        y = unit
        for line in wrap(draw, caption.title, font(round(1.25 * unit), "bold"), inner, 3):
            draw.text((unit, y), line, INK, font(round(1.25 * unit), "bold"))
            y += round(1.65 * unit)
        self._clock_at = y
        y += round(1.8 * unit)
        if caption.n_steps:
            draw.text((unit, y), f"action {caption.step} of {caption.n_steps}", PALE, font(unit))
            y += round(1.5 * unit)
            done = round(inner * caption.step / caption.n_steps)
            draw.rectangle((unit, y, unit + inner, y + unit // 4), RULE)
            draw.rectangle((unit, y, unit + done, y + unit // 4), INK)
            y += round(1.3 * unit)
        cars = caption.cars[:_CARS]
        room = max(2, (height - y) // (round(1.35 * unit) * max(1, len(cars))) - 2)
        for car in cars:
            y = self._car(draw, car, y, inner, room)
        if len(caption.cars) > len(cars):
            draw.text((unit, y), f"and {len(caption.cars) - len(cars)} more cars", PALE, font(unit))
        return picture

    def _car(self, draw: ImageDraw.ImageDraw, car: CarCaption, y: int, inner: int, room: int) -> int:
        """Draw what is said of a car from ``y`` on, with ``room`` lines for its verdict; return where it ends."""
        unit = self._unit
        badge = round(1.7 * unit)
        draw.rounded_rectangle((unit, y, unit + badge, y + badge), unit // 3, car_colour(car.car))
        middle = unit + badge / 2, y + badge / 2
        draw.text(middle, str(car.car), (255, 255, 255), font(unit, "bold"), anchor="mm")
        left = unit + badge + unit // 2
        ink = PALE if car.action == "waits" else INK
        draw.text((left, middle[1]), car.action, ink, font(round(1.1 * unit)), anchor="lm")
        y += round(2.1 * unit)
        small = font(round(0.9 * unit))
        for line in wrap(draw, car.verdict, small, inner, min(room, 5)) if car.verdict else []:
            draw.text((unit, y), line, GOOD if car.agrees else BAD, small)
            y += round(1.25 * unit)
        return y + unit // 2


def card(size: tuple[int, int], title: str, lines: Sequence[str], colour: Colour = INK) -> Frame:
    """Return a card with a title and lines below, ``size`` (width, height) in pixels."""
    width, height = size
    picture = Image.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(picture)
    unit = max(9, round(min(height, 0.6 * width) / 30))
    large, small = font(round(2.4 * unit), "bold"), font(round(1.25 * unit))
    head = wrap(draw, title, large, width - 6 * unit, 2)
    body = [part for line in lines for part in wrap(draw, line, small, width - 6 * unit, 3)]
    y = (height - round(3.1 * unit) * len(head) - 2 * unit * len(body) - unit) // 2
    for line in head:
        draw.text((3 * unit, y), line, colour, large)
        y += round(3.1 * unit)
    draw.line((3 * unit, y + unit // 4, 9 * unit, y + unit // 4), colour, max(1, unit // 6))
    y += unit
    for line in body:
        draw.text((3 * unit, y), line, INK, small)
        y += 2 * unit
    return np.asarray(picture)

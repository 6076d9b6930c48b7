"""What motors and machines bore: wheel torques, boards and hinges, and forces of contact, against their limits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from craftsim.discrete.drawing import car_colour
from craftsim.mjcf.car import WHEELS
from craftsim.rendering.plots.signals import CarSignals, Signals
from craftsim.rendering.plots.style import dash, shade
from craftsim.rendering.plots.timeline import Diagram, each_car, legend, limit, line

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WHEEL_WORDS: Final = dict(zip(WHEELS, ("front left", "front right", "rear left", "rear right"), strict=True))


def torque_rows(signals: Signals, most: int) -> list[Diagram]:
    """Return a diagram of the wheel torques of each car that acted."""
    return each_car([car for car in signals.cars if car.attempts], lambda car: _torques(signals, car, most))


def _torques(signals: Signals, car: CarSignals, most: int) -> Diagram:
    def draw(axes: Axes) -> None:
        for number, words in enumerate(_WHEEL_WORDS.values()):
            colour = car_colour(car.car) if number == 0 else shade(number - 1)
            line(axes, signals, car.torque_nm[:, number], most, colour, dash(number), words)
        limit(axes, car.torque_limit_nm, "limit")
        limit(axes, -car.torque_limit_nm, "")
        axes.set_ylim(-1.25 * car.torque_limit_nm, 1.25 * car.torque_limit_nm)
        legend(axes, len(WHEELS))

    return Diagram(f"car {car.car}: wheel torques", "Nm", draw, car.car)


def board_rows(signals: Signals, most: int) -> list[Diagram]:
    """Return diagrams of the boards' heights and forces, and of the hinges where there are slopes."""

    def heights(axes: Axes) -> None:
        for car in signals.cars:
            name = f"car {car.car}" if len(signals.cars) <= 6 else str(car.car)
            line(axes, signals, 1e3 * car.board_m, most, car_colour(car.car), dash(car.car), name)
        legend(axes, min(12, len(signals.cars)))

    def forces(axes: Axes) -> None:
        for car in signals.cars:
            line(axes, signals, car.board_force_n, most, car_colour(car.car), dash(car.car), str(car.car))
        most_n = max(car.board_limit_n for car in signals.cars)
        largest = max(float(np.nanmax(np.abs(car.board_force_n), initial=0)) for car in signals.cars)
        if largest > most_n / 2:
            limit(axes, most_n, f"limit {most_n:.0f} N")
        else:
            words = f"limit {most_n:.0f} N, above this diagram"
            axes.annotate(words, (0.003, 0.86), xycoords="axes fraction", fontsize=6.5)

    def hinges(axes: Axes) -> None:
        for number, angle in enumerate(signals.hinges_rad):
            line(axes, signals, np.rad2deg(angle), most, shade(number), dash(number), f"slope {number}")
        legend(axes, min(8, len(signals.hinges_rad)))

    rows = [Diagram("height of the boards", "mm", heights), Diagram("force of the boards", "N", forces)]
    if signals.hinges_rad:
        rows.append(Diagram("angle of the hinges", "degrees", hinges))
    return rows if signals.cars else rows[2:]


def contact_rows(signals: Signals, most: int) -> list[Diagram]:
    """Return the diagram of the largest force between any two machines; none where contacts were not looked at."""
    if np.isnan(signals.contact_n).all():
        return []

    def draw(axes: Axes) -> None:
        line(axes, signals, signals.contact_n, most, shade(1), "-", "largest of all")
        limit(axes, signals.impact_limit_n, f"limit {signals.impact_limit_n:.0f} N")
        axes.set_ylim(0, 1.12 * max(signals.impact_limit_n, float(np.nanmax(signals.contact_n))))

    return [Diagram("largest force between two machines", "N", draw, height=1.6)]

"""The imperfections that can be varied: every numeric field of a DomainRandomization and of its parts.

Fields in ``craftsim/data/imperfections.yaml`` have a name, a largest value or companions given there; any other field,
including one added later, takes them from its name and unit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from operator import attrgetter
from typing import Any, Final

from craftsim.audit.situation import shipped
from craftsim.errors import InputError, suggestion
from craftsim.models.randomization import NONE, DomainRandomization

PREFERRED: Final = (
    *(1.0, 1.12, 1.25, 1.4, 1.6, 1.8, 2.0, 2.24, 2.5, 2.8),
    *(3.15, 3.55, 4.0, 4.5, 5.0, 5.6, 6.3, 7.1, 8.0, 9.0),
)
"""Preferred numbers of ISO 3's series R20, in steps of 12 %: levels are these times a power of ten."""
DECADES: Final = 2
_UNITS: Final = {
    "_m": ("mm", 1e3, 0.02),
    "_rad": ("mrad", 1e3, 0.1),
    "_s": ("ms", 1e3, 0.25),
    "_n": ("N", 1.0, 0.8),
    "_share": ("%", 1e2, 0.8),
    "": ("%", 1e2, 0.8),
}
"""By suffix of a field's name: the displayed unit, its factor, the largest value."""
_SHAPES: Final = ("floor.tile_m", "floor.wavelength_m", "sensors.min_delay_s")
"""Fields that shape another imperfection and are not varied alone."""


@dataclass(frozen=True)
class Imperfection:
    """One imperfection that is varied, all others nominal; hashable."""

    name: str
    """Name in reports and options, such as ``position-bias``."""
    figure: str
    """Field of a DomainRandomization, with a dot for a nested one, such as ``sensors.position_bias_m``."""
    unit: str
    scale: float
    """Factor from the field's own unit to ``unit``."""
    largest: float
    """The largest value tried, in the field's own unit."""
    also: tuple[tuple[str, float | None], ...] = ()
    """Companion fields: with a fixed value, or None for the same value."""

    @property
    def words(self) -> str:
        """The name in words."""
        return self.name.replace("-", " ")

    @property
    def levels(self) -> tuple[float, ...]:
        """The values tried, ascending."""
        exponents = range(-12, 12)
        values = []
        for power in exponents:
            for number in PREFERRED:
                values.append(number * 10.0**power)
        low = self.largest / 10.0**DECADES
        return tuple(
            float(f"{v:.3g}") for v in values if low * (1 - 1e-9) <= v <= self.largest * (1 + 1e-9)
        )

    def value(self, base: DomainRandomization) -> float:
        """Return the value in a nominal randomization."""
        return float(attrgetter(self.figure)(base))

    def on(self, base: DomainRandomization, value: float) -> DomainRandomization:
        """Return the nominal randomization with this field set. Raises InputError for a value out of its range."""
        for figure, fixed_value in ((self.figure, value), *self.also):
            if fixed_value is None:
                fixed_value = value
            base = _with(base, figure, fixed_value)
        return base

    def text(self, value: float) -> str:
        """Return a value with its unit."""
        return f"{self.scale * value:.3g} {self.unit}"


DEFAULT_IMPERFECTIONS: Final = (
    *(
        "lippage",
        "unevenness",
        "floor-tilt",
        "friction",
        "mass",
        "motor-strength",
        "backlash",
        "motor-lag",
    ),
    *(
        "wheel-radius",
        "underside-height",
        "pocket-place",
        "position-noise",
        "heading-noise",
        "position-bias",
    ),
    *("heading-bias", "delay", "localisation-period", "lost-localisations"),
)
_ALL: Final = "all"


@cache
def imperfections() -> dict[str, Imperfection]:
    """Return all imperfections by name, in the order of the fields."""
    by_name = {}
    entries = shipped("imperfections.yaml")
    for figure in _figures(NONE):
        entry = entries.get(figure, {})
        ending = next(end for end in _UNITS if figure.endswith(end))
        unit, scale, usual = _UNITS[ending]
        name = entry.get("name", figure.rpartition(".")[2].removesuffix(ending).replace("_", "-"))
        if figure not in _SHAPES:
            largest = entry.get("largest", usual)
            also = tuple(entry.get("also", {}).items())
            by_name[name] = Imperfection(name, figure, unit, scale, largest, also)
    return by_name


def imperfections_of(names: Sequence[str]) -> tuple[Imperfection, ...]:
    """Return the imperfections of these names; ``all`` gives every one. Raises InputError for an unknown name."""
    by_name = imperfections()
    for name in names:
        if name not in by_name and name != _ALL:
            raise InputError(
                f"no imperfection '{name}'{suggestion(name, by_name)}; there are {', '.join(by_name)}, {_ALL}"
            )
    if _ALL in names:
        return tuple(by_name.values())
    return tuple(by_name[name] for name in dict.fromkeys(names))


def _figures(randomization: Any, prefix: str = "") -> Iterator[str]:
    """Yield the dotted names of the fields of nested dataclasses."""
    for field in fields(randomization):
        value = getattr(randomization, field.name)
        if is_dataclass(value):
            yield from _figures(value, f"{prefix}{field.name}.")
        else:
            yield prefix + field.name


def _with(base: Any, figure: str, value: float) -> Any:
    name, _, inner = figure.partition(".")
    if inner:
        return replace(base, **{name: _with(getattr(base, name), inner, value)})
    return replace(base, **{name: value})

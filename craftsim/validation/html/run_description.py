"""The last section of a page: what the figures hang on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from craftsim.report import plain, versions
from craftsim.validation.html.page import Cell, Column, Section, Table


@dataclass(frozen=True)
class RunDescription:
    """What decides the figures of a run, as in its ``report.json``."""

    command: str
    """As it can be typed again."""
    seed: int
    config: Mapping[str, Any]
    thresholds: Mapping[str, Any]
    """Limits that were set before the run, by name, with units in the names."""
    versions: Mapping[str, str] = field(default_factory=versions)

    @classmethod
    def of(cls, command: str, seed: int, config: Mapping[str, Any]) -> RunDescription:
        """Return the description of a run by its configuration, the ``setup`` of the physics included."""
        setup = config["setup"]
        brief = {key: value for key, value in config.items() if key != "setup"}
        return cls(
            command,
            seed,
            plain(brief | {"gains": setup.gains, "machines": setup.machines}),
            plain(setup.thresholds),
        )


def provenance_section(provenance: RunDescription) -> Section:
    """Return the section that tells thresholds, seed, versions and configuration."""
    return Section(
        "provenance",
        "Thresholds and provenance",
        "The thresholds were set before the run. Seed, configuration and versions decide every figure: "
        "on one machine, the same ones give this page again, byte for byte.",
        (
            _table("Thresholds", "threshold", provenance.thresholds),
            _table(
                "Run",
                "setting",
                {"command": provenance.command, "seed": provenance.seed, **provenance.config},
            ),
            _table("Versions", "package", provenance.versions),
        ),
    )


def _table(caption: str, name: str, values: Mapping[str, Any]) -> Table:
    return Table(
        (Column(name), Column("value")),
        tuple((Cell(key, path=True), Cell(value, path=True)) for key, value in _flat(plain(values))),
        caption=caption,
    )


def _flat(value: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the leaves of nested mappings with their dotted names."""
    if isinstance(value, Mapping) and value:
        for key, item in value.items():
            yield from _flat(item, f"{prefix}.{key}" if prefix else str(key))
    elif isinstance(value, list):
        yield prefix, ", ".join("none" if item is None else str(item) for item in value) or "none"
    else:
        yield prefix, "none" if value is None or value == {} else str(value)

"""Writing a world as files that open alone in the MuJoCo viewer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from craftsim.discrete.grid import Cell, Grid
from craftsim.models.composition import compose
from craftsim.models.config import SimulationConfig
from craftsim.models.parameters import NOMINAL, Machines
from craftsim.models.placement import placements


def write_scene(
    folder: Path,
    grid: Grid,
    config: SimulationConfig | None = None,
    goals: Sequence[Cell] = (),
    machines: Machines = NOMINAL,
) -> None:
    """Write ``site.xml``, the start of a world before it settles, and its meshes into a folder."""
    spec, _ = compose(grid, placements(grid, machines), config or SimulationConfig(), goals, machines)
    spec.compile()
    for name, data in spec.assets.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "site.xml").write_text(spec.to_xml(), encoding="utf-8")

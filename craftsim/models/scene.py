"""Writing a world as files that open alone in the MuJoCo viewer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from craftsim.discrete.grid import Cell, Grid
from craftsim.mjcf.parameters import NOMINAL, Machines
from craftsim.models.composition import compose
from craftsim.models.config import SimulationConfig
from craftsim.models.parts import load_part
from craftsim.models.placement import placements
from craftsim.storage.folders import directory_within
from craftsim.storage.writing import write_whole


def write_scene(
    folder: Path,
    grid: Grid,
    config: SimulationConfig | None = None,
    goals: Sequence[Cell] = (),
    machines: Machines = NOMINAL,
) -> None:
    """Write ``site.xml``, the start of a world before it settles, and its meshes into a folder.

    Raises InputError where the disk does not take a file.
    """
    ground, parts = load_part("ground", machines), placements(grid, machines)
    config = config or SimulationConfig.of(machines.drive)
    spec, _ = compose(ground, grid.size, parts, config, goals, machines)
    spec.compile()
    files = {**spec.assets, "site.xml": spec.to_xml()}
    for name, content in files.items():
        inner = Path(folder.name, name)
        write_whole(directory_within(folder.parent, *inner.parent.parts) / inner.name, content)

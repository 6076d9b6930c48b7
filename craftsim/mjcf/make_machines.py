"""Write the nominal machines' MJCF and meshes: ``python -m craftsim.mjcf.make_machines [DIRECTORY]``."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

from craftsim.mjcf.meshes import RECORD, lengths, make_meshes
from craftsim.mjcf.parameters import NOMINAL
from craftsim.mjcf.rendering import PARTS, render


def write_machines(directory: Path) -> None:
    """Write every part's MJCF, every mesh and the record of what the meshes were made from into a directory."""
    meshes = directory / "meshes"
    meshes.mkdir(parents=True, exist_ok=True)
    machines = NOMINAL.cars[0], NOMINAL.block, NOMINAL.slope
    for figures in machines:
        for name, data in make_meshes(figures).items():
            (meshes / f"{name}.obj").write_bytes(data)
    record = {type(figures).__name__: lengths(figures) for figures in machines}
    (directory / RECORD.name).write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    for part in PARTS:
        (directory / f"{part}.xml").write_text(render(part, NOMINAL), encoding="utf-8")
    reduced = render("smartcar", replace(NOMINAL, drive="reduced"))
    (directory / "smartcar_reduced.xml").write_text(reduced, encoding="utf-8")


if __name__ == "__main__":
    write_machines(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

"""Machines and worlds as MJCF text that opens alone in MuJoCo's viewer; ``python -m craftsim.models.exporting`` writes
the nominal machines into ``craftsim/mjcf``, or into another folder."""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Final

import mujoco

from craftsim.errors import InputError
from craftsim.mjcf.block import TABLE_NAMES, TABLES
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.composition import MACHINES, machine_spec
from craftsim.storage.folders import output_directory
from craftsim.storage.paths import is_folder
from craftsim.storage.writing import write_whole

_TITLES: Final = {
    "ground": "The floor, the light and the physics settings of every world.",
    "smartcar": "A mecanum smartcar with a lifting board: forty free rollers, turned by four wheel motors.",
    **{name: TABLES[kind].title for name, kind in TABLE_NAMES.items()},
    "slope": "A ramp that folds into a box: a hollow base, and a wedge, the flap, on a motorised hinge.",
    "smartcar_reduced": "The smartcar on the reduced drive: four spheres without friction, pushed by its motors.",
}
_SOURCE: Final = """
       Written from the builders and parameters in craftsim/mjcf by python -m craftsim.models.exporting.
       contype and conaffinity: TOUCHES in craftsim/mjcf/building.py says what touches what. """


def text_of(spec: mujoco.MjSpec) -> str:
    """Return the MJCF of a spec; its meshes are in it."""
    spec.compile()
    text: str = spec.to_xml()
    return text


def machine_texts() -> dict[str, str]:
    """Return the MJCF of each nominal machine, alone on the floor, by the name of its file without its ending."""
    reduced = replace(NOMINAL, drive="reduced")
    specs = {kind: machine_spec(kind, NOMINAL) for kind in MACHINES}
    specs["smartcar_reduced"] = machine_spec("smartcar", reduced)
    for name, spec in specs.items():
        spec.comment = f" {_TITLES[name]}{_SOURCE}"
    return {name: text_of(spec) for name, spec in specs.items()}


def write_mjcf(path: Path, spec: mujoco.MjSpec) -> Path:
    """Write a machine, or the start of a world before it settles, as one file; return its path.

    Raises InputError where the disk does not take the file.
    """
    return write_whole(new_file(path), text_of(spec))


def new_file(path: Path) -> Path:
    """Return the path of a file to be written, in whose folder it can be; raise InputError for what is no such path."""
    if not path.name or is_folder(path):
        raise InputError(f"{path}: is a folder; give the name of a file")
    return output_directory(path.parent) / path.name


def write_machines(folder: Path) -> None:
    """Write the files of the nominal machines into a folder."""
    for name, text in machine_texts().items():
        write_whole(folder / f"{name}.xml", text)


if __name__ == "__main__":
    write_machines(Path(sys.argv[1] if len(sys.argv) > 1 else str(files("craftsim.mjcf"))))

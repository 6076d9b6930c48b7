"""The player of recordings in the site: its scripts, MuJoCo for browsers, and what there is to be shown.

Run as a program it needs neither Sphinx nor craftsim, and writes a page of the player alone into out/player.

MuJoCo's WebAssembly build comes from the npm index, in the version and with the digest that package-lock.json in
docs/player names. Without npm, or without a network, the site has none: the player then replays, and does not simulate.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOT: Final = Path(__file__).parents[2]
SCRIPTS: Final = (ROOT / "craftsim/reports/template/player", ROOT / "docs/player")
GALLERY: Final = ROOT / "docs" / "gallery"
RECORDINGS: Final = GALLERY / "recordings"
PACKAGES: Final = ROOT / "out" / "npm"
MUJOCO: Final = PACKAGES / "node_modules" / "@mujoco" / "mujoco"
LOCK: Final = "package-lock.json"
NPM: Final = ("npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--silent")
NPM_S: Final = 120
PAGE: Final = """<!doctype html><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>craftsim in 3D</title><link rel="stylesheet" href="player/player.css">
<div id="player"></div><script type="module" src="player/page.js"></script>"""
NO_MUJOCO: Final = "it replays and does not simulate: npm could not install MuJoCo"


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the player to an HTML site once it is built."""
    app.connect("build-finished", _add_to_site)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _add_to_site(app: Sphinx, exception: Exception | None) -> None:
    if exception is not None or app.builder.format != "html":
        return
    from sphinx.util import logging

    if not fetch_mujoco():
        logging.getLogger(__name__).info(f"the site's player: {NO_MUJOCO}")
    assemble(Path(app.outdir) / "_static" / "player")


def write_page(folder: Path) -> None:
    """Write a page that has the player and nothing else."""
    assemble(folder / "player")
    (folder / "index.html").write_text(PAGE, encoding="utf-8")


def fetch_mujoco() -> bool:
    """Install MuJoCo's build for browsers unless it is there; return whether it is."""
    wanted = ROOT / "docs" / "player" / LOCK
    installed = PACKAGES / LOCK
    if MUJOCO.is_dir() and installed.read_bytes() == wanted.read_bytes():
        return True
    PACKAGES.mkdir(parents=True, exist_ok=True)
    for name in ("package.json", LOCK):
        shutil.copy(wanted.with_name(name), PACKAGES)
    try:
        subprocess.run(NPM, cwd=PACKAGES, check=True, timeout=NPM_S, capture_output=True)
    except (OSError, subprocess.SubprocessError):
        return False
    return MUJOCO.is_dir()


def assemble(folder: Path) -> None:
    """Write all that the player needs into a folder, with MuJoCo if it is installed."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for scripts in SCRIPTS:
        for ending in ("js", "css"):
            for path in scripts.glob(f"*.{ending}"):
                shutil.copy(path, folder)
    has_mujoco = MUJOCO.is_dir()
    if has_mujoco:
        for name in ("mujoco.js", "mujoco.wasm"):
            shutil.copy(MUJOCO / name, folder)
    shown = catalogue()
    for entry in shown:
        shutil.copy(RECORDINGS / entry["recording"], folder)
        shutil.copy(GALLERY / entry["film"], folder / Path(entry["film"]).name)
        entry["film"] = Path(entry["film"]).name
    contents = {"simulates": has_mujoco, "shown": shown}
    (folder / "catalogue.json").write_text(json.dumps(contents), encoding="utf-8")


def catalogue() -> list[dict[str, str]]:
    """Return what the player can show: name, group, title, sentence, recording, and the film that shows the same."""
    stored = json.loads((GALLERY / "gallery.json").read_text(encoding="utf-8"))
    shown = []
    for part in ("tasks", "buildings"):
        for name, entry in stored[part].items():
            title = f"{name.replace('_', ' ')}, {entry['agree']} as predicted"
            shown.append(_entry("Buildings", name, title, f"films/{name}.mp4"))
    for name in stored["overlap"]:
        film = f"films/{name}.mp4"
        shown.append(_entry("Buildings", f"{name}_ticks", f"{name}, in ticks", film))
        shown.append(_entry("Buildings", f"{name}_concurrent", f"{name}, asynchronously", film))
    on_rollers = "strip on forty rollers a car, the reference drive"
    shown.append(_entry("Buildings", "strip_rollers", on_rollers, "films/strip.mp4"))
    for name, entry in stored["rules"].items():
        shown.append(_entry("Unsound rules", name, name, f"{name}.webp", entry["sentence"]))
    return [entry for entry in shown if (RECORDINGS / entry["recording"]).is_file()]


def _entry(group: str, name: str, title: str, film: str, sentence: str = "") -> dict[str, str]:
    return {
        "name": name,
        "group": group,
        "title": title,
        "sentence": sentence,
        "recording": f"{name}.json.gz",
        "film": film,
    }


if __name__ == "__main__":
    if not fetch_mujoco():
        print(NO_MUJOCO)
    write_page(ROOT / "out" / "player")

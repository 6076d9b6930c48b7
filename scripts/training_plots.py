"""Draw the plots of docs/training again, from the reports of studies that lie there. Usage: training_plots.py"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

from craftsim.studies.results import plot_results
from craftsim.studies.study import read_study

SHOWN: Final = {
    "paper": ("curves.png", "profiles.png"),
    "random": ("curves.png",),
    "random_complex": ("curves.png",),
    "designs": ("curves.png",),
}
FOLDER: Final = Path(__file__).parents[1] / "docs/training"


def main() -> None:
    """Write what the page shows of each study."""
    for name, shown in SHOWN.items():
        report = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
        folder = FOLDER / name
        folder.mkdir(exist_ok=True)
        for path in plot_results(folder, read_study(name), report["figures"]):
            if path.name in shown:
                print(path.relative_to(FOLDER.parent))
            else:
                path.unlink()


if __name__ == "__main__":
    main()

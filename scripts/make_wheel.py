"""Build the wheel in dist/ with compiled code for any processor of this platform, which this Python and numba read.

Other versions and platforms can use the wheel as well, and compile what they call.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]


def main() -> int:
    """Compile in a copy of the sources, and build the wheel from that."""
    with tempfile.TemporaryDirectory() as folder:
        source, cache = Path(folder) / "source", Path(folder) / "cache"
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / "craftsim", source / "craftsim", ignore=ignore)
        for name in ("pyproject.toml", "README.md", "LICENSE"):
            shutil.copy(ROOT / name, source)
        environment = os.environ | {
            "PYTHONPATH": str(source),
            "NUMBA_CPU_NAME": "generic",
            "NUMBA_CACHE_DIR": str(cache),
        }
        precompile = [sys.executable, ROOT / "scripts" / "precompile.py"]
        subprocess.run(precompile, env=environment, cwd=folder, check=True)
        shipped = source / "craftsim" / "data" / "compiled"
        # What only compiled functions call is a part of these, and of use to who compiles alone.
        ignore = shutil.ignore_patterns("lock", "*.part-*")
        shutil.copytree(cache / "craftsim-compiled", shipped, ignore=ignore)
        pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
        subprocess.run([*pip, "--wheel-dir", ROOT / "dist", source], check=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())

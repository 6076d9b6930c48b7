"""The libraries that only training needs."""

from __future__ import annotations

import os
from importlib.util import find_spec
from typing import Final

from craftsim.errors import InputError

PACKAGES: Final = ("torch", "tensordict", "torchrl")


def need_torch() -> None:
    """Raise InputError with the command that installs what is missing."""
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        raise InputError(
            f"training needs {', '.join(missing)}, not installed here; in a checkout of craftsim try: "
            "pip install '.[train]' (a CPU build of torch is enough: pip install torch --index-url https://download.pytorch.org/whl/cpu)"
        )
    # TorchRL says on standard output what it allocates, unless it is asked not to before it is imported.
    os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")

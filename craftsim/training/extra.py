"""The libraries that only training needs."""

from __future__ import annotations

import os
from typing import Final

from craftsim.extras import need

PACKAGES: Final = ("torch", "tensordict", "torchrl")


def need_torch() -> None:
    """Raise InputError with the command that installs what is missing."""
    cpu = "pip install torch --index-url https://download.pytorch.org/whl/cpu"
    need(
        "train",
        "training needs",
        *PACKAGES,
        "safetensors",
        remark=f" (a CPU build of torch is enough: {cpu})",
    )
    # TorchRL says on standard output what it allocates, unless it is asked not to before it is imported.
    os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")

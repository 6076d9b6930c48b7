"""The libraries that only training needs."""

from __future__ import annotations

from typing import Final

from craftsim.extras import need

PACKAGES: Final = ("torch",)


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

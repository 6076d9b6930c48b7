"""Contents of policy and run files, to be changed and written again."""

import json

from safetensors import safe_open
from safetensors.torch import save_file


def read_content(path):
    """Return what a file holds: its head by name, and its tensors."""
    with safe_open(path, "pt") as file:
        told, tensors = file.metadata(), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    return {"format": told["format"], "head": json.loads(told["craftsim"]), "tensors": tensors}


def write_content(path, content):
    """Write what :func:`read_content` returned, with whatever was changed in it."""
    told = {"format": str(content["format"]), "craftsim": json.dumps(content["head"])}
    save_file(content["tensors"], path, told)

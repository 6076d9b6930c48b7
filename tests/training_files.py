"""Contents of policy and run files, to be changed and written again."""

import json

import torch
from safetensors import safe_open
from safetensors.torch import save_file


def read_content(path):
    """Return what a file holds: its head by name, and all else."""
    if path.suffix == ".pt":
        content = torch.load(path, weights_only=True)
        return {**content, "head": json.loads(content["head"])}
    with safe_open(path, "pt") as file:
        told, tensors = file.metadata(), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    return {"format": told["format"], "head": json.loads(told["craftsim"]), "tensors": tensors}


def write_content(path, content):
    """Write what :func:`read_content` returned, with whatever was changed in it."""
    if "tensors" not in content:
        head = {"head": json.dumps(content["head"])} if "head" in content else {}
        torch.save({**content, **head}, path)
    else:
        told = {"format": str(content["format"]), "craftsim": json.dumps(content["head"])}
        save_file(content["tensors"], path, told)

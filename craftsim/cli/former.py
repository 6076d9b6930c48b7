"""Former names of commands and options, which work until 0.4 with a message."""

from __future__ import annotations

from typing import Final

from craftsim.cli.text import print_error
from craftsim.errors import InputError

COMMANDS: Final[dict[str, tuple[str, ...]]] = {
    "build": ("validate", "--plan", "auto"),
    "evaluate": ("validate", "--backend", "grid"),
    "export": ("validate", "--record", "minari"),
    "margins": ("audit", "margins"),
    "clearance": ("audit", "clearance"),
    "plot": ("render",),
    "study": ("train", "study"),
    "excite": ("robot", "excite"),
    "identify": ("robot", "identify"),
}
"""Present name of each former command."""
DEFAULTS: Final[dict[str, dict[str, str]]] = {
    "build": {"--trials": "1", "--out": "out/build"},
    "evaluate": {"--trials": "1000", "--out": "out/evaluate"},
    "export": {"--trials": "100", "--backend": "grid", "--out": "out/minari"},
    "plot": {"--out": "out/plots/"},
}
"""Former defaults that differ from the present ones."""
SCRIPTS: Final = {
    "builders": "python scripts/builders.py",
    "execution": "python scripts/plan_orders.py, or for policies python scripts/policy_modes.py",
}
"""What were measurements of bench are scripts of a checkout."""
NO_OPTION: Final = "no option"
"""Stands for the words before all options."""
DEFAULT: Final = "the default"
"""Stands for an option that is dropped."""
HIDDEN: Final = {
    word: new
    for flag in ("ghost", "captions", "cards")
    for word, new in ((f"--{flag}", DEFAULT), (f"--no-{flag}", f"--hide {flag}"))
}
"""Former flags of render and plot, now values of --hide."""
OPTIONS: Final[dict[str, dict[str, str]]] = {
    "": {"--against": "--baseline", "--shrink": "--minimize", "--parameters": "--machines"},
    "build": {"--rounds": "--attempts"},
    "plan": {"--rounds": "--attempts", "--time": "--time-limit"},
    "demo": {"--timeout-s": "--timeout", "--blueprint": "--task", "--start": "--task"},
    "evaluate": {"--episodes": "--trials", "--task": "", NO_OPTION: "--policy"},
    "export": {"--episodes": "--trials", "--name": "--dataset"},
    "audit": {"--contexts": "--situations"},
    "margins": {"--axes": "", "--scenarios": "--situations", "--pair": "--map"},
    "robot": {"--patience-s": "--timeout", "--blueprint": "--task", "--start": "--task"},
    "excite": {"--time": "--duration"},
    "render": HIDDEN,
    "plot": HIDDEN,
    "show": {"--blueprint": "", "--machine": "", "--mjcf": "--export", "--urdf": "--export"},
}
"""Present names of former options by former command, "" for all commands; an empty name is an argument."""
SET: Final = (
    *("worlds", "width", "network", "novelty", "explore", "imitate", "shown-share", "pretrained", "stages"),
    *("stage-steps", "acting", "drive", "randomize", "rules", "helper-depth", "cars", "blocks", "starts"),
    *("workers", "tensorboard", "settings"),
)
"""Former options of train, now settings of --set."""


def current(words: list[str]) -> list[str]:
    """Return a command line with present names; print on standard error which were former ones.

    Raises InputError for what is a script now.
    """
    name, given = words[0], words[1:]
    if name == "bench" and given and given[0] in SCRIPTS:
        raise InputError(f"'bench {given[0]}' is a script of a checkout now: {SCRIPTS[given[0]]}")
    command = COMMANDS.get(name, (name,))
    if name == "robot" and not {*given[:1]} & {"serve", "excite", "identify", "--help", "-h"}:
        command = ("robot", "serve")
    if command != (name,):
        _tell(name, " ".join(command))
    options = OPTIONS[""] | OPTIONS.get(name, {})
    if name == "train" and given[:1] != ["study"]:
        options |= {f"--{option}": "--set" for option in SET}
    if name in ("validate", "audit", "train"):
        options |= {"--record": "--record trajectory"}
    positional, given = _renamed(given, options)
    if not {"-h", "--help"} & {*given}:
        for option, value in DEFAULTS.get(name, {}).items():
            given += [] if option in given else [option, value]
    return [*command, *positional, *given]


def _tell(old: str, new: str) -> None:
    print_error(f"'{old}' is called '{new}' now; the old name goes away in 0.4")


def _renamed(given: list[str], options: dict[str, str]) -> tuple[list[str], list[str]]:
    """Return the values of options that are arguments now, and the other words with present names."""
    parts = [(NO_OPTION, list[str]())]
    for word in given:
        if word.startswith("--") and len(word) > 2:
            parts.append((word, []))
        else:
            parts[-1][1].append(word)
    positional, others = list[str](), list[str]()
    for option, values in parts:
        bare, equals, value = option.partition("=")
        off = bare.startswith("--no-")
        name = bare.removeprefix("--no-").removeprefix("--")
        new = options.get(bare, options.get(f"--{name}") if off else None)
        kept = ([] if option == NO_OPTION else [option]) + values
        values = [value, *values] if equals else values
        valued = (name == "record" and (off or values)) or (bare in HIDDEN and equals)
        if new is None or valued or (bare == NO_OPTION and not values):
            others += kept
            continue
        if bare != NO_OPTION:
            _tell(bare, new or "an argument")
        if new == "":
            positional += values
        elif new == "--set":
            said = ",".join(values) or ("false" if off else "true")
            others += ["--set", f"{name.replace('-', '_')}={said}"]
        elif new == DEFAULT:
            others += values
        else:
            off = off and bare not in options
            others += [*(new.replace("--", "--no-", 1) if off else new).split(), *values]
    return positional, others

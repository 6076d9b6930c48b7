"""Former names of commands and options, which work until 0.4 with a message."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from craftsim.cli.text import print_error

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
OPTIONS: Final[dict[str, dict[str, str]]] = {
    "": {"--against": "--baseline", "--shrink": "--minimize", "--parameters": "--machines"},
    "build": {"--rounds": "--attempts"},
    "plan": {"--rounds": "--attempts", "--time": "--time-limit"},
    "demo": {"--timeout-s": "--timeout", "--blueprint": "--task", "--start": "--task"},
    "evaluate": {"--episodes": "--trials", "--task": ""},
    "export": {"--episodes": "--trials", "--name": "--dataset"},
    "audit": {"--contexts": "--situations"},
    "margins": {"--axes": "", "--scenarios": "--situations", "--pair": "--map"},
    "robot": {"--patience-s": "--timeout", "--blueprint": "--task", "--start": "--task"},
    "excite": {"--time": "--duration"},
    "show": {"--blueprint": "", "--machine": "", "--mjcf": "--export", "--urdf": "--export"},
}
"""Present names of former options by former command, "" for all commands; an empty name is an argument."""
HIDDEN: Final = ("ghost", "captions", "cards")
"""Former flags of render, now values of --hide."""
SET: Final = (
    *("worlds", "width", "network", "novelty", "explore", "imitate", "shown-share", "pretrained", "stages"),
    *("stage-steps", "acting", "drive", "randomize", "rules", "helper-depth", "cars", "blocks", "starts"),
    *("workers", "tensorboard", "settings"),
)
"""Former options of train, now settings of --set."""


def current(words: list[str]) -> list[str]:
    """Return a command line with present names; print on standard error which were former ones."""
    name, given = words[0], words[1:]
    if name == "robot" and not (given and given[0] in ("serve", "excite", "identify", "--help", "-h")):
        command: tuple[str, ...] = ("robot", "serve")
    else:
        command = COMMANDS.get(name, (name,))
    if command != (name,):
        _tell(name, " ".join(command))
    options = OPTIONS[""] | OPTIONS.get(name, {})
    if name == "train" and given[:1] != ["study"]:
        options |= {f"--{option}": "--set" for option in SET}
    if name in ("validate", "audit", "train"):
        given = _record_flag(given)
    if name in ("render", "plot"):
        given = _hidden(given)
    if name == "evaluate":
        given = _policies_first(given)
    positional, given = _renamed(given, options)
    defaults = [
        word
        for option, value in DEFAULTS.get(name, {}).items()
        if option not in given and not {"-h", "--help"} & {*given}
        for word in (option, value)
    ]
    return [*command, *positional, *given, *defaults]


def _tell(old: str, new: str) -> None:
    print_error(f"'{old}' is called '{new}' now; the old name goes away in 0.4")


def _renamed(given: list[str], options: dict[str, str]) -> tuple[list[str], list[str]]:
    """Return the values of options that are arguments now, and the other words with present names."""
    positional, others = list[str](), list[str]()
    for option, values in _parts(given):
        bare, equals, value = option.partition("=")
        negated = bare.removeprefix("--no-")
        new = options.get(bare, options.get(f"--{negated}") if bare.startswith("--no-") else None)
        if new is None:
            others += [option, *values] if option else values
            continue
        values = [value, *values] if equals else values
        _tell(bare, new or "an argument")
        if new == "":
            positional += values
        elif new == "--set":
            what = negated.removeprefix("--").replace("-", "_")
            said = ",".join(values) or ("false" if bare.startswith("--no-") else "true")
            others += ["--set", f"{what}={said}"]
        else:
            others += [new.replace("--", "--no-", 1) if bare.startswith("--no-") else new, *values]
    return positional, others


def _parts(given: list[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield each option with its values; first an empty name with the words before all options."""
    option, values = "", list[str]()
    for word in given:
        if word.startswith("--") and len(word) > 2:
            yield option, values
            option, values = word, []
        else:
            values.append(word)
    yield option, values


def _record_flag(given: list[str]) -> list[str]:
    """Return words in which --record, formerly a flag, has a value."""
    words = list[str]()
    for place, word in enumerate(given):
        words.append(word)
        alone = place + 1 == len(given) or given[place + 1].startswith("--")
        if word == "--record" and alone:
            _tell("--record", "--record trajectory")
            words.append("trajectory")
    return words


def _hidden(given: list[str]) -> list[str]:
    """Return words in which former flags are values of --hide."""
    words = list[str]()
    for word in given:
        flag = word.removeprefix("--no-").removeprefix("--")
        if flag not in HIDDEN or word == flag:
            words.append(word)
            continue
        _tell(word, f"--hide {flag}" if word.startswith("--no-") else "the default")
        words += ["--hide", flag] if word.startswith("--no-") else []
    return words


def _policies_first(given: list[str]) -> list[str]:
    """Return words in which the policies, formerly arguments, follow --policy."""
    (_, policies), *others = _parts(given)
    rest = [word for option, values in others for word in (option, *values)]
    return ["--policy", *policies, *rest] if policies else rest

"""What pages of the documentation tell a reader to do, in the order of the page."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
_BLOCK = re.compile(
    r"^```(?P<info>\{literalinclude\} (?P<file>\S+)|\w*)\n(?P<text>.*?)^```",
    re.DOTALL | re.MULTILINE,
)


@dataclass(frozen=True)
class Step:
    """One thing that a page tells its reader to do."""

    kind: str
    """``shell``, a command; ``python``, code to run; or ``save``, a file to save."""
    text: str
    """The command, the code, or the content of the file."""
    name: str = ""
    """Of the file."""


def steps_of(page: str) -> list[Step]:
    """Return what a page tells its reader to do."""
    steps: list[Step] = []
    path = ROOT / page
    for block in _BLOCK.finditer(path.read_text(encoding="utf-8")):
        if block["file"]:
            file = path.parent / block["file"]
            steps.append(Step("save", file.read_text(encoding="utf-8"), file.name))
        elif block["info"] == "sh":
            lines = re.sub(r"\s*\\\n\s*", " ", block["text"]).splitlines()
            steps += [Step("shell", line) for line in lines if line and not line.startswith("#")]
        elif block["info"] == "python":
            steps.append(Step("python", block["text"]))
    return steps


def words_of(step: Step) -> list[str]:
    """Return the words of a command."""
    return shlex.split(step.text, comments=True)

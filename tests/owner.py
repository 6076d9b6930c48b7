"""Another process that owns a folder, or is killed while it writes."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

_OWNS = """
import sys
from pathlib import Path
from craftsim.storage.folders import owned
with owned(Path(sys.argv[1])):
    print("owned", flush=True)
    sys.stdin.read()
"""
_WRITES = """
import sys, time
from craftsim.storage.writing import whole
with whole(sys.argv[1]) as partial:
    partial.write_text("half")
    print("writing", flush=True)
    sys.stdin.read()
"""


@contextlib.contextmanager
def _process(script: str, *words: object) -> Iterator[subprocess.Popen[str]]:
    """Start a script, and wait until it has said a line; it ends when its input does."""
    command = [sys.executable, "-c", script, *map(str, words)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        yield process


def owner(folder: Path) -> contextlib.AbstractContextManager[subprocess.Popen[str]]:
    """Let another process own a folder during the block."""
    return _process(_OWNS, folder)


def writer(path: Path) -> contextlib.AbstractContextManager[subprocess.Popen[str]]:
    """Let another process be in the middle of writing a file during the block."""
    return _process(_WRITES, path)


def kill(process: subprocess.Popen[str]) -> None:
    """End a process such that it cleans nothing up."""
    process.send_signal(signal.SIGKILL)
    process.wait()

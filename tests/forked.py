"""Processes without their second of imports: copies of one that has imported craftsim and loaded compiled code.

A command, a script, or a worker that a test starts here is a process of its own with a fresh state. What Python does
before the first import of ours (``-P``, ``NUMBA_DISABLE_JIT``) and how signals find a worker need a real start.
"""

from __future__ import annotations

import multiprocessing
import os
import runpy
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from multiprocessing import forkserver
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any, Final

from craftsim.compiled import code_cache
from craftsim.workers import actor

_SPAWNED: Final = actor._Process
_ENVIRONMENT: Final = dict(os.environ)


class _Worker(actor._Process):
    """A worker as the package starts them, with this process's environment."""

    def start(self) -> None:
        self._environment = dict(os.environ)
        super().start()

    def run(self) -> None:
        _set_environment(self._environment)
        super().run()

    @staticmethod
    def _Popen(process: Any) -> Any:
        ensure_running()
        return ForkServerProcess._Popen(process)


def _set_environment(environment: dict[str, str]) -> None:
    os.environ.clear()
    os.environ.update(environment)
    code_cache.folder.cache_clear()


def ensure_running() -> None:
    """Start the process that is copied, with the environment of the tests and not that of one of them."""
    if forkserver._forkserver._forkserver_address is None:
        now = dict(os.environ)
        path = os.pathsep.join(
            filter(None, [str(Path(__file__).parent), _ENVIRONMENT.get("PYTHONPATH")])
        )
        _set_environment(_ENVIRONMENT | {"PYTHONPATH": path})
        try:
            forkserver._forkserver.ensure_running()
        finally:
            _set_environment(now)


def _context() -> Any:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["warm"])
    return context


def workers(forked: bool) -> None:
    """Let the package's workers start as copies from now on, or as they do outside of the tests."""
    if forked:
        _context()
    actor._Context.Process = _Worker if forked else _SPAWNED


def stop() -> None:
    """End the process that is copied, if this one has started it."""
    workers(False)
    forkserver._forkserver._stop()


def shared() -> dict[str, Any]:
    """Start the process that is copied, and return what others need to have copies of it, too."""
    _context()
    ensure_running()
    names = ("_forkserver_address", "_forkserver_authkey")  # the second from Python 3.14 on
    return {name: value for name in names if (value := getattr(forkserver._forkserver, name, None))}


def share(server: dict[str, Any]) -> None:
    """Have copies of the process that another one has started, as :func:`shared` returns it."""
    vars(forkserver._forkserver).update(server, ensure_running=lambda: None)
    if forkserver._forkserver._forkserver_alive_fd is None:
        # Each copy is sent the pipe whose end ends the process that is copied: here, nothing does.
        forkserver._forkserver._forkserver_alive_fd = os.open(os.devnull, os.O_RDONLY)


def _perform(
    server: dict[str, Any],
    words: Sequence[str],
    folder: str,
    environment: dict[str, str],
    out: str,
    err: str,
) -> None:
    _set_environment(environment)
    os.chdir(folder)
    share(server)
    workers(True)
    for number, path in ((1, out), (2, err)):
        file = os.open(path, os.O_WRONLY)
        os.dup2(file, number)
        os.close(file)
    sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.path[:0] = [path for path in environment.get("PYTHONPATH", "").split(os.pathsep) if path]
    if words[0] == "craftsim":
        from craftsim.cli import main

        sys.argv = list(words)
        raise SystemExit(main(words[1:]))
    sys.argv = list(words)
    sys.path.insert(0, str(Path(words[0]).resolve().parent))
    runpy.run_path(words[0], run_name="__main__")


def start(
    *words: object, cwd: Path | str = ".", out: str = os.devnull, err: str = os.devnull
) -> ForkServerProcess:
    """Start ``craftsim`` with options, or a script, whose output goes to files that are there."""
    context = _context()
    arguments = (shared(), [*map(str, words)], str(Path(cwd).resolve()), dict(os.environ), out, err)
    process = context.Process(target=_perform, args=arguments)
    process.start()
    return process


def run(*words: object, cwd: Path | str = ".") -> subprocess.CompletedProcess[str]:
    """Run it as subprocess.run does, with its output as text."""
    with tempfile.NamedTemporaryFile("r") as out, tempfile.NamedTemporaryFile("r") as err:
        process = start(*words, cwd=cwd, out=out.name, err=err.name)
        process.join()
        return subprocess.CompletedProcess(words, process.exitcode, out.read(), err.read())

"""Worlds in processes of this machine: each holds some of them, and performs what it is asked for one by one."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterable, Mapping, Sequence
from multiprocessing.connection import Connection, wait
from queue import SimpleQueue
from typing import Any

from gymnasium.vector.utils import CloudpickleWrapper

from craftsim.envs.world_requests import Answer, Make, Request, perform
from craftsim.errors import CraftsimError
from craftsim.processes import spawn_context


def _serve(requests: Connection, answers: Connection, make: Make, worlds: Sequence[int]) -> None:
    """Perform what is asked for, in a process, until the one that asks has gone or says that it is enough."""
    asked: SimpleQueue[Mapping[int, Request] | None] = SimpleQueue()

    def listen() -> None:
        # In a thread of its own, so that nobody waits to be heard, and a process left alone ends in mid-step.
        while True:
            try:
                asked.put(requests.recv())
            except (EOFError, OSError):
                os._exit(1)

    threading.Thread(target=listen, daemon=True).start()
    envs = {world: make() for world in worlds}
    while (batch := asked.get()) is not None:
        for world, request in batch.items():
            answers.send((world, perform(envs[world], request)))
    for env in envs.values():
        env.close()


class WorldProcesses:
    """Worlds in spawned processes; see :class:`~craftsim.envs.world_requests.WorldHolder`."""

    def __init__(self, make: Make, n_worlds: int, workers: int) -> None:
        """Start the processes; they go on starting while this returns.

        Args:
            make: makes a world; anything that cloudpickle takes.
            n_worlds: how many worlds there are.
            workers: how many processes share them, at most one a world.
        """
        self.workers = workers
        context, sent = spawn_context(), CloudpickleWrapper(make)
        self._workers = [_Worker(context, sent, range(i, n_worlds, workers)) for i in range(workers)]
        self._answers: dict[int, Answer] = {}

    @property
    def pids(self) -> list[int]:
        """Numbers of the processes."""
        return [worker.process.pid or 0 for worker in self._workers]

    def ask(self, requests: Mapping[int, Request]) -> None:
        """Ask worlds for something each."""
        for number, worker in enumerate(self._workers):
            own = {
                world: request for world, request in requests.items() if world % len(self._workers) == number
            }
            if own:
                worker.ask(own)

    def gather(self, at_least: int) -> dict[int, Answer]:
        """Return the answers that are there, and wait for so many."""
        while len(self._answers) < at_least and self._collect(None):
            pass
        while self._collect(0.0):
            pass
        taken, self._answers = self._answers, {}
        return dict(sorted(taken.items()))

    def _collect(self, timeout_s: float | None) -> bool:
        """Take one answer of each process that has one; return whether there was any."""
        by_connection = {worker.answers: worker for worker in self._workers if worker.due}
        if not by_connection:
            return False
        ready = wait(list(by_connection), timeout_s)
        self._answers.update(by_connection[connection].answer() for connection in ready)
        return bool(ready)

    def close(self) -> None:
        """End all processes."""
        for worker in self._workers:
            worker.end()
        for worker in self._workers:
            worker.join()


class _Worker:
    """A process as it looks from here."""

    def __init__(self, context: Any, make: Any, worlds: Iterable[int]) -> None:
        self.worlds = tuple(worlds)
        self.due: set[int] = set()
        """Worlds that were asked for something and have not answered."""
        there_requests, self._requests = context.Pipe(duplex=False)
        self.answers, there_answers = context.Pipe(duplex=False)
        arguments = (there_requests, there_answers, make, self.worlds)
        self.process = context.Process(target=_serve, args=arguments, daemon=True, name="craftsim-worlds")
        self.process.start()
        # With this end closed here, the death of the process is the end of the file.
        there_requests.close()
        there_answers.close()

    def ask(self, requests: Mapping[int, Request]) -> None:
        try:
            self._requests.send(requests)
        except OSError as error:
            raise self._dead() from error
        self.due.update(requests)

    def answer(self) -> tuple[int, Answer]:
        try:
            world, answer = self.answers.recv()
        except (EOFError, OSError) as error:
            raise self._dead() from error
        self.due.remove(world)
        return world, answer

    def _dead(self) -> CraftsimError:
        self.process.join(5.0)
        status = self.process.exitcode
        if status is not None and status < 0:
            why = f"was killed by signal {-status} ({signal.Signals(-status).name}), as for want of memory"
        else:
            why = (
                f"ended by itself with status {status}; what it printed says why. A program that makes such worlds "
                "must do so below \"if __name__ == '__main__':\""
            )
        worlds = ", ".join(map(str, self.worlds[:8])) + (", ..." if len(self.worlds) > 8 else "")
        return CraftsimError(f"the process that holds the worlds {worlds} {why}; make the environment anew")

    def end(self) -> None:
        if self.due:
            self.process.kill()
        else:
            with contextlib.suppress(OSError):  # it may have ended before
                self._requests.send(None)

    def join(self) -> None:
        self.process.join(10.0)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self._requests.close()
        self.answers.close()
        self.process.close()

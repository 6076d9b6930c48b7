"""What belongs to a process or to one thread at a time says so where another one uses it."""

import os
import socket
import threading

import numpy as np
import pytest

import craftsim
from craftsim.errors import CraftsimError
from craftsim.robots.sockets import Line
from craftsim.workers.actor import Actor


def _echo():
    return lambda request: request


def _in_a_forked_process(do) -> str:
    """Return what a function returns in a forked process, which must end in time; or the error that it raises."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            answer = do()
        except CraftsimError as error:
            answer = str(error)
        except BaseException as error:
            answer = repr(error)
        os.write(writing, answer.encode())
        os._exit(0)
    os.close(writing)
    watch = threading.Timer(60, os.kill, (child, 9))
    watch.start()
    with os.fdopen(reading, "rb") as pipe:
        answer = pipe.read()
    os.waitpid(child, 0)
    watch.cancel()
    return answer.decode()


def test_workers_answer_the_process_that_started_them_alone():
    actor = Actor(_echo)
    try:
        actor.send(1)
        assert actor.recv() == 1
        for use in (lambda: actor.send(2), actor.recv):
            answer = _in_a_forked_process(use)
            assert answer.startswith("Actor objects work only in the process that made them")
            assert answer.endswith("start another one")
        assert _in_a_forked_process(lambda: str(actor.kill())) == "None"
        actor.send(3)
        assert actor.recv() == 3
    finally:
        actor.kill()


def test_a_batch_in_physics_is_that_of_the_process_that_made_it():
    envs = craftsim.vector_env("strip", 1, "physics")
    stops = np.full((1, 2), int(craftsim.Action.STOP))
    try:
        envs.reset(seed=0)
        assert "work only in the process that made them" in _in_a_forked_process(
            lambda: str(envs.step(stops))
        )
        assert _in_a_forked_process(lambda: str(envs.close())) == "None"
        envs.step(stops)
    finally:
        envs.close()


def test_a_connection_is_that_of_the_process_that_opened_it():
    ours, theirs = _connected()
    line = Line(ours)
    try:
        for use in (lambda: line.send(b"word"), line.read):
            assert "work only in the process that made them" in _in_a_forked_process(use)
        assert _in_a_forked_process(lambda: str(line.close())) == "None"
        line.send(b"word")
        assert theirs.recv(100).endswith(b"word")
    finally:
        line.close()
        theirs.close()


def _connected() -> tuple[socket.socket, socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        ours = socket.create_connection(server.getsockname())
        theirs, _ = server.accept()
    return ours, theirs


def test_a_viewed_environment_is_viewed_in_its_process_alone():
    pytest.importorskip("viser")
    env = craftsim.parallel_env("strip")
    with craftsim.view(env, port=0):
        env.reset(seed=0)
        acts = dict.fromkeys(env.agents, int(craftsim.Action.STOP))
        assert "LiveView objects work only in the process" in _in_a_forked_process(
            lambda: str(env.step(acts))
        )
        assert _in_a_forked_process(lambda: str(env.close())) == "None"
        env.step(acts)


def test_a_world_is_advanced_by_one_thread_at_a_time():
    physics = craftsim.PhysicsWorld(craftsim.Grid.empty((3, 1, 1), n_cars=1))
    errors = []

    def advance_too():
        thread = threading.Thread(target=try_to)
        thread.start()
        thread.join()

    def try_to():
        try:
            physics.advance()
        except CraftsimError as error:
            errors.append(str(error))

    before_s = physics.time_s
    physics.advance(advance_too)
    assert len(errors) == physics.config.steps_per_period
    assert all("one thread at a time" in error for error in errors)
    assert physics.time_s == pytest.approx(before_s + physics.config.control_period_s)
    physics.advance()


def test_a_forked_process_goes_on_with_a_world_as_its_parent_does():
    physics = craftsim.PhysicsWorld(craftsim.Grid.empty((3, 1, 1), n_cars=1))

    def go_on() -> str:
        physics.drive(0, [5, 5, 5, 5])
        for _ in range(10):
            physics.advance()
        return physics.data.qpos.tobytes().hex()

    assert _in_a_forked_process(go_on) == go_on()

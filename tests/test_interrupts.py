"""Ctrl-C, SIGTERM and SIGHUP interrupt the process that a person started, and it alone; not where they are ignored."""

import ctypes
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import craftsim
from craftsim import cli
from craftsim.cli import films
from craftsim.planning import planner
from craftsim.robots.server import Server, Service
from craftsim.workers import interrupts
from craftsim.workers.actor import spawn_context
from craftsim.workers.interrupts import INTERRUPT_SIGNALS, defer_interrupts, interruptible
from craftsim.workers.pool import Pool

pytestmark = pytest.mark.usefixtures("spawned")


def test_a_process_that_still_imports_hears_of_no_interrupt_and_whoever_starts_it_hears_as_before():
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    process = spawn_context().Process(target=time.sleep, args=(0.0,))
    process.start()
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before
    os.kill(process.pid, signal.SIGINT)
    process.join()
    assert process.exitcode == 0


def test_workers_hear_of_no_interrupt():
    with Pool(1) as pool:
        heard = list(pool.map_unordered(signal.raise_signal, INTERRUPT_SIGNALS))
    assert heard == [(number, None) for number in INTERRUPT_SIGNALS]


def test_a_program_that_a_worker_starts_hears_of_signals():
    with Pool(1) as pool:
        ((_, status),) = pool.map_unordered(_status_of_terminated, [["sleep", "60"]])
    assert status == -signal.SIGTERM


def _status_of_terminated(words):
    process = subprocess.Popen(words)
    process.terminate()
    return process.wait()


def test_where_an_interrupt_is_ignored_work_goes_on():
    usual = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with defer_interrupts():
            signal.raise_signal(signal.SIGINT)
            assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, usual)


def test_what_is_under_way_ends_before_an_interrupt_is_heard():
    done = []

    def interrupted():
        with defer_interrupts():
            signal.raise_signal(signal.SIGINT)
            done.append(1)

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert done


@pytest.mark.parametrize("number", INTERRUPT_SIGNALS)
def test_every_signal_that_ends_a_process_interrupts_a_command(number, monkeypatch, capsys):
    before = [signal.getsignal(each) for each in INTERRUPT_SIGNALS]

    def run(words):
        os.kill(os.getpid(), number)
        time.sleep(10)

    monkeypatch.setattr(cli, "_run", run)
    assert cli.main(["plan", "strip"]) == 130
    assert capsys.readouterr().err == "craftsim: interrupted\n"
    assert [signal.getsignal(each) for each in INTERRUPT_SIGNALS] == before


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_what_is_ignored_from_the_start_stays_ignored_and_a_handler_of_a_program_stays(number):
    for handler in (signal.SIG_IGN, lambda *_: None):
        usual = signal.signal(number, handler)
        try:
            with interruptible(), defer_interrupts():
                signal.raise_signal(number)
                assert signal.getsignal(number) == handler
        finally:
            signal.signal(number, usual)


def test_a_signal_that_comes_twice_at_once_is_one_interrupt(monkeypatch):
    finished = []

    def terminated(step, *numbers):
        with defer_interrupts():
            for number in numbers:
                signal.raise_signal(number)
            finished.append(step)

    with interruptible():
        with pytest.raises(KeyboardInterrupt):
            terminated(1, signal.SIGTERM, signal.SIGHUP)
        signal.raise_signal(signal.SIGTERM)
        finished.append(2)
        monkeypatch.setattr(interrupts, "_SAME_S", 0.0)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            terminated(3, signal.SIGTERM, signal.SIGTERM)
    assert finished == [1, 2]


_LEAVE_A_WORKER = """
from craftsim.workers.actor import Actor
actor = Actor(lambda: (lambda request: request))
actor.send(1)
actor.recv()
print(actor.pid, flush=True)
"""


def test_workers_that_are_left_end_with_python_though_they_ignore_its_signal(tmp_path):
    script = tmp_path / "leave.py"
    script.write_text(_LEAVE_A_WORKER)
    started = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, timeout=60, check=True
    )
    with pytest.raises(ProcessLookupError):
        os.kill(int(started.stdout), 0)


def test_an_interrupted_plan_is_kept_whenever_the_signal_comes(tmp_path, monkeypatch, capsys):
    search, attempt = planner._Search, planner._Search._attempt

    def interrupted(self, number):
        if number == 3:
            os.kill(os.getpid(), signal.SIGTERM)
        attempt(self, number)

    monkeypatch.setattr(search, "_attempt", interrupted)
    words = ["plan", "simple_two_story", "--attempts", "100000", "--time-limit", "600", "--out"]
    assert cli.main([*words, str(tmp_path / "searching")]) == 0
    files = {path.name for path in (tmp_path / "searching").iterdir()}
    assert {"simple_two_story.plan", "report.json", "simple_two_story-gantt.svg"} <= files
    capsys.readouterr()

    monkeypatch.setattr(search, "_attempt", attempt)
    monkeypatch.setattr(films, "draw_plan", lambda *_: os.kill(os.getpid(), signal.SIGTERM))
    words = ["plan", "simple_two_story", "--attempts", "5", "--out"]
    assert cli.main([*words, str(tmp_path / "drawing")]) == 130
    assert craftsim.read_plan(tmp_path / "drawing" / "simple_two_story.plan", 2).ticks


def test_a_plan_that_is_found_is_written_at_once(tmp_path, monkeypatch):
    written = []

    def stopped(self, number):
        written.extend(path.name for path in tmp_path.glob("*.plan"))
        return attempt(self, number) if number < 3 else pytest.fail("enough", pytrace=False)

    attempt = planner._Search._attempt
    monkeypatch.setattr(planner._Search, "_attempt", stopped)
    with pytest.raises(pytest.fail.Exception, match="enough"):
        cli.main(["plan", "simple_two_story", "--out", str(tmp_path)])
    assert written


def test_a_server_of_robots_writes_its_report_when_it_is_terminated(tmp_path, monkeypatch):
    step = Service.step

    def terminated(self):
        os.kill(os.getpid(), signal.SIGTERM)
        step(self)

    monkeypatch.setattr(Server, "run", lambda self, ended: terminated(self._service))
    assert cli.main(["robot", "serve", "strip", "--port", "0", "--out", str(tmp_path)]) == 0
    assert json.loads((tmp_path / "report.json").read_text())["command"] == "robot"


@pytest.mark.parametrize(
    "code",
    [
        "import craftsim.audit.swept",
        "from craftsim.designs.meshes import read_triangles; read_triangles(pathlib.Path('solid.ply'))",
        "from craftsim.designs.meshes import read_triangles; read_triangles(pathlib.Path('solid.glb'))",
        "from craftsim.models.exporting import _angles; _angles([1.0, 0.0, 0.0, 0.0])",
        "from craftsim.rendering.viewer.scene import shapes_of; shapes_of(None)",
        "from craftsim.rendering.viewer.scene import floor_mesh; floor_mesh((1, 1, 1))",
    ],
)
def test_an_interrupt_while_trimesh_is_imported_is_heard(code, tmp_path):
    """Trimesh takes it for the absence of networkx."""
    for name in ("solid.ply", "solid.glb"):
        (tmp_path / name).write_text("none")
    program = f"""
import pathlib, signal, sys
from craftsim.workers.interrupts import interruptible

def interrupt(event, arguments):
    if event == "import" and arguments[0] == "networkx":
        signal.raise_signal(signal.SIGTERM)

sys.addaudithook(interrupt)
try:
    with interruptible():
        {code}
except KeyboardInterrupt:
    print("heard")
"""
    child = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert child.stdout == "heard\n", child.stderr


def test_who_presses_ctrl_c_again_and_again_interrupts_twice(monkeypatch):
    monkeypatch.setattr(interrupts.time, "monotonic", iter([10.0, 10.4, 10.8]).__next__)
    interrupt = interrupts._Interrupt()
    assert [interrupt.is_new_request() for _ in range(3)] == [True, False, True]


class _Finalized:
    def __del__(self):
        signal.raise_signal(signal.SIGTERM)


@pytest.mark.parametrize(
    "ignoring", [ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGTERM)), _Finalized]
)
def test_an_interrupt_where_python_ignores_exceptions_is_heard(ignoring, capsys):
    """Such as in the callbacks of numba's compiler, and in finalizers."""
    hook = sys.unraisablehook

    def interrupted():
        with interruptible():
            ignoring()
            for _ in range(200):
                time.sleep(0.05)

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert sys.unraisablehook == hook
    assert capsys.readouterr().err == ""


def test_an_interrupt_while_something_plans_interrupts_it_and_what_it_belongs_to(monkeypatch):
    """As in an episode of a policy that plans at its start; the search took it for the wish to stop there."""
    attempt = planner._Search._attempt

    def interrupted(self, number):
        if number == 3:
            os.kill(os.getpid(), signal.SIGTERM)
        attempt(self, number)

    monkeypatch.setattr(planner._Search, "_attempt", interrupted)
    task = craftsim.make_task("simple_two_story")
    with interruptible(), pytest.raises(KeyboardInterrupt):
        craftsim.plan(task.draw(np.random.default_rng(0)), task, rounds=100)


def test_a_search_ends_with_the_plan_that_its_caller_finds_good_enough():
    told = []

    def report(number, best):
        told.append(number)
        return number == 3

    task = craftsim.make_task("simple_two_story")
    planned = craftsim.plan(
        task.draw(np.random.default_rng(0)), task, rounds=100, exact=False, report=report
    )
    assert planned.ticks
    assert told == [1, 2, 3]


def test_an_interrupt_in_text_that_an_extension_module_runs_ends_with_status_130(tmp_path):
    """As while MuJoCo's bindings are imported: Python took it for unhandled and killed the process by SIGINT."""
    program = """
import ctypes, sys
from craftsim import cli

def run(words):
    call = ctypes.pythonapi.PyRun_String
    call.restype, call.argtypes = ctypes.py_object, [ctypes.c_char_p, ctypes.c_int] + [ctypes.py_object] * 2
    call(b"raise KeyboardInterrupt", 257, {"__builtins__": __builtins__}, {})

cli._run = run
sys.exit(cli.main(["doctor"]))
"""
    (tmp_path / "program.py").write_text(program)
    words = [sys.executable, "-m", "program"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stderr == "craftsim: interrupted\n"
    assert done.returncode == cli.INTERRUPTED


_COMMANDS = (
    "design random --out out",
    "show complex_two_story --plan complex_two_story --out out",
    "render strip --out out/film.mp4",
    "demo strip --out out",
    "validate random --trials 1000 --video none --out out",
    "robot excite --out out",
)
"""Of each kind of command one that is at work for some seconds."""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("words", _COMMANDS)
def test_a_process_that_is_asked_to_end_leaves_nothing_half_written_and_no_process(
    words, number, tmp_path
):
    process = subprocess.Popen(
        [sys.executable, "-m", "craftsim", *words.split()],
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    # Python itself takes some tenths of a second until the command hears signals.
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(1.5)
    process.send_signal(number)
    _, error = process.communicate(timeout=60)
    assert process.returncode == cli.INTERRUPTED
    assert error == "craftsim: interrupted\n"
    assert not list(tmp_path.rglob(".partial-*"))
    # Processes of Python's own, such as the tracker of its resources, end a moment later.
    end_s = time.monotonic() + 10
    while _has_group(process.pid) and time.monotonic() < end_s:
        time.sleep(0.05)
    assert not _has_group(process.pid)


def _has_group(number):
    try:
        os.killpg(number, 0)
    except ProcessLookupError:
        return False
    return True

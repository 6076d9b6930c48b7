"""Workers run a user's program again only for its skills, actions and tasks, and say what to do if they cannot."""

import os
import subprocess
import sys

VALIDATE = """
import craftsim

print("begun")
STOP = int(craftsim.Action.STOP)

def chosen(observations):
    {uses}
    return dict.fromkeys(observations, STOP)

result = craftsim.validate("strip", policy=chosen, drive="wheels", max_steps=2, trials=2, workers=2, out="out")
print(result.agrees, [record["error"] for record in result.records])
"""
REGISTERS = """
import os
from dataclasses import replace
from pathlib import Path

import craftsim
from craftsim.tasks.registry import as_task
from craftsim.experiments.experiment import Experiment, Result, RunOptions, Trial
from craftsim.experiments.session import run_experiment
from craftsim.skills.library import own_skills, performers

class Lift(craftsim.Skill):
    time_limit_s = 7.0
    def start(self, now): pass
    def step(self, now): self.succeed()

print("begun")
ACTION = craftsim.register_action("WAIT", lambda grid, car: None, lambda grid, car: None, duration_s=1.0)
craftsim.register_task(replace(craftsim.make_task("strip"), name="mine"))

def work(job):
    action, skills = job
    (known,) = performers(skills, 1)
    as_task("mine")
    return Result(craftsim.Action["WAIT"] is action and known[craftsim.Action.LIFT].time_limit_s == 7.0)

{guard}:
    items = [Trial("one", "all", 0, (ACTION, own_skills({{craftsim.Action.LIFT: Lift}})))]
    records = run_experiment(Experiment("mine", 0, {{}}, items, work), Path(str(os.getpid())), RunOptions())
    print([(record["agrees"], record["error"]) for record in records])
"""


def _run(folder, text):
    (folder / "program.py").write_text(text)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    words = [sys.executable, "program.py"]
    done = subprocess.run(
        words, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    return done.stdout.splitlines(), done.stderr.splitlines()


def test_a_program_that_registers_nothing_needs_no_guard(tmp_path):
    assert _run(tmp_path, VALIDATE.format(uses="")) == (["begun", "True [None, None]"], [])


def test_what_a_function_uses_and_cannot_be_sent_is_named(tmp_path):
    text = "import threading\nLOCK = threading.Lock()\n" + VALIDATE.format(uses="LOCK")
    printed, said = _run(tmp_path, text)
    assert printed == ["begun"]
    assert "InputError: a worker process cannot be sent this: " in said[-1]


def test_what_is_cached_in_a_program_is_no_error_of_pickle(tmp_path):
    text = "import functools\n@functools.cache\ndef first():\n    return 0\n" + VALIDATE.format(
        uses="first()"
    )
    printed, said = _run(tmp_path, text)
    assert printed == ["begun"]
    assert (
        "InputError: a worker process has not what it was sent: Can't get attribute 'first'"
        in said[-1]
    )
    assert said[-1].endswith("put such functions into a module, which is imported")


def test_workers_know_what_a_guarded_program_registers_and_its_skills(tmp_path):
    found = _run(tmp_path, REGISTERS.format(guard='if __name__ == "__main__"'))
    assert found == (["begun", "begun", "[(True, None)]"], [])


def test_without_a_guard_it_is_told_what_to_do(tmp_path):
    printed, said = _run(tmp_path, REGISTERS.format(guard="if True"))
    assert printed == ["begun", "begun"]
    assert said[-1].startswith(
        f"craftsim.errors.InputError: {tmp_path / 'program.py'}: worker processes import it"
    )
    assert said[-1].endswith("all else must stand below \"if __name__ == '__main__':\"")
    assert "could not: RuntimeError: An attempt has been made to start a new process" in said[-1]

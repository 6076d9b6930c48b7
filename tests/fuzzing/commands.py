"""Every path and name that a command takes, in hostile forms: each ends in exit status 0, 1 or 2, without a traceback.

Each case runs in this process. ``python -m fuzzing.fuzz --commands`` tries all of them, the tests some.
"""

from __future__ import annotations

import contextlib
import faulthandler
import io
import os
import re
import shlex
import signal
import tempfile
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np

from craftsim.cli import main

ENOUGH_S = 10.0
"""Of processor time, after which a case is interrupted: what was accepted may ask for long work."""
HANGS_S = 300.0
"""After which the process of a case that waits for something is ended, with a traceback of where it hangs."""

PHYSICS = (
    "--randomize @.yaml",
    "--noise @.yaml",
    "--assume @.yaml",
    "--gains @.yaml",
    "--machines @.yaml",
)
_ENDING = {
    "demo": "demo --task gone.yaml",
    "validate": "validate strip --baseline gone",
    "build": "validate --plan auto strip --baseline gone",
    "audit": "audit --quick --baseline gone",
    "margins": "audit margins --baseline gone",
    "tune": "tune --weights gone=1",
    "render": "render gone.yaml --out film.png",
    "robot": "robot serve --task gone.yaml",
}
"""Commands that take physics, with something that ends them once its files are read."""

SLOTS = (
    *(f"{words} {option}" for words in _ENDING.values() for option in PHYSICS),
    *(f"{words} --out @" for words in _ENDING.values() if "--out" not in words),
    *("demo --task @", "demo --task @.yaml --no-video", "demo --plan @.plan", "demo --goal @.yaml"),
    *("demo --robot @",),
    *("validate @.yaml --baseline gone", "validate @ --baseline gone"),
    *("validate strip --plan @.plan --baseline gone",),
    *("validate strip --actions @.txt --baseline gone", "validate strip --policy @.safetensors --baseline gone"),
    *("validate strip --policy @ --baseline gone", "validate strip --baseline @"),
    *("validate --baseline @{session.db}",),
    *("plan @.yaml --time-limit 1", "plan @ --time-limit 1"),
    *("plan strip --goal @.yaml --time-limit 1", "plan gone --out @", "plan strip --goal gone.yaml --pddl @"),
    *("validate --plan auto @.yaml --baseline gone", "validate --plan auto strip --goal @.yaml --baseline gone"),
    *("validate --plan auto strip --baseline @",),
    *("audit --situations @", "audit --quick --baseline @", "audit --quick --baseline @{session.db}"),
    *("audit --learn @ --machines gone.yaml", "audit --learn @.yaml --machines gone.yaml"),
    *("tune --weights @", "audit margins @", "audit margins --situations @"),
    *("audit margins --map @ @", "audit margins --baseline @"),
    *("audit margins --baseline @{session.db}",),
    *("compare @ @", "compare @{session.db} gone", "compare @{trials.jsonl} gone", "compare gone gone --out @"),
    *("audit clearance --machines @.yaml --out /dev/null/x", "audit clearance --out @ --machines gone.yaml"),
    *("replay @", "replay @{bundle.json}", "replay --minimize @{bundle.json}", "replay gone --out @"),
    *("render @.npz --out film.png", "render @ --out film.png", "render @{bundle.json} --out film.png"),
    *("render @{trajectories/a.npz} --out film.png", "render gone.npz --out @.png", "render gone.npz --out @"),
    *("render gone.npz --camera @", "render gone.npz --size @", "render . --title @ --out film.png"),
    *("render strip --plan @.plan --out film.png --gains gone.yaml", "render gone.npz --title @"),
    *("render strip --policy @.safetensors --out film.png --gains gone.yaml",),
    *("render gone.npz --beside @.npz --out film.png", "render @.npz f/", "render @ f/", "render @{bundle.json} f/"),
    *("render @{trajectories/a.npz} f/"),
    *("validate --config @.yaml --baseline gone", "audit --config @ --baseline gone"),
    *("design --config @.yaml", "train --config @.yaml --task gone"),
    *("view @.npz", "view @.yaml --host 256.1.1.1", "view @ --host 256.1.1.1", "view gone.npz --host @"),
    *("robot excite --out @ --gains gone.yaml", *(f"robot excite --seed 1 {option}" for option in PHYSICS)),
    *("robot identify @.csv", "robot identify @.mcap"),
    *("robot identify @", "robot identify gone.csv --held-out @.csv"),
    *("robot identify run.mcap --topics @.yaml", "robot identify gone.csv --machines @.yaml"),
    *("robot identify gone.csv --out @",),
    *("robot serve --task @ --host 256.1.1.1", "robot serve --task @.yaml --host 256.1.1.1", "robot serve --host @"),
    *("robot serve --task strip --key @ --host 256.1.1.1", "demo strip --robot 127.0.0.1:1 --key @"),
    *("train --task @.yaml --settings gone.yaml", "train --task @ --settings gone.yaml"),
    *("train --settings gone.yaml --out @", "train --settings @.yaml --task gone"),
    *("train --pretrained @ --settings gone.yaml", "train --stages @ --settings gone.yaml"),
    *("train --starts @.npz --settings gone.yaml", "train --backend physics --randomize @"),
    *("train --out @ --task gone",),
    *("train study @.yaml", "train study @", "train study gone --out @"),
    *("validate --backend grid --policy @.safetensors", "validate --backend grid --policy @"),
    *("validate @ --backend grid --policy gone",),
    *("conformance @.jsonl.gz", "conformance @", "conformance gone --out @"),
    *("machine check @.yaml", "machine check @", "machine check gone.yaml --out @", "machine new @"),
    *("machine new @ --from @.xml --mapping gone.yaml", "machine new gone.yaml --from @.xml --mapping @.yaml"),
    *("reality @.npz", "reality @.csv", "reality @", "reality gone.npz --machines @.yaml", "reality gone --out @"),
    *("bench @ --out out", "bench gone --out @"),
    *("design @.png", "design @.stl", "design @.obj", "design @", "design letters --text @", "design gone --out @"),
    *("show @.yaml", "show @", "show strip --goal @.yaml", "show strip --plan @.plan", "show gone --out @"),
    *("show wall --export @", "show wall --export @.urdf"),
    *("doctor --out @",),
)  # fmt: skip
"""Words of commands with an ``@`` where the hostile thing stands: with the ending that its file should have, and in
braces the name of the file that a folder should hold."""


def _archive(path: Path) -> None:
    with path.open("wb") as file:
        np.savez(file, a=np.zeros(3))


FORMS: dict[str, bytes | Callable[[Path], object]] = {
    "missing": lambda path: None,
    "folder": lambda path: path.mkdir(),
    "pipe": lambda path: os.mkfifo(path),
    "device": lambda path: path.symlink_to("/dev/zero"),
    "loop": lambda path: path.symlink_to(path.name),
    "dangling": lambda path: path.symlink_to("nowhere"),
    "below a file": lambda path: path.parent.rmdir() or path.parent.touch(),
    "empty": b"",
    "noise": np.random.default_rng(0).bytes(5000),
    "not text": b"start: \xff\xfe strip\n",
    "byte order mark": b"\xef\xbb\xbfstart: strip\n",
    "other byte order": "start: strip\n".encode("utf-16"),
    "zeros": bytes(5000),
    "sparse": lambda path: path.touch() or os.truncate(path, 2**40),
    "archive": _archive,
    "json": b'{"a": [1, 2, {"b": null}]}',
    "deep json": b"[" * 10_000,
    "numbers": b"1,2,3\n4,5\n",
    "picture": b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\xff\xff\xff\xff\xff\xff\xff\xff\x08\x06\0\0\0",
    "packed": b"\x1f\x8b\x08\0\0\0\0\0\0\xff" + b"x" * 50,
    "bag": b"\x89MCAP0\r\n" + b"\xff" * 100,
    "deep": b"start: " + b"[" * 5000,
    "anchors": b"a: &a [1, 1]\nstart: [*a, *a]\n",
    "tag": b"start: !!python/object/apply:os.getcwd []\n",
    "twice": b"start: strip\nstart: strip\n",
    "not finite": b"start: .nan\narea_length: .inf\ndrive: {max_speed: .inf}\nsteps: .nan\n",
    "texts for numbers": b"area_length: '3'\ndrive: {max_speed: yes}\nsteps: true\nposition_m: [1]\n",
    "a list": b"- 1\n- [a]\n",
    "a word": b"strip",
}
"""What stands at the path: its content, or what makes it."""
NAMES: dict[str, str] = {
    "long": "x" * 300,
    "deep": "x/" * 3000,
    "control": "a\x1b[31m\n\r\x07",
    "no text": "caf\udce9",
    "turned": "a\u202eb",
    "null": "a\0b",
    "up": "../" * 5 + "gone",
    "slash": "gone/",
    "dots": "..",
    "nothing": "",
    "space": " ",
    "home": "~root",
    "colon": "a:b:c",
    "code": "own.code:make",
    "pattern": "[!*",
    "address": "http://127.0.0.1/x",
    "number": "9" * 5000,
    "formatting": "{0.__class__} %s %(x)s",
}
"""Words for something that is not there."""
SAME = "//"
"""After the name of what is there, as of a folder."""


@dataclass(frozen=True)
class Case:
    """One command with one hostile thing."""

    slot: str
    form: str

    def run(self, folder: Path) -> str:
        """Run it; return what is wrong about its end, if anything."""
        words = [
            f"{word[: word.index('@')]}{self._word(word[word.index('@') :], folder)}"
            if "@" in word
            else word
            for word in shlex.split(self.slot)
        ]
        screen = io.StringIO()
        with (
            contextlib.redirect_stdout(screen),
            contextlib.redirect_stderr(screen),
            contextlib.chdir(folder),
        ):
            try:
                with _interrupted():
                    status: object = main(words)
            except SystemExit as error:  # a usage error
                status = error.code
            except BaseException:
                return f"{self}:\n{traceback.format_exc(limit=-6)}"
        if status not in (0, 1, 2, 130) or "Traceback" in screen.getvalue():
            return f"{self}: exit status {status}: {screen.getvalue()[-2000:]}"
        return ""

    def _word(self, word: str, folder: Path) -> str:
        found = re.fullmatch(r"@([.\w]*)(?:\{(.+)\})?", word)
        assert found is not None, word
        ending, inner = found[1], found[2]
        if self.form.startswith("name "):
            return NAMES[self.form[5:]] + ending
        outer = folder / f"hostile{ending}"
        name = self.form.removesuffix(SAME)
        path = outer / inner if inner else outer / "x" if name == "below a file" else outer
        if not os.path.lexists(outer):  # or once more the same
            if path.parent != folder:
                path.parent.mkdir(parents=True)
            made = FORMS[name]
            path.write_bytes(made) if isinstance(made, bytes) else made(path)
        place = path if name == "below a file" and not inner else outer
        return f"{place.relative_to(folder)}{'/' if self.form.endswith(SAME) else ''}"


@contextlib.contextmanager
def _interrupted() -> Iterator[None]:
    """Interrupt after some time, as Ctrl-C does."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, ENOUGH_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def forms() -> list[str]:
    """Return the names of all forms."""
    return [
        *FORMS,
        *(f"{name}{SAME}" for name in ("empty", "loop", "pipe")),
        *(f"name {name}" for name in NAMES),
    ]


def some_cases(step: int) -> list[Case]:
    """Return a case of every so many slots, each with another form."""
    every = forms()
    # An audit begins with rules to compile and contexts to find, which takes long.
    slots = [slot for slot in SLOTS if not slot.startswith("audit")][::step]
    return [Case(slot, every[(7 * number) % len(every)]) for number, slot in enumerate(slots)]


def attack_slot(slot: str) -> list[str]:
    """Try one slot in all forms; return what went wrong."""
    wrong = []
    for form in forms():
        faulthandler.dump_traceback_later(HANGS_S, exit=True)
        with tempfile.TemporaryDirectory() as folder:
            if problem := Case(slot, form).run(Path(folder)):
                wrong.append(problem)
    faulthandler.cancel_dump_traceback_later()
    return wrong

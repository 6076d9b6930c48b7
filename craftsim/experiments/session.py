"""The folder of a run: a parallel map with persistent results.

The SQLite file ``session.db`` holds the run's manifest and its results, one transaction for each trial. After an
interruption all finished trials are kept, and a resumed run computes the missing ones. ``trials.jsonl`` is written
meanwhile, one line for each trial, for people and other tools; it is never read here.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import reprlib
import sqlite3
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, Final

from craftsim.errors import InputError, is_interrupt
from craftsim.experiments import records as store
from craftsim.experiments.experiment import (
    Answer,
    Experiment,
    Result,
    RunOptions,
    StoppingRule,
    TrialRecord,
    TrialWork,
    answer_of,
    make_record,
    read_as,
    record_text,
)
from craftsim.reports.json_file import json_value, versions, write_report
from craftsim.storage.folders import owned, remove
from craftsim.storage.records import adapter
from craftsim.storage.writing import whole
from craftsim.workers.copying import NotCopyable
from craftsim.workers.interrupts import defer_interrupts, interruptible
from craftsim.workers.pool import Failure, Pool

_SCHEMA_VERSION: Final = 2
RUN_ALONE: Final = RunOptions()
"""One local process, no resume."""
_HOW_TO_RESUME: Final = "interrupted: {}; the same command with --resume goes on"
_SQLITE_FILES: Final = tuple(f"{store.DATABASE}-{name}" for name in ("journal", "wal", "shm"))
_FILES: Final = ("report.json", "report.html", "durations.csv")
_FOLDERS: Final = ("bundles", "films", "trajectories", "worlds", "smallest")
"""Further output of a run, removed when another run starts in its folder."""
_PAGE: Final = 1024
_OPENED: Final = set[Path]()
"""Folders of the runs that this process has begun or resumed."""


@contextmanager
def open_session(
    experiment: Experiment, out: Path | None, options: RunOptions = RUN_ALONE
) -> Iterator[Session]:
    """Start or resume the run of an experiment in a folder; the folder is locked until the block ends.

    Without a folder everything is kept in memory and computed in this process.

    Raises:
        InputError: the folder is not writable or in use; it holds foreign files, or an unfinished run without
            ``resume``; or, with ``resume``, a different run or invalid records.
        KeyboardInterrupt: interrupted or terminated; the message says how to resume.
    """
    items = experiment.items
    if len({item.key for item in items}) != len(items):
        raise ValueError("keys of trials must be unique")
    manifest = _manifest(experiment)
    if out is None:
        yield Session(
            experiment, None, options, manifest, store.with_tables(store.connected(""), manifest)
        )
        return
    session: Session | None = None
    try:
        with interruptible(), owned(out), contextlib.ExitStack() as closing:
            with defer_interrupts(), store.disk_errors(out):
                database = closing.enter_context(
                    contextlib.closing(_opened_database(experiment, out, options.resume, manifest))
                )
                session = Session(experiment, out, options, manifest, database)
                closing.callback(session.close)
                _OPENED.add(out)
            yield session
    except (KeyboardInterrupt, ImportError) as error:
        if not is_interrupt(error):
            raise
        if session is None:
            state = f"what was finished is kept in {out}"
        else:
            state = session.state
        raise KeyboardInterrupt(_HOW_TO_RESUME.format(state)) from None


def interrupted_text(out: Path, resumes: bool) -> str:
    """Return what an interrupt before or after a session says; empty if the folder holds no run of this command."""
    path = out / store.DATABASE
    if (resumes or out in _OPENED) and path.is_file():
        with (
            contextlib.suppress(sqlite3.Error, InputError),
            contextlib.closing(_locked(path)) as database,
        ):
            ((stored,),) = database.execute("SELECT count(*) FROM trials")
            n = store.stored_manifest(database, path)["items"]
            return _HOW_TO_RESUME.format(f"{stored} of {n} trials are kept in {out}")
    return ""


def run_experiment(
    experiment: Experiment, out: Path | None, options: RunOptions = RUN_ALONE
) -> store.StoredRecords:
    """Run an experiment, in a folder if given, and return the records of its trials, see :meth:`Session.run`."""
    with open_session(experiment, out, options) as session:
        return session.run()


class Session(NotCopyable):
    """An open run; made by :func:`open_session`."""

    _instead = "open the run's folder where it is needed"

    def __init__(
        self,
        experiment: Experiment,
        out: Path | None,
        options: RunOptions,
        manifest: Mapping[str, Any],
        database: sqlite3.Connection,
    ) -> None:
        """Start from the results in a database."""
        self.experiment = experiment
        self.out = out
        self.options = options
        self.manifest = manifest
        self.records = store.StoredRecords(
            database, (out or Path()) / store.DATABASE, range(len(experiment.items))
        )
        """Records of all trials that are needed, in their order; each can be read once its trial is done."""
        self._database = database
        self._start_s = time.perf_counter()
        self._done = bytearray(len(experiment.items))
        for (number,) in database.execute("SELECT number FROM trials"):
            self._done[number] = True
        self._activity = ""
        self._pool: Pool | None = None
        if out is not None:
            self._export()
            flags = os.O_WRONLY | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC
            self._lines = os.open(out / store.TRIALS_FILE, flags)

    @property
    def state(self) -> str:
        """The progress of the run, as text."""
        if self._activity:
            return f"while {self._activity}; all trials are kept in {self.out}"
        return f"{sum(self._done)} of {len(self._done)} trials are kept in {self.out}"

    def run(self, rule: StoppingRule | None = None) -> store.StoredRecords:
        """Run all trials that have no result yet, and return the records of all, in the order of the trials.

        With a rule only those run that it needs. Each record is on disk as soon as it is known. Records depend on the
        experiment and the rule alone: not on the number of workers, the engine, the batches, or interruptions.

        Raises InputError if the disk is full or the cluster is invalid.
        """
        total = None
        if rule is None:
            total = len(self._done)
        with self.options.progress(total) as on_record:
            for number, done in enumerate(self._done):
                if done:
                    on_record(self.records.of_trial(number))
            if rule is None:
                self._run_all(range(len(self._done)), on_record)
            else:
                self._run_rounds(rule, on_record)
        return self.records

    def _run_all(self, numbers: Iterable[int], on_record: Callable[[TrialRecord], None]) -> None:
        """Run the trials of these numbers that have no result."""
        for record in self._run_missing(numbers, lambda number: self.experiment.items[number].job):
            on_record(record)

    def _run_rounds(self, rule: StoppingRule, on_record: Callable[[TrialRecord], None]) -> None:
        """Run trials in rounds until the rule has decided on every subject, or none is left."""
        items = self.experiment.items
        waiting = dict[str, list[int]]()
        for number, item in enumerate(items):
            waiting.setdefault(rule.subject_of(item), []).append(number)
        for numbers in waiting.values():
            numbers.sort(key=lambda number: rule.order_of(items[number]))
        for size in rule.round_sizes():
            if not waiting:
                break
            round_of = {}
            for subject, numbers in waiting.items():
                round_of[subject] = numbers[:size]
            self._run_all(sorted(chain.from_iterable(round_of.values())), on_record)
            undecided = {}
            for subject, numbers in round_of.items():
                records = [self.records.of_trial(number) for number in sorted(numbers)]
                is_last = len(waiting[subject]) <= size
                if not rule.is_decided(subject, records) and not is_last:
                    undecided[subject] = waiting[subject][size:]
            waiting = undecided
        if not all(self._done):
            self._leave_out_rest()

    def _leave_out_rest(self) -> None:
        """Note that the trials without a result are not needed."""
        with store.disk_errors(self.out or Path()):
            store.note_decided(self._database)
        self.records = self.records.only([number for number, done in enumerate(self._done) if done])
        if self.out is not None:
            self._export()

    def run_some(
        self, jobs: Mapping[int, Any], on_record: Callable[[TrialRecord], None]
    ) -> list[TrialRecord]:
        """Run some trials alone, by index, each with the given job, and return their records.

        Raises InputError as :meth:`run`, and for a trial without a result.
        """
        for number in jobs:
            if self._done[number]:
                on_record(self.records.of_trial(number))
        for record in self._run_missing(jobs, jobs.__getitem__):
            if record["error"] is not None:
                raise InputError(f"{record['key']}: {record['error']}; --resume tries it again")
            on_record(record)
        return [self.records.of_trial(number) for number in jobs]

    def _run_missing(
        self, numbers: Iterable[int], job_of: Callable[[int], Any]
    ) -> Iterator[TrialRecord]:
        """Run the trials of these numbers that have no result, each with its job."""
        experiment = self.experiment
        missing = [number for number in numbers if not self._done[number]]
        work = experiment.work
        limits = (experiment.timeout_s, experiment.batch)
        for number, answer in self._answers(missing, job_of, work, *limits):
            text = record_text(experiment.items[number], number, answer)
            with defer_interrupts():
                self._store("INSERT INTO trials VALUES (?, ?)", number, text)
                self._done[number] = True
                self._append(text)
            yield json.loads(text)
        if missing and self.out is not None and all(self._done):
            self._export()

    def map(
        self,
        stage: str | None,
        jobs: Mapping[str, Any],
        work: TrialWork,
        activity: str,
        *,
        timeout_s: float,
        on_answer: Callable[[str, Answer], None] = lambda key, answer: None,
    ) -> dict[str, Answer]:
        """Run the jobs of a further stage, such as bundles, and return the answers; finished ones are not repeated.

        A ``stage`` is None if the output on disk tells which jobs are done, and only the others are given. ``activity``
        describes it in messages; a worker is killed after ``timeout_s``. ``on_answer`` is called with the key and the
        answer of each job as it finishes. Raises InputError if the disk is full or the cluster is invalid.
        """
        self._activity = activity
        answers = dict[str, Answer]()
        query = "SELECT answer FROM further WHERE stage = ? AND key = ?"
        for key in jobs:
            with store.disk_errors(self.out or Path()):
                rows = self._database.execute(query, (stage, key)).fetchall()
            for (text,) in rows:
                answers[key] = self._stored_answer(key, text)
                on_answer(key, answers[key])
        missing = [key for key in jobs if key not in answers]
        for key, answer in self._answers(missing, jobs.__getitem__, work, timeout_s, 1):
            if stage is not None and isinstance(answer, Result):
                text = json.dumps(asdict(answer))
                self._store("INSERT OR REPLACE INTO further VALUES (?, ?, ?)", stage, key, text)
            answers[key] = answer
            on_answer(key, answer)
        self._activity = ""
        return {key: answers[key] for key in jobs}

    def _stored_answer(self, key: str, text: object) -> Answer:
        """Return the answer of a further stage in the database. Raises InputError for what is none."""
        data = b""
        if isinstance(text, str):
            data = text.encode()
        path = (self.out or Path()) / store.DATABASE
        place = f"{path}: not the answer of {reprlib.repr(key)}"
        answer: Answer = read_as(adapter(Result), data, place, "choose another --out")
        return answer

    def write_report(self, figures: Mapping[str, Any]) -> None:
        """Write ``report.json`` into the folder, if there is one."""
        if self.out is None:
            return
        options = self.options
        experiment = self.experiment
        total_s = time.perf_counter() - self._start_s
        wall = {"total_s": total_s, "workers": options.workers, "engine": options.engine}
        config = {**experiment.config, "against": options.against}
        write_report(
            self.out,
            figures,
            command=experiment.command,
            seed=experiment.seed,
            config=config,
            wall=wall,
        )

    def close(self) -> None:
        """Stop the workers and unlock the database; its records remain readable."""
        assert self.out is not None
        if self._pool is not None:
            self._pool.close()
        os.close(self._lines)
        # On a full disk what is in the log stays there for the next one to open it.
        with contextlib.suppress(sqlite3.Error):
            self._database.execute("PRAGMA journal_mode = DELETE").fetchall()
            self.records.database = store.read_only(self.out / store.DATABASE)
        self._database.close()

    def _store(self, statement: str, *values: object) -> None:
        """Execute a statement in a transaction of its own."""
        with store.disk_errors(self.out or Path()):
            self._database.execute(statement, values)

    def _append(self, text: str) -> None:
        """Append a line to ``trials.jsonl``, completely or not at all."""
        if self.out is None:
            return
        with store.disk_errors(self.out):
            start = os.lseek(self._lines, 0, os.SEEK_END)
            unwritten = memoryview(f"{text}\n".encode())
            try:
                while unwritten:
                    unwritten = unwritten[os.write(self._lines, unwritten) :]
            except OSError:
                os.ftruncate(self._lines, start)
                raise

    def _export(self) -> None:
        """Write ``trials.jsonl`` in the order of the trials."""
        assert self.out is not None
        path = self.out / store.TRIALS_FILE
        if not any(self._done):
            path.touch()
            return
        with whole(path) as partial, partial.open("w", encoding="utf-8") as file:
            for start in range(0, len(self._done), _PAGE):
                file.writelines(
                    f"{text}\n" for _, text in store.texts(self._database, start, start + _PAGE)
                )

    def _answers(
        self,
        keys: Sequence[Any],
        job_of: Callable[[Any], Any],
        work: TrialWork,
        timeout_s: float,
        batch: int,
    ) -> Iterator[tuple[Any, Answer]]:
        """Yield the answers to the jobs of these keys; no worker is started if there are none."""
        jobs = ((key, job_of(key)) for key in keys)
        if self.out is None:
            yield from ((key, answer_of(work, job, interruptible=True)) for key, job in jobs)
        elif keys:
            if self._pool is None:
                self._pool = Pool(self.options.workers, self.options.engine)
            work_on = partial(_answer, work)
            for (key, _), answer in self._pool.map_unordered(work_on, jobs, timeout_s, batch):
                if isinstance(answer, Failure) and answer.stops:
                    raise InputError(
                        f"{answer.text}, then --resume; what was finished is kept in {self.out}"
                    )
                yield key, answer


def _answer(work: TrialWork, keyed: tuple[Any, Any]) -> Answer:
    return answer_of(work, keyed[1])


def _manifest(experiment: Experiment) -> dict[str, Any]:
    keys = "\n".join(item.key for item in experiment.items).encode("utf-8", "backslashreplace")
    manifest = {
        "schema_version": _SCHEMA_VERSION,
        "command": experiment.command,
        "seed": experiment.seed,
        "versions": versions(),
        "config": experiment.config,
        "items": len(experiment.items),
        "keys": hashlib.sha256(keys).hexdigest(),
    }
    loaded: dict[str, Any] = json.loads(json.dumps(json_value(manifest)))
    return loaded


def _opened_database(
    experiment: Experiment, out: Path, resume: bool, manifest: Mapping[str, Any]
) -> sqlite3.Connection:
    """Return the locked database of a folder: a new one, or that of the run to resume."""
    _check_places(out)
    path = out / store.DATABASE
    with contextlib.ExitStack() as opened:
        resumes = False
        if path.exists():
            database = opened.enter_context(contextlib.closing(_locked(path)))
            resumes = _may_resume(database, out, manifest, resume)
            if resumes:
                _check_stored(database, path, experiment)
                opened.pop_all()
    if not resumes:
        # The database last, without which what is left would be a stranger's. It is a file of its own: who still reads
        # the records of the run before can read on.
        for name in (*_FILES, *_FOLDERS, store.TRIALS_FILE, *_SQLITE_FILES, store.DATABASE):
            remove(out / name)
        database = _locked(path)
    for mode in ("journal_mode = WAL", "synchronous = FULL"):
        database.execute(f"PRAGMA {mode}").fetchall()
    if resumes:
        return database
    return store.with_tables(database, manifest)


def _may_resume(
    database: sqlite3.Connection, out: Path, manifest: Mapping[str, Any], resume: bool
) -> bool:
    """Return whether to resume the run in a database; False if a new run may replace it."""
    path = out / store.DATABASE
    if not store.has_tables(database, path):
        return False
    ((stored,),) = database.execute("SELECT count(*) FROM trials")
    earlier = store.stored_manifest(database, path)
    if stored and resume:
        for key, (old, new) in store.differences(earlier, manifest):
            name = key.removeprefix("config.").replace("by.", "plan or policy ")
            raise InputError(
                f"{path}: cannot go on with another run: its {name} is {reprlib.repr(old)}, not {reprlib.repr(new)}; "
                "use the options that it was begun with, or choose another --out"
            )
    elif 0 < stored < earlier["items"] and not store.is_decided(database):
        raise InputError(
            f"{out} holds an unfinished run ({stored} of {earlier['items']} trials): go on with --resume, "
            "or choose another --out, or remove that folder"
        )
    return bool(stored) and resume


def _locked(path: Path) -> sqlite3.Connection:
    """Return a database with an exclusive lock, taken by the first read."""
    database = store.connected(path.absolute().as_uri())
    database.execute("PRAGMA locking_mode = EXCLUSIVE").fetchall()
    return database


def _check_stored(database: sqlite3.Connection, path: Path, experiment: Experiment) -> None:
    """Check all records, and remove those with an error, whose trials are repeated."""
    wrong = []
    items = experiment.items
    for record in store.checked(
        database, path, len(items), experiment.form, "choose another --out"
    ):
        number = record["index"]
        item = items[record["index"]]
        expected = make_record(item, number, Failure(""))
        if any(
            record[key] != expected[key] for key in ("key", "group", "seed", "context", "episode")
        ):
            raise InputError(
                f"{path}: trial {number}, {reprlib.repr(record['key'])}, is none of this run; choose another --out"
            )
        if record["error"] is not None:
            wrong.append((number,))
    database.execute("BEGIN")
    database.executemany("DELETE FROM trials WHERE number = ?", wrong)
    store.forget_decided(database)
    database.execute("COMMIT")


def _check_places(out: Path) -> None:
    """Raise InputError for foreign files in the place of a run's files."""
    for name in (store.DATABASE, *_SQLITE_FILES, store.TRIALS_FILE, *_FILES, *_FOLDERS):
        path = out / name
        if name in _FOLDERS:
            file_type = "folder"
        else:
            file_type = "regular file"
        if name in _FOLDERS:
            fits = path.is_dir()
        else:
            fits = path.is_file()
        if os.path.lexists(path) and (path.is_symlink() or not fits):
            raise InputError(f"{path}: not a {file_type}; move it away, or choose another --out")
    if (out / store.DATABASE).exists():
        return
    trials = out / store.TRIALS_FILE
    strangers = []
    if trials.exists() and trials.stat().st_size:
        strangers = [store.TRIALS_FILE]
    strangers = strangers + [name for name in (*_FILES, *_FOLDERS) if (out / name).exists()]
    if strangers:
        raise InputError(
            f"{out} holds {' and '.join(strangers)}, but no {store.DATABASE} that says what run they are of; "
            f"choose another --out, or move them away, or put {store.DATABASE} back"
        )

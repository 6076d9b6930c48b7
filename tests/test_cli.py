"""The command line: help without heavy imports, one message and exit 2 for wrong input."""

import errno
import itertools
import json
import os
import re
import resource
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest
import yaml

import craftsim
from craftsim import cli
from craftsim.cli import app as cli_app
from craftsim.cli import bench as doctor_module
from craftsim.cli.bench import Check
from craftsim.cli.commands import ALONE, BELOW, COMMANDS, HEADINGS
from craftsim.errors import InputError
from craftsim.reports.text import escape
from craftsim.storage import extras
from craftsim.validation.options import range_of

EVERY = [
    words
    for name in COMMANDS
    for words in ([name], *([name, below] for below in BELOW.get(name, ())))
]
EVERY = [words for words in EVERY if words[0] not in ALONE or len(words) == 2]
"""All commands, those below others included."""
KNOWN = {}


def _arguments(words):
    """Return what a command takes."""
    key = tuple(words)
    if key not in KNOWN:
        app = cli_app.make_app()
        found, name = cli_app._command(app, words)
        with app.app_stack(name):
            found = found.assemble_argument_collection(parse_docstring=True)
        KNOWN[key] = [one for one in found if one.show]
    return KNOWN[key]


def _needed(words):
    """Return arguments that a command does not do without."""
    choices = {"tune": ["drive"], "bench": ["rules"]}
    return choices.get(words[0]) or ["x" for one in _arguments(words) if one.required]


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch):
    """Register a function as the command 'probe'."""

    def register(function) -> None:
        module = type(sys)("craftsim.cli.probe")
        module.probe = function
        monkeypatch.setitem(sys.modules, "craftsim.cli.probe", module)
        monkeypatch.setitem(COMMANDS, "probe", "A probe.")

    return register


def test_there_are_few_options():
    """Some 40 of them are settings of training."""
    every = {tuple(words): _arguments(words) for words in EVERY}
    names = {
        name
        for arguments in every.values()
        for argument in arguments
        for name in argument.names[:1]
    }
    assert sum(map(len, every.values())) <= 318, "groups counted for each command that has them"
    assert len(names) <= 153, "different ones"


def test_help_names_every_command_under_its_heading(capsys):
    assert (cli.main([]), cli.main(["--help"])) == (2, 0)
    text = capsys.readouterr().out
    for heading, commands in HEADINGS.items():
        listed = "".join(f"  {name:<12}{summary}\n" for name, summary in commands.items())
        assert f"\n{heading}\n{listed}" in text
    flat = " ".join(text.split())
    assert all(f"{name} {below}" in flat for name, others in BELOW.items() for below in others)
    assert max(map(len, text.splitlines())) <= 80, "it must fit a narrow terminal"


def _help(words, columns, capsys, monkeypatch):
    """Return the help of a command on a terminal of so many columns."""
    monkeypatch.setenv("COLUMNS", str(columns))
    assert cli.main([*words, "--help"]) == 0
    return capsys.readouterr().out


def test_help_shows_every_option_with_its_values_range_and_default(capsys, monkeypatch):
    monkeypatch.setattr(cli_app, "MOST_COLUMNS", 400)
    for words in EVERY:
        text = _help(words, 400, capsys, monkeypatch)
        assert text.startswith(f"Usage: craftsim {' '.join(words)} ")
        assert not re.search(r"\bNone\b|\(\)|default: False", text)
        rows = [" ".join(line.split()) for line in text.splitlines()]
        for argument in _arguments(words):
            name = next(name for name in argument.names if name.startswith("--"))
            assert argument.parameter.help, f"{words}: {name} is not explained"
            row = next(
                row for row in rows if f" {name} " in row and argument.parameter.help[:20] in row
            )
            default = cli_app._shown_default(argument.field_info.default)
            if isinstance(argument.parameter.show_default, str):
                default = argument.parameter.show_default
            assert argument.required or default is None or f"[default: {default}]" in row
            allowed = range_of(argument.parameter)
            assert allowed is None or str(allowed).replace(" to ", "..") in row
            assert all(choice in row for choice in argument.get_choices() or ())


@pytest.mark.parametrize("columns", [40, 60, 80, 200])
def test_help_fits_the_terminal(columns, capsys, monkeypatch):
    for words in EVERY:
        text = _help(words, columns, capsys, monkeypatch)
        assert max(map(len, text.splitlines())) <= min(columns, cli_app.MOST_COLUMNS)
        names = {
            name for argument in _arguments(words) for name in argument.names[:1] if len(name) < 12
        }
        assert all(name in text for name in names)
        assert "…" not in text


def _refused(words, capsys):
    """Return the one line in which words are refused."""
    assert cli.main(words) == 2, words
    printed = capsys.readouterr()
    assert (printed.out, printed.err.count("\n")) == ("", 1)
    return printed.err


def test_an_unknown_option_is_refused_with_a_suggestion(capsys):
    for words in EVERY:
        names = [name for one in _arguments(words) for name in one.names if name.startswith("--")]
        error = _refused([*words, *_needed(words), f"{names[-1]}x", "1"], capsys)
        assert f"Unknown option: {names[-1]}x. Did you mean {names[-1]}?" in error
        assert f"Allowed: {names[0]}" in _refused([*words, *_needed(words), "--qqqq", "1"], capsys)


def test_a_number_outside_of_its_range_or_no_choice_is_refused_before_anything_is_done(
    capsys, tmp_path
):
    outside, seen = itertools.cycle(("{0}", "9" * 40, "nan", "-inf", "x")), set()
    for words in EVERY:
        out = ["--out", str(tmp_path / "out")] if words != ["view"] else []
        for one in _arguments(words):
            allowed, choices = range_of(one.parameter), one.get_choices() or ()
            numbers = {int, float} & {one.hint, *get_args(one.hint)}
            assert bool(numbers) == (allowed is not None), one.names
            if (one.names[0], str(allowed), choices) in seen or (choices and one.index is not None):
                continue
            seen.add((one.names[0], str(allowed), choices))
            if allowed is not None:
                value = next(outside).format(allowed.low - 1)
                error = _refused([*words, *_needed(words), f"{one.names[0]}={value}", *out], capsys)
                assert one.names[0] in error
                assert f"; allowed: {allowed}\n" in error or "unable to convert" in error
            elif choices:
                error = _refused([*words, *_needed(words), one.names[0], f"{choices[0]}x"], capsys)
                assert all(f'"{choice}"' in error for choice in choices)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["audit", "strip"], "'strip' is too much: see craftsim audit --help"),
        (["compare", "out/first"], "OTHER is missing: see craftsim compare --help"),
        (["tune"], "SUBJECT is missing: see craftsim tune --help"),
        (["validate", "strip", "--plan"], "--plan requires an argument"),
        (["train", "strip", "--stages"], "--stages requires at least 1"),
        (["robot", "serve", "--silent", "--once"], "--silent requires at least 1"),
    ],
)
def test_words_that_are_too_many_or_too_few_are_named(words, said, capsys):
    assert said in _refused(words, capsys)


def test_python_runs_the_package_as_the_command():
    result = subprocess.run(
        [sys.executable, "-m", "craftsim", "--version"], capture_output=True, text=True, check=False
    )
    assert (result.returncode, result.stdout) == (0, f"craftsim {craftsim.__version__}\n")


def test_our_errors_become_one_message_and_exit_2(command, capsys):
    def probe() -> int:
        raise InputError("a\x1b[31mb\x9bc\rd\u202ee\udce9f\tg\nh")

    command(probe)
    assert "no command 'docter'; did you mean 'doctor'?" in _refused(["docter"], capsys)
    assert cli.main(["probe"]) == 2
    # What steers a terminal is shown as escapes.
    assert capsys.readouterr().err == "craftsim: a\\x1b[31mb\\x9bc\\rd\\u202ee\\udce9f\tg\nh\n"
    assert escape("plain: \u00e9 \u2192 \U0001f600") == "plain: \u00e9 \u2192 \U0001f600"


@pytest.mark.parametrize("hidden", [False, True])
def test_an_interrupt_exits_with_130_also_where_an_extension_module_hides_it(
    hidden, command, capsys
):
    def probe() -> int:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as interrupt:
            raise (ImportError("initialization failed") if hidden else interrupt) from interrupt

    command(probe)
    assert cli.main(["probe"]) == 130
    assert capsys.readouterr().err == "craftsim: interrupted\n"


@pytest.mark.parametrize("error", [ImportError("no such module"), ZeroDivisionError("a bug")])
def test_a_bug_is_not_hidden(command, error):
    def probe() -> int:
        raise error

    command(probe)
    with pytest.raises(type(error), match=str(error)):
        cli.main(["probe"])


def test_so_many_runs_that_they_never_end_and_numbers_of_too_many_digits_are_refused(
    capsys, tmp_path
):
    error = _refused(["validate", "--trials", "1000000", "--out", str(tmp_path / "out")], capsys)
    assert error.startswith("craftsim: --trials times worlds and policies is 6000000")
    assert not (tmp_path / "out").exists()
    assert "--seed" in _refused(["show", "strip", "--seed", "9" * 5000], capsys)


def test_a_configuration_repeats_a_run(tmp_path, capsys):
    out = tmp_path / "first"
    config = out / "config.yaml"
    words = ["design", "wall", "--size", "2", "1", "1", "--seed", "5"]
    assert cli.main([*words, "--out", str(out)]) == 0
    assert cli.main(["design", "--config", str(config), "--out", str(tmp_path / "again")]) == 0
    first, again = (
        json.loads((tmp_path / name / "report.json").read_text()) for name in ("first", "again")
    )
    assert first | {"wall": {}} == again | {"wall": {}}
    assert config.read_text() == (tmp_path / "again" / "config.yaml").read_text()
    config.write_text(re.sub("mujoco: .*", "mujoco: 1.2.3", config.read_text()))
    words = ["design", f"--config={config}", "--seed", "6", "--out", str(tmp_path / "other")]
    assert cli.main(words) == 0
    assert "is of mujoco 1.2.3; here is" in capsys.readouterr().err
    assert json.loads((tmp_path / "other" / "report.json").read_text())["seed"] == 6


def test_every_option_of_a_command_comes_back_from_its_configuration(tmp_path):
    for words in (words for words in EVERY if words != ["view"]):  # which writes nothing
        given = [
            *words,
            *_needed(words),
            *(["--width", "3", "--novelty", "0.5"] if words == ["train"] else []),
        ]
        function, bound = cli_app.bind(
            [*given, "--map", "a", "b"] if words[-1] == "margins" else given
        )
        (tmp_path / "report.json").touch()
        bound.arguments["out"] = tmp_path
        cli_app.write_config(words, function, bound, None)
        _, again = cli_app.bind([*words, "--config", str(tmp_path / "config.yaml")])
        bound.apply_defaults()
        again.apply_defaults()
        differing = {
            name for name, value in bound.arguments.items() if again.arguments[name] != value
        }
        assert differing - {"out"} == set(), words


def _bind_with_file(words, options, folder):
    """Bind a command line with a configuration file of these options."""
    (folder / "c.yaml").write_text(yaml.safe_dump({"options": options}))
    return cli_app.bind([*words, "--config", str(folder / "c.yaml")])


READ = frozenset(
    {
        "baseline",
        "beside",
        "bundle",
        "data",
        "files",
        "from",
        "goal",
        "held-out",
        "key",
        "log",
        "machines",
        "mapping",
        "other",
        "plan",
        "run",
        "settings",
        "start",
        "starts",
        "topics",
    }
)
"""Options that name a file or folder which is read; all others name one to write."""


def test_a_configuration_sets_no_path_that_is_written():
    written = set()
    for words in EVERY:
        for argument in _arguments(words):
            if "Path" in str(argument.hint):
                written.add(argument.name.removeprefix("--"))
    assert written - READ == {"out", "export", "learn", "pddl"}
    assert written - READ <= cli_app._NOT_FROM_A_FILE.keys()


@pytest.mark.parametrize("words", EVERY, ids=" ".join)
def test_no_option_of_a_command_takes_the_name_of_code_from_a_configuration(words, tmp_path):
    for argument in _arguments(words):
        name = argument.name.removeprefix("--")
        for value in (
            "json:dumps",
            ["json:dumps", "json:dumps"],
            ["strip", "json:dumps"],
        ):
            with pytest.raises(InputError):
                _bind_with_file(words, {name: value}, tmp_path)


@pytest.mark.parametrize(
    ("words", "options", "add"),
    [
        ("validate", {"policy": "evil:f"}, "--policy evil:f"),
        ("validate", {"policy": ["planner", "evil:f"]}, "--policy planner evil:f"),
        ("validate", {"worlds": ["evil:f"]}, "add: evil:f"),
        ("validate", {"skills": "evil:f"}, "--skills evil:f"),
        ("validate", {"skills": "evil.f"}, "--skills evil.f"),
        ("validate", {"out": "elsewhere"}, "--out elsewhere"),
        ("validate", {"engine": "ray"}, "--engine ray"),
        ("validate", {"resume": True}, "--resume"),
        ("validate", {"workers": 8}, "--workers 8"),
        ("demo", {"task": "evil:f"}, "add: evil:f"),
        ("demo", {"robot": "example.org:80"}, "--robot example.org:80"),
        ("robot serve", {"host": "0.0.0.0"}, "--host 0.0.0.0"),
        ("robot serve", {"key": "theirs.pem"}, "--key theirs.pem"),
        ("view run", {"host": "0.0.0.0"}, "--host 0.0.0.0"),
        ("show strip", {"export": ["elsewhere.xml"]}, "--export elsewhere.xml"),
        ("audit", {"learn": "elsewhere.yaml"}, "--learn elsewhere.yaml"),
        ("plan strip", {"pddl": "elsewhere"}, "--pddl elsewhere"),
        ("train", {"task": "evil:f"}, "add: evil:f"),
        ("train", {"stages": ["strip", "evil:f"]}, "--stages strip evil:f"),
        ("train", {"engine": "ray"}, "--engine ray"),
        ("replay bundle", {"skills": "evil:f"}, "--skills evil:f"),
    ],
)
def test_a_configuration_sets_no_code_place_or_address_but_repeats_what_the_command_line_says(
    words, options, add, tmp_path
):
    with pytest.raises(InputError) as error:
        _bind_with_file(words.split(), options, tmp_path)
    assert "given on the command line alone, never by a file" in str(error.value)
    assert add in str(error.value)
    repeated = shlex.split(str(error.value).partition("if you trust it add: ")[2])
    _, bound = _bind_with_file([*words.split(), *repeated], options, tmp_path)
    assert bound.arguments == cli_app.bind([*words.split(), *repeated])[1].arguments


@pytest.mark.parametrize(
    ("words", "name"), [("validate strip", "plan"), ("demo", "robot"), ("train", "study")]
)
def test_a_key_that_is_also_the_name_of_a_command_has_its_effect_or_is_refused(
    words, name, tmp_path
):
    words = words.split()
    if name == "plan":
        _, bound = _bind_with_file(words, {name: "auto"}, tmp_path)
        assert bound.arguments == cli_app.bind([*words, "--plan", "auto"])[1].arguments
    else:
        with pytest.raises(InputError, match=f"Unknown option.*{name}|{name} is x"):
            _bind_with_file(words, {name: "x"}, tmp_path)


def test_a_run_of_training_writes_its_configuration_into_the_folder_that_it_names(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    words = ["train", "strip", "--steps", "1", "--episodes", "5", "--width", "8", "--worlds", "2"]
    assert cli.main(words) == 0
    config = tmp_path / "out" / "train" / "strip-ippo" / "config.yaml"
    again, first = (cli_app.bind(one)[1] for one in (["train", "--config", str(config)], words))
    again.apply_defaults()
    first.apply_defaults()
    assert again == first


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("options: {sed: 3}", "Unknown option"),
        ("options: {seed: -3}", "allowed: 0 to"),
        ("options: [1]", "'options', a mapping from names to values"),
        ("command: audit\noptions: {}", "is for 'craftsim audit', not for 'craftsim validate'"),
        ("{", "c.yaml:2: not valid YAML"),
    ],
)
def test_a_configuration_that_does_not_fit_is_refused(text, message, tmp_path, capsys):
    (tmp_path / "c.yaml").write_text(text)
    assert (
        cli.main(["validate", "--config", str(tmp_path / "c.yaml"), "--out", str(tmp_path / "out")])
        == 2
    )
    error = capsys.readouterr().err
    assert message in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_each_shell_gets_a_script_with_all_commands(shell, capsys):
    assert cli.main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(name in script for name in COMMANDS)
    assert "--randomize" in script
    if program := shutil.which(shell):
        assert subprocess.run([program, "-n"], input=script, text=True, check=False).returncode == 0


VALUES = {
    "demo --task ": ["strip", "simple_two_story", "random_strip"],
    "validate ": ["strip", "random", "free_building"],
    "validate strip --policy ": ["planner", "random", "play", "random_strip"],
    "validate --randomize ": ["none", "mild", "workshop_floor"],
    "validate --assume ": ["none", "noise"],
    "validate --gains ": ["robust", "fast"],
    "validate --plan ": ["auto", "mine.plan"],
    "validate --plan folder/": ["folder/other.plan"],
    "plan ": ["strip", "mine.plan", "folder/"],
    "render ": ["strip", "mine.plan"],
    "design ": ["pyramid", "letters", "random"],
    "train ": ["strip", "random_strip"],
    "train --network ": ["map", "relative"],
    "train --stages ": ["strip", "random_strip"],
    "train study ": ["paper", "quick"],
    "audit --actions ": ["LIFT", "MOVE_BACK"],
    "robot serve --gains ": ["fast"],
}
"""What is offered, by the beginning of a command line; of options whose values are words alone the script has these."""
IN_THE_SCRIPT = (
    "rollers",
    "sequential",
    "makespan",
    "qtran",
    "pqn",
    "asynchronous",
    "physics",
    "local",
    "ray",
)


def _offered(words, capsys):
    assert cli.main(["__complete", *words.split(" ")]) == 0
    return [line.split("\t")[0] for line in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize("words", VALUES)
def test_values_are_offered_at_a_tab(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.plan").touch()
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "other.plan").touch()
    offered = _offered(words, capsys)
    assert {*VALUES[words]} <= {*offered}
    first = VALUES[words][0]
    assert first in _offered(f"{words.rsplit(' ', 1)[0]} {first[:-1]}", capsys)


def test_nothing_is_offered_where_a_value_is_a_number(capsys):
    assert not {"strip", "none"} & {*_offered("validate --trials ", capsys)}


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes_commands_options_and_values(tmp_path, capsys):
    assert cli.main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    (tmp_path / "completion").write_text(script)
    (tmp_path / "craftsim").write_text(
        f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m craftsim "$@"\n'
    )
    (tmp_path / "craftsim").chmod(0o755)
    function = re.search(r"complete .*-F (\S+) craftsim", script)[1]
    for words, expected in {
        "val": "validate",
        "validate --rand": "--randomize",
        "validate --randomize work": "workshop_floor",
        "demo --drive wh": "wheels",
        "train --algo qt": "qtran",
        "train --algo=qt": "qtran",
    }.items():
        line = ["craftsim", *words.replace("=", " = ").split(" ")]
        asked = f"COMP_WORDS=({shlex.join(line)}); COMP_CWORD={len(line) - 1}"
        run = (
            f'source {tmp_path}/completion; {asked}; {function}; printf "%s\\n" "${{COMPREPLY[@]}}"'
        )
        environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
        done = subprocess.run(
            ["bash", "-c", run],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
            timeout=60,
        )
        assert expected in done.stdout.split(), (words, done.stdout, done.stderr)


def test_a_shell_that_is_not_known_is_refused(capsys):
    for words in [[], ["powershell"], ["bash", "more"]]:
        assert "needs a shell: bash, zsh, fish" in _refused(["completion", *words], capsys)


def test_only_two_functions_print():
    for path in Path(cli.__file__).parent.glob("[!t]*.py"):
        assert not re.search(r"(?<!\.)\bprint\(|\bConsole\(", path.read_text(encoding="utf-8")), (
            path.name
        )


@pytest.mark.parametrize(
    ("output", "status", "error"),
    [
        ("pipe", 141, ""),
        ("/dev/full", 2, "craftsim: cannot write the results: No space left on device\n"),
    ],
)
def test_an_output_that_nobody_takes_ends_without_a_traceback(output, status, error):
    if output == "pipe":
        reader, writer = os.pipe()
        os.close(reader)
    else:
        writer = os.open(output, os.O_WRONLY)
    words = [sys.executable, "-m", "craftsim", "--help"]
    child = subprocess.run(words, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert (child.returncode, child.stderr) == (status, error)


def test_a_terminal_without_the_letters_gets_others(tmp_path):
    variables = {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    name = os.fsdecode(b"caf\xe9.yaml")
    (tmp_path / name).write_text(
        "area_length: 1\narea_width: 1\narea_height: 1\nblock_num: 0\nslope_num: 0\nsmartcar_num: 1\n"
    )
    child = subprocess.run(
        [sys.executable, "-m", "craftsim", "show", name, "--out", "."],
        env=os.environ | variables,
        cwd=tmp_path,
        capture_output=True,
        check=False,
    )
    assert (child.returncode, child.stderr) == (0, b"")
    assert re.search(rb"0  \.0[<>^v]", child.stdout)
    assert child.stdout.endswith(b"picture: caf\\udce9.png\n")
    assert (tmp_path / os.fsdecode(b"caf\xe9.png")).is_file()


def test_what_no_path_can_be_is_refused_with_its_reason(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop").symlink_to("loop")
    long = "x" * 300
    for line in (
        *(f"show {long}.yaml", f"conformance {long}.yaml", f"validate {long}.yaml"),
        f"demo --plan p --task {long}.yaml",
        *(f"compare {long} {long}", f"render {long}", f"render {long}.npz", f"view {long}"),
        *("compare loop loop", "render loop", "view loop", "replay loop"),
        *("validate --baseline loop", "audit margins --baseline loop"),
    ):  # fmt: skip
        assert cli.main(line.split()) == 2
        error = capsys.readouterr().err
        assert "name too long" in error.lower() or "Too many levels of symbolic links" in error


def test_a_folder_that_is_gone_is_named_as_the_reason(capsys, tmp_path, monkeypatch):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    for name in COMMANDS:
        assert "the current folder is gone" in _refused([name], capsys)


@pytest.mark.parametrize("words", [["conformance", "missing.jsonl.gz"], ["bench", "rules"]])
def test_a_folder_that_cannot_be_made_is_refused_before_the_work(words, capsys, tmp_path):
    (tmp_path / "file").touch()
    error = _refused([*words, "--out", str(tmp_path / "file" / "out")], capsys)
    assert "cannot make the output directory" in error


def test_a_recording_without_records_is_refused(capsys, tmp_path):
    (tmp_path / "empty.jsonl.gz").touch()
    assert "empty.jsonl.gz: holds no records\n" in _refused(
        ["conformance", str(tmp_path / "empty.jsonl.gz")], capsys
    )


def test_doctor_writes_a_report(tmp_path, capsys):
    assert cli.main(["doctor", "--out", str(tmp_path)]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    physics = report["figures"]["checks"][0]
    assert (physics["what"], physics["works"]) == ("physics (MuJoCo)", True)
    assert report["versions"]["mujoco"] in capsys.readouterr().out


@pytest.mark.parametrize(
    ("broken", "status", "last_line"),
    [
        ("", 0, "All well."),
        ("_rendering", 0, "Physics runs; films or figures cannot be made yet."),
        ("_physics", 2, "Physics does not run."),
    ],
)
def test_only_missing_physics_fails_the_doctor(monkeypatch, capsys, broken, status, last_line):
    for name in ("_physics", "_rendering", "_encoder", "_compiled_code"):
        check = Check(name, name != broken, "as told", "" if name != broken else f"mend {name}")
        monkeypatch.setattr(doctor_module, name, lambda check=check: check)
    assert cli.main(["doctor"]) == status
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == last_line
    assert (f"    mend {broken}" in lines) is bool(broken)


def test_the_doctor_knows_releases_that_were_audited_and_the_one_with_wrong_physics(monkeypatch):
    audited = doctor_module._audited("3.17.0")
    assert re.fullmatch(
        r"\d of \d+ rows unsound with 3\.17\.0; 0 verdicts unlike those of 3\.17\.0", audited
    )
    assert doctor_module._audited("3.99.0").startswith("3.99.0 was not audited; 3.17.0")
    monkeypatch.setattr(doctor_module, "mujoco_release", lambda: "4.0.0")
    check = doctor_module._physics()
    assert not check.works
    assert "!=4.0.0" in check.found
    # Another distribution may have brought the module: what is installed over it breaks when that one goes.
    assert re.search(
        r"pip uninstall -y mujoco mujoco-core && \S+ -m pip install 'mujoco.*!=4\.0\.0",
        check.remedy,
    )


@pytest.mark.parametrize("release", ["4.0.0", "3.11.0", "unknown"])
def test_a_release_of_mujoco_that_is_not_allowed_is_refused_by_commands(
    release, monkeypatch, capsys, tmp_path
):
    monkeypatch.setattr(extras, "mujoco_release", lambda: release)
    said = _refused(["plan", "strip", "--out", str(tmp_path / "out")], capsys)
    assert said.startswith(f"craftsim: MuJoCo {release} is not allowed here, but ")
    assert "uninstall -y mujoco mujoco-core" in said
    assert not (tmp_path / "out").exists()


def test_the_release_of_mujoco_is_that_of_the_module_whatever_brought_it(tmp_path):
    (tmp_path / "mujoco").mkdir()
    (tmp_path / "mujoco" / "__init__.py").write_text("raise ImportError")
    (tmp_path / "mujoco" / "libmujoco.so.4.0.0").touch()
    code = "from craftsim.reports.json_file import versions; print(versions()['mujoco'])"
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    told = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert told.stdout == "4.0.0\n"
    import mujoco

    assert extras.mujoco_release() == mujoco.__version__


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.EMFILE, "Too many open files"), "ulimit -n"),
        (MemoryError(), "ulimit -v"),
        (ImportError("libx.so: failed to map segment from shared object"), "ulimit -v"),
        (RuntimeError("can't start new thread"), "ulimit -u"),
    ],
)
def test_what_this_machine_lacks_is_one_sentence(error, said, monkeypatch, capsys):
    def lacking(words):
        raise error

    monkeypatch.setattr(cli, "_run", lacking)
    assert said in _refused(["plan", "strip"], capsys)


@pytest.mark.parametrize(
    "limit", [(resource.RLIMIT_NOFILE, 20), (resource.RLIMIT_AS, 250_000 * 1024)]
)
def test_limits_of_a_shell_are_no_traceback(limit, tmp_path):
    words = [
        sys.executable,
        "-m",
        "craftsim",
        "validate",
        "strip",
        "--trials",
        "2",
        "--workers",
        "2",
    ]
    words += ["--drive", "wheels", "--video", "none", "--out", str(tmp_path)]
    number, most = limit
    done = subprocess.run(
        words,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(number, (most, most)),
    )
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("craftsim: too ")
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("words", "modules", "said"),
    [
        ("audit --baseline gone --out out", {"mujoco", "numba", "scipy"}, "gone holds no run"),
        ("audit --baseline empty --out out", {"numba", "scipy"}, "empty holds no run"),
        (
            "train strip --out file",
            {"torch"},
            "cannot make the output directory file: it is a file",
        ),
        (
            "render strip out.png --at 1 --beside gone.npz",
            {"craftsim.validation.sources"},
            "gone.npz",
        ),
        (
            "render strip file/out.mp4",
            {"craftsim.validation.sources"},
            "cannot make the output directory file",
        ),
        (
            "demo strip --robot here --out out",
            {"craftsim.robots.link"},
            "'here' is no address of robots",
        ),
    ],
)
def test_a_wrong_path_or_address_is_refused_before_what_takes_long(words, modules, said, tmp_path):
    """Before the packages and modules that the work itself takes are imported."""
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    code = (
        "import sys; from craftsim.cli import main; status = main(sys.argv[1:]); "
        f"print(status, {modules} & {{*sys.modules}})"
    )
    command = [sys.executable, "-c", code, *words.split()]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == "2 set()\n"
    assert said in done.stderr
    assert not list(tmp_path.glob("*.npz"))


def test_the_doctor_says_where_compiled_code_is_not_kept(monkeypatch, capsys):
    monkeypatch.setenv("HOME", "")
    for name in ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    check = doctor_module._compiled_code()
    assert not check.works
    assert "HOME" in check.found
    assert check.remedy == "export NUMBA_CACHE_DIR=FOLDER"


EVERYTHING = {
    "validate": "'a world.yaml' strip --plan a.plan --actions b.txt --policy play random --order ticks --cars 3 "
    "--blocks 4 --max-steps 20 --timeout 12.5 --video all --skills mine:SKILLS --noise n.yaml --assume mild "
    "--gains g.yaml --machines p.yaml --drive wheels --rules published --randomize strong --seed 7 --trials 3 "
    "--baseline old --record trajectory --minimize",
    "audit": "--actions MOVE LIFT --situations '*room=tight' --only legal --quick --rules physical --video",
    "train": "strip --width 3 --settings 'a file.yaml'",
}
ELSEWHERE = ["--resume", "--workers", "2", "--engine=ray", "--out", "some where"]
"""Options that decide no results."""


@pytest.mark.parametrize("command", EVERYTHING)
@pytest.mark.parametrize("before", [True, False])
def test_a_command_line_asks_for_the_same_again_whatever_was_asked(command, before):
    words = shlex.split(EVERYTHING[command])
    elsewhere = [*ELSEWHERE, "--seed", "3"] if before and "--seed" not in words else ELSEWHERE
    given = (
        [command, *elsewhere, *words]
        if words[0][:2] == "--" and before
        else [command, *words, *elsewhere]
    )
    cli_app.COMMAND_LINE.set(tuple(given))
    kept = [word for word in given if word not in ELSEWHERE]
    assert shlex.split(cli_app.command_again()) == ["craftsim", *kept]
    if command == "validate":
        assert cli_app.bind(kept)[1].arguments == cli_app.bind([command, *words])[1].arguments


@pytest.mark.parametrize(
    ("variable", "value", "words"),
    [
        ("MUJOCO_GL", "nonsense", "validate strip"),
        ("NUMBA_NUM_THREADS", "0", "show strip"),
        ("MPLBACKEND", "nonsense", "show strip --out out"),
    ],
)
def test_a_variable_that_a_package_refuses_is_one_sentence(variable, value, words, tmp_path):
    """Of commands that need the package; the doctor says so, too, and what to do."""
    # Another test of this process may have rendered, which sets variables.
    usual = {
        name: os.environ[name]
        for name in os.environ
        if name not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")
    }
    environment = usual | {variable: value}
    begin = [sys.executable, "-m", "craftsim"]
    options = {
        "cwd": tmp_path,
        "env": environment,
        "capture_output": True,
        "text": True,
        "check": False,
    }
    done = subprocess.run([*begin, *words.split()], **options)
    assert done.returncode == 2
    assert f"{variable}={value}" in done.stderr
    assert done.stderr.endswith(f"unset {variable}\n")
    assert "Traceback" not in done.stderr
    doctor = subprocess.run([*begin, "doctor"], **options)
    assert f"    unset {variable}\n" in doctor.stdout
    assert "All well" not in doctor.stdout
    assert doctor.returncode == (0 if variable == "MPLBACKEND" else 2)
    assert not doctor.stderr


@pytest.mark.parametrize("columns", ["0", "1", "-5", "x", ""])
def test_a_terminal_without_a_width_loses_no_table(columns, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", columns)
    assert cli.main(["doctor"]) == 0
    assert "physics" in capsys.readouterr().out

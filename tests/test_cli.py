"""The command line: help without heavy imports, one message and exit 2 for wrong input."""

import dataclasses
import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

import craftsim
from craftsim import cli
from craftsim.cli import doctor as doctor_module
from craftsim.cli.doctor import Check
from craftsim.cli.text import clean
from craftsim.errors import InputError


def _run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "craftsim", *words], capture_output=True, text=True, check=False
    )


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch):
    """Register a function as the command 'probe'."""

    def register(function) -> None:
        module = type(sys)("craftsim.cli.probe")
        module.probe = function
        monkeypatch.setitem(sys.modules, "craftsim.cli.probe", module)
        monkeypatch.setitem(cli.COMMANDS, "probe", "A probe.")

    return register


def test_help_names_every_command(capsys):
    assert cli.main(["--help"]) == 0
    text = capsys.readouterr().out
    for name, summary in cli.COMMANDS.items():
        assert f"{name} " in text
        assert summary in text
    assert max(map(len, text.splitlines())) <= 80, "it must fit a narrow terminal"


def test_no_command_is_a_usage_error(capsys):
    assert cli.main([]) == 2
    assert "usage: craftsim" in capsys.readouterr().out


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_command_explains_itself(name, capsys):
    with pytest.raises(SystemExit) as caught:
        cli.main([name, "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert f"usage: craftsim {name}" in text
    assert "None" not in text, "what need not be given is left out, not given as None"
    assert "(default: )" not in text


def test_python_runs_the_package_as_the_command():
    result = _run("--version")
    assert (result.returncode, result.stdout) == (0, f"craftsim {craftsim.__version__}\n")


def test_version(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"craftsim {craftsim.__version__}\n"


def test_a_misspelt_command_gets_a_suggestion(capsys):
    assert cli.main(["docter"]) == 2
    error = capsys.readouterr().err
    assert "no command 'docter'; did you mean 'doctor'?" in error
    assert error.count("\n") == 1


def test_an_unknown_option_is_a_usage_error():
    result = _run("doctor", "--no-such-option")
    assert result.returncode == 2
    assert "--no-such-option" in result.stderr
    assert "Traceback" not in result.stderr


def test_our_errors_become_one_message_and_exit_2(command, capsys):
    def probe() -> int:
        raise InputError("scene.yaml:3: no such key")

    command(probe)
    assert cli.main(["probe"]) == 2
    assert capsys.readouterr().err == "craftsim: scene.yaml:3: no such key\n"


def test_an_interrupt_exits_with_130(command):
    def probe() -> int:
        raise KeyboardInterrupt

    command(probe)
    assert cli.main(["probe"]) == 130


def test_an_interrupt_that_an_extension_module_hides_exits_with_130(command, capsys):
    def probe() -> int:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as interrupt:
            raise ImportError("initialization failed") from interrupt

    command(probe)
    assert cli.main(["probe"]) == 130
    assert capsys.readouterr().err == "craftsim: interrupted\n"


def test_what_cannot_be_imported_is_no_interrupt(command):
    def probe() -> int:
        raise ImportError("no such module")

    command(probe)
    with pytest.raises(ImportError, match="no such module"):
        cli.main(["probe"])


def test_a_bug_is_not_hidden(command):
    def probe() -> int:
        raise ZeroDivisionError

    command(probe)
    with pytest.raises(ZeroDivisionError):
        cli.main(["probe"])


def test_parameters_become_options_and_the_result_the_status(command):
    def probe(count: int, video: bool = True) -> int:
        return count if video else -count

    command(probe)
    assert cli.main(["probe", "--count", "3"]) == 3
    assert cli.main(["probe", "--count", "3", "--no-video"]) == -3


@pytest.mark.parametrize("name", ["demo", "validate", "audit", "train", "show", "bench"])
def test_a_negative_seed_is_refused_before_anything_is_done(name, capsys, tmp_path):
    words = {"show": ["strip"], "bench": ["rules"]}.get(name, [])
    assert cli.main([name, *words, "--seed", "-1", "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr() == (
        "",
        "craftsim: --seed is -1; allowed: 0 to 9223372036854775807\n",
    )
    assert not (tmp_path / "out").exists()


def _numbers(function) -> set[str]:
    """Return the names of a command's numbers, those in its groups of options included."""
    found = set()
    for name, hint in get_type_hints(function).items():
        groups = [hint, *get_args(hint)]
        for group in filter(dataclasses.is_dataclass, groups):
            found |= _numbers(group)
        if name != "return" and {int, float} & set(groups):
            found.add(name)
    return found


def _ranges(function) -> dict[str, object]:
    ranges = cli.ranges_of(function)
    for hint in get_type_hints(function).values():
        for group in filter(dataclasses.is_dataclass, (hint, *get_args(hint))):
            ranges |= cli.ranges_of(group)
    return ranges


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_number_of_a_command_has_limits(name):
    function = getattr(importlib.import_module(f"craftsim.cli.{name}"), name)
    assert set(_ranges(function)) == _numbers(function)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["audit", "--trials", "9" * 40], f"--trials is {'9' * 40}; allowed: 1 to 1000000"),
        (["validate", "--trials", "1000000"], "--trials times worlds and policies is 6000000"),
        (["validate", "--trials", "0"], "--trials is 0; allowed: 1 to 1000000"),
        (["validate", "--workers", "1000000000"], "--workers is 1000000000; allowed: 1 to 256"),
        (["validate", "--timeout", "nan"], "--timeout is nan; allowed: 0.01 to 604800"),
        (["validate", "--cars", "-1"], "--cars is -1; allowed: 0 to 256"),
        (["bench", "rules", "--seconds", "nan"], "--seconds is nan; allowed: 0.001 to 3600"),
        (["bench", "rules", "--seconds", "-1"], "--seconds is -1.0; allowed"),
        (["bench", "rules", "--seconds", "inf"], "--seconds is inf; allowed"),
        (["bench", "rules", "--worlds", "10000000"], "--worlds is 10000000; allowed"),
        (["show", "strip", "--seed", str(2**63)], "--seed is 9223372036854775808; allowed"),
        (["train", "--seed", str(2**64)], "--seed is 18446744073709551616; allowed"),
        (["train", "--until", "nan"], "--until is nan; allowed: 0 to 1"),
    ],
)
def test_a_number_that_is_too_small_or_too_large_is_refused_before_anything_is_done(
    words, message, capsys, tmp_path
):
    assert cli.main([*words, "--out", str(tmp_path / "out")]) == 2
    printed = capsys.readouterr()
    assert (printed.out, printed.err.count("\n")) == ("", 1)
    assert message in printed.err
    assert not (tmp_path / "out").exists()


def test_a_number_of_too_many_digits_is_a_usage_error(capsys):
    with pytest.raises(SystemExit) as caught:
        cli.main(["show", "strip", "--seed", "9" * 5000])
    assert caught.value.code == 2
    assert "--seed" in capsys.readouterr().err


def test_text_that_steers_a_terminal_is_shown_as_escapes(command, capsys):
    def probe() -> int:
        raise InputError("a\x1b[31mb\x9bc\rd\u202ee\udce9f\tg\nh")

    command(probe)
    assert cli.main(["probe"]) == 2
    told = "craftsim: a\\x1b[31mb\\x9bc\\rd\\u202ee\\udce9f\tg\nh\n"
    assert capsys.readouterr().err == told
    assert clean("plain: \u00e9 \u2192 \U0001f600") == "plain: \u00e9 \u2192 \U0001f600"


def test_only_two_functions_print():
    for path in Path(cli.__file__).parent.glob("*.py"):
        if path.name != "text.py":
            text = path.read_text(encoding="utf-8")
            assert not re.search(r"(?<!\.)\bprint\(", text), path.name
            assert path.name == "terminal.py" or not re.search(r"\bConsole\(", text), path.name


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
    words = [sys.executable, "-m", "craftsim", "show", "strip"]
    child = subprocess.run(words, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert (child.returncode, child.stderr) == (status, error)


@pytest.mark.parametrize(
    "variables",
    [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}],
)
def test_a_terminal_without_the_letters_gets_others(variables, tmp_path):
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


@pytest.mark.parametrize(
    "words", [["show"], ["conformance"], ["validate"], ["demo", "--plan", "p", "--blueprint"]]
)
def test_a_name_that_no_file_can_have_is_refused(words, capsys, tmp_path):
    out = [] if words[0] in ("show", "conformance") else ["--out", str(tmp_path / "out")]
    assert cli.main([*words, "x" * 300 + ".yaml", *out]) == 2
    assert "too long" in capsys.readouterr().err.lower()


LONG = "x" * 300


@pytest.mark.parametrize(
    "words",
    [
        *(
            ["compare", LONG, LONG],
            ["render", LONG],
            ["render", f"{LONG}.npz"],
            ["plot", LONG],
            ["view", LONG],
        ),
        *(
            ["compare", "loop", "loop"],
            ["render", "loop"],
            ["plot", "loop"],
            ["view", "loop"],
            ["replay", "loop"],
        ),
        *(["validate", "--against", "loop"], ["margins", "--against", "loop"]),
    ],
)
def test_what_no_path_can_be_is_refused_with_its_reason(words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop").symlink_to("loop")
    assert cli.main(words) == 2
    error = capsys.readouterr().err
    assert "File name too long" in error or "Too many levels of symbolic links" in error


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_a_folder_that_is_gone_is_named_as_the_reason(name, capsys, tmp_path, monkeypatch):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert cli.main([name]) == 2
    assert "the current folder is gone" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["conformance", "missing.jsonl.gz"], ["bench", "rules"]])
def test_a_folder_that_cannot_be_made_is_refused_before_the_work(words, capsys, tmp_path):
    (tmp_path / "file").touch()
    assert cli.main([*words, "--out", str(tmp_path / "file" / "out")]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "cannot make the output directory" in printed.err


def test_a_recording_without_records_is_refused(capsys, tmp_path):
    path = tmp_path / "empty.jsonl.gz"
    path.write_bytes(b"")
    assert cli.main(["conformance", str(path)]) == 2
    assert capsys.readouterr().err == f"craftsim: {path}: holds no records\n"


def test_doctor_writes_a_report(tmp_path, capsys):
    assert cli.main(["doctor", "--out", str(tmp_path)]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    physics = report["figures"]["checks"][0]
    assert (physics["what"], physics["works"]) == ("physics (MuJoCo)", True)
    assert report["versions"]["mujoco"] in capsys.readouterr().out


@pytest.mark.parametrize(
    ("broken", "status", "last_line"),
    [
        ((), 0, "All well."),
        (("_rendering",), 0, "Physics runs; films cannot be made yet."),
        (("_physics",), 2, "Physics does not run."),
    ],
)
def test_only_missing_physics_fails_the_doctor(monkeypatch, capsys, broken, status, last_line):
    for name in ("_physics", "_rendering", "_encoder"):
        works = name not in broken
        check = Check(name, works, "as told", "" if works else f"mend {name}")
        monkeypatch.setattr(doctor_module, name, lambda check=check: check)
    assert cli.main(["doctor"]) == status
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == last_line
    assert [line.strip() for line in lines if line.startswith("    mend")] == [
        f"mend {name}" for name in broken
    ]


def test_the_doctor_knows_the_version_with_wrong_physics(monkeypatch):
    monkeypatch.setattr(doctor_module, "versions", lambda: {"mujoco": "4.0.0"})
    check = doctor_module._physics()
    assert not check.works
    assert "!=4.0.0" in check.remedy

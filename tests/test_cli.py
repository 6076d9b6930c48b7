"""The command line: help without heavy imports, one message and exit 2 for wrong input."""

import json
import subprocess
import sys

import pytest

import craftsim
from craftsim import cli
from craftsim.commands import doctor as doctor_module
from craftsim.commands.doctor import Check
from craftsim.errors import InputError


def _run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "craftsim", *words], capture_output=True, text=True, check=False
    )


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch):
    """Register a function as the command 'probe'."""

    def register(function) -> None:
        module = type(sys)("craftsim.commands.probe")
        module.probe = function
        monkeypatch.setitem(sys.modules, "craftsim.commands.probe", module)
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
    assert capsys.readouterr() == ("", "craftsim: --seed is -1; allowed: 0 or more\n")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "words", [["show"], ["conformance"], ["validate"], ["demo", "--plan", "p", "--blueprint"]]
)
def test_a_name_that_no_file_can_have_is_refused(words, capsys, tmp_path):
    out = [] if words[0] in ("show", "conformance") else ["--out", str(tmp_path / "out")]
    assert cli.main([*words, "x" * 300 + ".yaml", *out]) == 2
    assert "too long" in capsys.readouterr().err.lower()


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

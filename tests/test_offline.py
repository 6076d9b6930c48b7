"""No command asks the network for anything: all of them work where every socket is shut."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]

SHUT = """
import socket

def shut(*words, **options):
    raise SystemExit(f"asked the network: {words} {options}")

for name in ("connect", "connect_ex", "bind", "sendto"):
    setattr(socket.socket, name, shut)
for name in ("getaddrinfo", "gethostbyname", "gethostbyaddr", "create_connection"):
    setattr(socket, name, shut)
"""
"""What every Python process runs first, those that it starts included."""

TRACES = str(ROOT / "tests" / "data" / "plans.jsonl.gz")
LIST = "0 STOP\n"

COMMANDS = (
    "show strip --out out",
    f"conformance {TRACES} --out out",
    "doctor --out out",
    "validate strip --actions list.txt --randomize none --trials 1 --drive reduced --video none",
)
RUN = f"""
from craftsim.cli import main
if __name__ == "__main__":
    for words in {COMMANDS}:
        assert main(words.split()) == 0, words
"""


def test_commands_work_with_all_sockets_shut(tmp_path):
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(SHUT)
    (tmp_path / "list.txt").write_text(LIST)
    path = os.pathsep.join([str(tmp_path / "site"), str(ROOT), os.environ.get("PYTHONPATH", "")])
    child = subprocess.run(
        [sys.executable, "-c", RUN],
        env=os.environ | {"PYTHONPATH": path},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "asked the network" not in child.stdout + child.stderr
    assert child.returncode == 0, child.stderr
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_the_shut_sockets_are_noticed(tmp_path):
    (tmp_path / "sitecustomize.py").write_text(SHUT)
    child = subprocess.run(
        [sys.executable, "-c", "import urllib.request as r; r.urlopen('http://127.0.0.1:9')"],
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "asked the network" in child.stderr

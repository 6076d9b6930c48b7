"""Keys of robots, made by the command that the documentation names."""

import os
import shlex
import shutil
import ssl
import subprocess
from pathlib import Path

import pytest

from craftsim.robots.keys import MAKE


def make_key(path: Path, *options: str) -> Path:
    """Make a key in a file, and return its path."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl makes keys, and is not installed")
    words = [*shlex.split(MAKE.replace("robots.pem", str(path))), *options]
    subprocess.run(words, check=True, capture_output=True, env={**os.environ, "HOME": "/"})
    return path


def greet(host, connection: ssl.SSLSocket, driver: bytes | None = None) -> None:
    """Let a connection that does not wait, and a host, show each other their keys."""
    while True:
        try:
            connection.do_handshake()
        except ssl.SSLWantReadError:
            host.receive(0.0, driver)
        else:
            host.receive(0.0, driver)
            return

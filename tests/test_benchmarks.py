"""The comparisons with CraftEnv's speed run: their figures are of a quiet machine, and none of a test."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.parametrize("subject", ["rules", "physics"])
def test_the_reference_is_timed_in_turns_with_craftsim(subject, tmp_path):
    command = [sys.executable, "reference.py", subject, "--seconds", "0.02"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run(
        [*command, "--out", str(tmp_path)], cwd=BENCHMARKS, env=environment, check=True, timeout=300
    )
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    for cases in report["wall"]["rates"].values():
        assert all(rate["times"] > 0 for rate in cases.values())

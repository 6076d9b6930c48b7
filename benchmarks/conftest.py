"""Benchmarks go by CPU seconds, unless one says that it goes by the clock or counts other processes."""

import time
from importlib.metadata import version

import pytest
from benches import cpu_s


def pytest_collection_modifyitems(items):
    for item in items:
        marker = item.get_closest_marker("benchmark")
        if marker is None:
            item.add_marker(pytest.mark.benchmark(timer=time.process_time))
        elif marker.kwargs["timer"] == "processes":
            marker.kwargs["timer"] = cpu_s


def pytest_benchmark_update_json(config, benchmarks, output_json):
    """Leave out what no page needs, and all that names a machine."""
    for one in output_json["benchmarks"]:
        one["stats"] = {key: one["stats"][key] for key in ("median", "min", "iqr", "rounds")}
        one["params"] = one["params"] and {key: str(value) for key, value in one["params"].items()}
    output_json["machine_info"] = {"cpu": output_json["machine_info"]["cpu"].get("brand_raw", "")}
    output_json["versions"] = {
        name: version(name) for name in ("craftsim", "mujoco", "numba", "numpy")
    }


def pytest_terminal_summary(terminalreporter, config):
    """Print the figures that the table has no columns for."""
    for one in config._benchmarksession.benchmarks:
        if one.extra_info:
            figures = ", ".join(f"{name} {value:.4g}" for name, value in one.extra_info.items())
            terminalreporter.write_line(f"{one.name}: {figures}")

"""Find out once whether anything renders here, which tests of physics do not need; processes; a Ray cluster."""

import fcntl
import gc
import signal
import subprocess

import bare_drawings
import forked
import pytest

from craftsim.errors import RenderingUnavailable
from craftsim.rendering.offscreen import choose_backend
from craftsim.workers.modules import REGISTERING

# What a shell runs in the background ignores Ctrl-C, and so does all that it starts; tests send it to what they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Half of the time that importing all tests takes would go into looking for garbage among what stays.
gc.disable()

try:
    choose_backend()
    _WHY_NOT = ""
except RenderingUnavailable as error:
    _WHY_NOT = str(error)


def pytest_collection_finish():
    """Look for garbage again, but not among what has been imported."""
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session")
def rendering() -> None:
    """Skip the test where nothing renders."""
    if _WHY_NOT:
        pytest.skip(_WHY_NOT)


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node):
    """Let the processes of pytest-xdist have copies of one process."""
    node.workerinput["forked"] = forked.shared()


def pytest_unconfigure():
    """End the process that is copied."""
    forked.stop()


@pytest.fixture(scope="session", autouse=True)
def _forked_workers(request):
    """Start workers without their imports."""
    if hasattr(request.config, "workerinput"):
        forked.share(request.config.workerinput["forked"])
    forked.workers(True)


@pytest.fixture(scope="session", autouse=True)
def _bare_drawings():
    """Render no drawing of a page, unless a test looks at it."""
    bare_drawings.bare(True)


@pytest.fixture(scope="module")
def rendered_drawings():
    """Render the drawings of pages."""
    bare_drawings.bare(False)
    yield
    bare_drawings.bare(True)


@pytest.fixture(scope="module", autouse=True)
def _registering():
    """Let workers import what tests of the same module register, and no other: a test module imports much."""
    kept = REGISTERING[:]
    yield
    REGISTERING[:] = kept


@pytest.fixture
def spawned():
    """Start workers as outside of the tests."""
    forked.workers(False)
    yield
    forked.workers(True)


@pytest.fixture
def start():
    """Start processes as subprocess.Popen does; none is left, however the test ends."""
    started = []

    def popen(words, **options):
        started.append(subprocess.Popen(words, **options))
        return started[-1]

    yield popen
    for process in started:
        process.kill()
        with process:
            pass


@pytest.fixture
def alone(tmp_path_factory):
    """One of the tests with Ray at a time, whatever process runs it: a cluster is found by all of a machine."""
    with (tmp_path_factory.getbasetemp().parent / "ray.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@pytest.fixture
def ray_cluster(alone, monkeypatch, request):
    """Yield a cluster of one node, or as many as the test's parameter, with two processors, which RAY_ADDRESS names."""
    import ray
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    each = {"num_cpus": 2 // getattr(request, "param", 1)}
    nodes = Cluster(initialize_head=True, head_node_args={**each, "include_dashboard": False})
    if each["num_cpus"] == 1:
        nodes.add_node(**each)
    monkeypatch.setenv("RAY_ADDRESS", nodes.address)
    usual = signal.getsignal(signal.SIGTERM)
    yield nodes
    ray.shutdown()
    nodes.shutdown()
    # Ray's own handler would stay, and end the process of later tests.
    signal.signal(signal.SIGTERM, usual)


def pytest_terminal_summary(terminalreporter, config):
    """Print how large the package is at the end of a run of all tests, into the build's log."""
    everything = list(config.args) == config.getini("testpaths") and not config.option.collectonly
    if everything and not hasattr(config, "workerinput"):
        from sizes import table

        terminalreporter.section("sizes")
        terminalreporter.write_line(table())

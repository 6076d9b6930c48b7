"""The player of recordings: its file holds a run, and pages replay it and simulate from it as MuJoCo in C does."""

import base64
import gzip
import hashlib
import json
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import mujoco
import numpy as np
import player as site
import pytest
from rendering.chromium import BROWSER, FLAGS
from rendering.recorded import record

from craftsim import Action, Grid
from craftsim.models.wheel_contacts import install
from craftsim.rendering.player import PLAYER_SUFFIX, write_player_file
from craftsim.reports.html import write_html
from craftsim.reports.report import Case, Cases, Headline, Report, Section, Tone

NEAR_M = 1e-4
"""Bar: metres, and parts of unit quaternions, after DRIVEN_S."""
DRIVEN_S = 5.0
CORNERS = ("fl", "fr", "rl", "rr")
SIMULATED = pytest.mark.skipif(
    not site.MUJOCO.is_dir(), reason="no MuJoCo for browsers; 'make docs' fetches it by npm"
)
BROWSED = pytest.mark.skipif(BROWSER is None, reason="no Chromium")


def test_a_file_holds_the_run_and_its_world(tmp_path):
    trajectory = record(Grid.empty((3, 1, 1), n_cars=1), Action.MOVE_RIGHT)
    path = write_player_file(tmp_path / f"run{PLAYER_SUFFIX}", trajectory)
    document = json.loads(gzip.decompress(path.read_bytes()))
    columns = []
    units = np.array([column["unit"] for column in document["qpos"]])
    for column in document["qpos"]:
        padded = np.pad(column["steps"], (0, len(trajectory) - len(column["steps"])))
        columns.append(np.cumsum(padded) * column["unit"])
    assert (np.abs(np.array(columns).T - trajectory.qpos) <= 0.51 * units).all()
    wheels = [trajectory.model.joint(f"car0/wheel_{corner}").qposadr[0] for corner in CORNERS]
    assert set(np.flatnonzero(units > units.min())) == set(wheels), "wheels alone are read roughly"
    times = np.cumsum(document["time_s"]) * document["units"]["time_s"]
    assert np.abs(times - trajectory.time).max() <= 0.51e-6
    assert [one["result"] for one in document["attempts"]] == ["as predicted"]
    model = mujoco.MjModel.from_xml_string(document["world"])
    assert model.nq == trajectory.qpos.shape[1]
    again = write_player_file(tmp_path / f"again{PLAYER_SUFFIX}", trajectory)
    assert again.read_bytes() == path.read_bytes()


def test_the_site_shows_all_recordings_and_has_their_films():
    shown = site.catalogue()
    assert {entry["recording"] for entry in shown} == {p.name for p in site.RECORDINGS.iterdir()}
    assert all((site.GALLERY / entry["film"]).is_file() for entry in shown)


def test_make_watch_needs_python_alone():
    environment = {"PYTHONPATH": str(Path(site.__file__).parent)}
    command = (sys.executable, "-S", "-c", "import player; player.catalogue()")
    subprocess.run(command, env=environment, check=True)


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def address(tmp_path_factory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("site")
    site.write_page(folder)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=folder)) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/index.html"
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    with playwright.sync_playwright() as started:
        opened = started.chromium.launch(executable_path=BROWSER, args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture
def page(browser):
    opened = browser.new_page(viewport={"width": 390, "height": 700})
    opened.set_default_timeout(120_000)
    yield opened
    opened.close()


def _in_player(page, expression: str):
    """Return the value of an expression in which ``player`` is the page's."""
    code = f"(() => {{ const player = document.querySelector('.player').player; {expression} }})()"
    return page.evaluate(code)


@BROWSED
def test_a_page_replays_a_verdict_without_other_hosts(address, page):
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(f"{address}#swinging_flap")
    page.wait_for_selector("[data-shown='swinging_flap']")
    page.get_by_label("speed").select_option("4")
    page.get_by_text("Verdicts: 0 of 1").click()
    page.get_by_role("button", name="side effect").click()
    page.wait_for_function("document.querySelector('.player').player.isPlaying === false")
    assert "touched slope 0" in page.locator(".player-now").inner_text()
    end_s = _in_player(page, "return player.recording.attempts[0].end_s;")
    assert _in_player(page, "return player.time;") == pytest.approx(end_s)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390, "a phone shows all of it"
    home = address.removesuffix("index.html")
    assert [url for url in asked if not url.startswith((home, "data:", "blob:"))] == []
    assert [url for url in asked if url.endswith(".wasm")] == [], "it loads when it is asked for"


@BROWSED
def test_bodies_are_where_mujoco_puts_them(address, page):
    page.goto(f"{address}#simple_two_story")
    page.wait_for_selector("[data-shown]")
    world, names, positions, poses = _in_player(
        page,
        """const positions = player.recording.positionsAt(14.23);
        const names = player.recording.bodies.map((body) => body.name);
        return [player.recording.world, names, positions, player.recording.posesOf(positions)];""",
    )
    model = mujoco.MjModel.from_xml_string(world)
    data = mujoco.MjData(model)
    data.qpos[:] = positions
    mujoco.mj_kinematics(model, data)
    for name, pose in zip(names, poses, strict=True):
        body = data.body(name)
        assert pose["pos"] == pytest.approx(body.xpos, abs=2e-6), name
        assert abs(np.dot(pose["quat"], body.xquat)) == pytest.approx(1, abs=1e-9), name


@BROWSED
def test_a_browser_without_webgl_shows_the_film(address, page):
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null;")
    page.goto(f"{address}#block")
    page.wait_for_selector("figcaption")
    assert "no WebGL" in page.locator("figcaption").inner_text()
    assert page.locator("video").get_attribute("src").endswith("player/block.mp4")


@BROWSED
@SIMULATED
@pytest.mark.parametrize("name", ["strip", "strip_rollers"])
def test_the_same_controls_lead_where_they_lead_in_c(address, page, name):
    """Wheels with one tyre too, whose contacts the page changes by itself."""
    page.goto(f"{address}#{name}")
    page.wait_for_selector("[data-shown]")
    ran = page.evaluate(
        """async (seconds) => {
        const player = document.querySelector(".player").player;
        const simulation = await player.loadedSimulation();
        const { recording } = player;
        const start = recording.positionsAt(recording.start);
        simulation.begin(start);
        const activations = [...simulation.data.act];
        const controls = [];
        const step = simulation.wheels.step.bind(simulation.wheels);
        simulation.wheels.step = () => { controls.push([...simulation.data.ctrl]); step(); };
        while (simulation.time < seconds) {
          const time = simulation.time;
          const command = { ahead: 0, left: 0, turn: 0, board: 0 };
          if (time < 1) command.board = 0.5;
          if (time < 2) command.ahead = 1;
          else if (time < 3.5) command.left = -0.7;
          else command.turn = 1;
          simulation.advance(0.0041, 0, command);
        }
        const free = recording.bodies.filter((body) => body.joint?.kind === "free");
        const columns = free.map((body) => body.joint.column);
        const ends = [...simulation.data.qpos];
        return { world: recording.world, start, activations, controls, ends, columns };
        }""",
        DRIVEN_S,
    )
    install()
    model = mujoco.MjModel.from_xml_string(ran["world"].replace('sleep="enable"', ""))
    data = mujoco.MjData(model)
    data.qpos[:] = ran["start"]
    data.act[:] = ran["activations"]
    for control in ran["controls"]:
        data.ctrl[:] = control
        mujoco.mj_step(model, data)
    assert data.time >= DRIVEN_S
    assert np.linalg.norm(data.qpos[:2] - ran["start"][:2]) > 0.5, "the car has driven"
    for column in ran["columns"]:
        pose = slice(column, column + 7)
        assert np.abs(data.qpos[pose] - ran["ends"][pose]).max() < NEAR_M


@BROWSED
@SIMULATED
def test_keys_drive_a_car_and_a_push_moves_a_block(address, page):
    page.goto(f"{address}#run_out")
    page.wait_for_selector("[data-shown]")
    page.get_by_role("button", name="Drive from here").click()
    page.wait_for_selector(".player-simulates")
    where = "return player.simulation.poses().map((pose) => pose.pos);"
    names = _in_player(page, "return player.recording.bodies.map((body) => body.name);")
    car = names.index("car0/smartcar")
    block = names.index("block0/block")
    before = _in_player(page, where)
    looked_at = _in_player(page, "return player.scene.camera.target;")
    page.keyboard.down("s")
    page.wait_for_function("document.querySelector('.player').player.simulation.time > 1")
    page.keyboard.up("s")
    after = _in_player(page, where)
    assert np.linalg.norm(np.subtract(after[car], before[car])) > 0.05
    looks_at = _in_player(page, "return player.scene.camera.target;")
    assert np.linalg.norm(np.subtract(looks_at, looked_at)) > 0.05, "the car stays in the picture"
    page.get_by_label("contacts").check()
    assert _in_player(page, "return player.contactMarks().length;") > 4
    moved = _in_player(
        page,
        f"""const simulation = player.simulation;
        const from = simulation.poses()[{block}].pos;
        const eye = [from[0], from[1], from[2] + 1];
        simulation.grab({{ eye, direction: [0, 0, -1] }});
        simulation.pull({{ eye: [eye[0], eye[1] + 0.3, eye[2]], direction: [0, 0, -1] }});
        const still = {{ ahead: 0, left: 0, turn: 0, board: 0 }};
        for (let i = 0; i < 20; i++) simulation.advance(0.04, 0, still);
        return simulation.poses()[{block}].pos[1] - from[1];""",
    )
    assert 0.02 < moved < 0.4


def _report(folder: Path, recorded: bool) -> Path:
    case = Case("a run", "failed", Tone.BAD, "it struck a block")
    if recorded:
        trajectory = record(Grid.empty((3, 1, 1), n_cars=1), Action.MOVE_RIGHT)
        path = write_player_file(folder / f"run{PLAYER_SUFFIX}", trajectory)
        case = replace(case, recording=path.name)
    section = Section("failures", "Failures", "", [Cases([case])])
    headline = Headline("failed", Tone.BAD, "A run failed.")
    return write_html(folder, Report("a report", "", headline, sections=[section]))


def test_a_report_allows_the_script_that_it_embeds_alone(tmp_path):
    assert "<script" not in _report(tmp_path, recorded=False).read_text(encoding="utf-8")
    page = _report(tmp_path, recorded=True).read_text(encoding="utf-8")
    (script,) = re.findall(r'<script type="module">(.*?)</script>', page, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', page)
    assert policy.startswith("default-src 'none';")
    assert policy.endswith(f"script-src 'sha256-{digest}'")
    defined = re.findall(r"^(?:async )?(?:const|let|function|class) (\w+)", script, re.MULTILINE)
    assert len(defined) == len(set(defined)), "the files of the player are one script here"
    assert "import " not in script


@BROWSED
def test_a_report_replays_a_failure_from_its_own_file(tmp_path, page):
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    address = _report(tmp_path, recorded=True).as_uri()
    page.goto(address)
    assert page.locator("canvas").count() == 0, "pictures are made when they are asked for"
    page.get_by_text("Replay in 3D").click()
    page.wait_for_selector("[data-shown]")
    page.locator(".player-clock", has_text=re.compile(r"^(0\.[4-9]|1)")).wait_for()
    page.get_by_text("Replay in 3D").click()
    page.locator("canvas").wait_for(state="detached")
    assert asked == [address]

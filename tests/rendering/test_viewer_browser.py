"""The viewer in a real browser without a window: the page opens without a network, and its buttons move the scene."""

import threading
import time
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from rendering.chromium import BROWSER, FLAGS
from rendering.recorded import record

from craftsim import Action, Grid, LiveView, Trajectory
from craftsim.discrete.grid import CarField
from craftsim.rendering.viewer.page import REAL_TIME
from craftsim.rendering.viewer.views import RecordedView

if BROWSER is None:
    pytest.skip(
        "no Chromium; on Debian: apt-get install chromium-headless-shell", allow_module_level=True
    )
pytest.importorskip("viser", reason="needs the extra 'view'")
playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")


def _run() -> Trajectory:
    grid = Grid.empty((3, 1, 1), n_cars=2)
    grid.cars[1, CarField.X] = 2
    return record(grid, Action.MOVE_RIGHT)


@pytest.fixture(scope="module")
def shown() -> Iterator[tuple[LiveView, RecordedView]]:
    with LiveView(port=0, speed=REAL_TIME) as view:
        recorded, ended = RecordedView(view.page, {"one": _run}), threading.Event()

        def serve() -> None:
            while not ended.wait(0.1):  # without a GPU it draws a few pictures a second
                recorded.advance(0.1)

        thread = threading.Thread(target=serve)
        thread.start()
        yield view, recorded
        ended.set()
        thread.join()


@pytest.fixture
def page():
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=BROWSER, args=FLAGS)
        opened = browser.new_page(viewport={"width": 600, "height": 320})
        yield opened
        opened.goto("about:blank")  # what it still has to draw would hold up the end
        browser.close()


def _scene(page) -> np.ndarray:
    """Return what the canvas shows, (height, width, 3), once it shows anything."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        taken = page.locator("canvas").first.screenshot(timeout=60_000)
        picture = cv2.imdecode(np.frombuffer(taken, np.uint8), cv2.IMREAD_COLOR)
        if picture.std() > 10:
            return picture
    raise AssertionError("the canvas is blank")


def _pixel(page, view: LiveView, point: np.ndarray) -> tuple[float, float]:
    """Return where on the page a point of the world is."""
    from viser.transforms import SO3

    (client,) = view.page._server.get_clients().values()
    towards = SO3(client.camera.wxyz).inverse() @ (point - client.camera.position)
    box = page.locator("canvas").first.bounding_box()
    scale = box["height"] / 2 / np.tan(client.camera.fov / 2)
    x, y = scale * towards[:2] / towards[2]
    return box["x"] + box["width"] / 2 + x, box["y"] + box["height"] / 2 + y


def test_the_page_opens_without_a_network_and_what_people_do_is_obeyed(shown, page):
    view, recorded = shown
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(view.address)
    page.get_by_text("MOVE_RIGHT").first.wait_for(timeout=60_000)
    first = _scene(page)
    page.get_by_role("button", name="Next action").click()
    page.get_by_text("waits").wait_for(timeout=60_000)
    stepped = _scene(page)
    assert (np.abs(first.astype(int) - stepped).max(axis=2) > 40).mean() > 0.002, (
        "a step moves the car"
    )
    page.get_by_role("button", name="Play").click()
    page.get_by_role("button", name="Pause").wait_for(timeout=60_000)
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Play").wait_for(timeout=60_000)
    assert recorded.trajectory.time[0] < recorded.time_s <= recorded.trajectory.time[-1]
    page.mouse.click(*_pixel(page, view, recorded.trajectory.pose("car 1")[0, :3] + [0, 0, 0.08]))
    page.get_by_text("0.806, 0.161").first.wait_for(timeout=60_000)
    assert view.page.car == 1, "a click on a car chooses it"
    local = (view.address, f"blob:{view.address}", "data:")
    assert [url for url in asked if not url.startswith(local)] == []


def test_a_page_says_that_its_server_has_ended(page):
    run = _run()
    with LiveView(port=0, speed=REAL_TIME) as view:
        RecordedView(view.page, {"one": lambda: run})
        page.goto(view.address)
        page.get_by_text("Next action").wait_for(timeout=60_000)
        page.wait_for_timeout(3000)
        assert not page.get_by_text("craftsim has ended").is_visible()
    page.get_by_text("craftsim has ended").wait_for(timeout=60_000)


def test_on_a_narrow_screen_the_middle_of_the_scene_is_above_the_panel(shown, page):
    view, _ = shown
    page.set_viewport_size({"width": 390, "height": 844})
    page.goto(view.address)
    play = page.get_by_text("Next action")
    play.wait_for(timeout=60_000)
    canvas = page.locator("canvas").first.bounding_box()
    middle_y = canvas["y"] + canvas["height"] / 2
    assert 0.2 * 844 < middle_y < play.bounding_box()["y"] - 100

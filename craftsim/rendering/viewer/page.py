"""The page of the viewer: the scene, what plays it, and what is known of the car that is looked at.

What people do in their browsers arrives in threads of the server; it waits in a queue until :meth:`ViewerPage.attend`.
"""

from __future__ import annotations

import math
import queue
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt
from craftsim.discrete.grid import Cell
from craftsim.models.world import PhysicsWorld
from craftsim.rendering.viewer.moment import Moment, car_html, list_html, title_html
from craftsim.rendering.viewer.scene import BrowserScene

if TYPE_CHECKING:
    from viser import ClientHandle, GuiEvent, ViserServer

FRAMES_HZ: Final = 25.0
"""How often poses are sent at most."""
_TEXT_S: Final = 0.15
"""Real time between two updates of texts and the slider; eyes do not follow faster ones."""
REAL_TIME: Final = "1 x"
AS_IT_GOES: Final = "as it goes"
SPEEDS: Final = {
    "1/8 x": 0.125,
    "1/4 x": 0.25,
    "1/2 x": 0.5,
    "1 x": 1.0,
    "2 x": 2.0,
    "4 x": 4.0,
    "8 x": 8.0,
    AS_IT_GOES: math.inf,
}
"""Simulated seconds in a second."""


class Controls:
    """What the buttons of a page do; each does nothing unless it is overridden."""

    def toggle(self) -> None:
        """Play or pause."""

    def step(self) -> None:
        """Go to the next action."""

    def step_back(self) -> None:
        """Go to the action before."""

    def seek(self, time_s: float) -> None:
        """Go to a moment."""

    def choose(self, run: str) -> None:
        """Go to another run."""


class ViewerPage:
    """What all browsers of a server show; all share one state."""

    def __init__(self, server: ViserServer, speed: str) -> None:
        """Add the panel, with a speed of :data:`SPEEDS`; a scene comes with :meth:`show_world`."""
        from viser import Icon

        self._server, self._icons = server, {True: Icon.PLAYER_PAUSE, False: Icon.PLAYER_PLAY}
        self.controls = Controls()
        self._pending: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self.scene: BrowserScene | None = None
        self.car = 0
        """The one that is looked at."""
        self._next_text_s = 0.0
        gui = server.gui
        server.scene.world_axes.visible = False
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        gui.set_panel_label("craftsim")
        self._title = gui.add_html("")
        self.run = gui.add_dropdown("Run", ("",), visible=False)
        self.play = gui.add_button("Play", icon=Icon.PLAYER_PLAY)
        self.back = gui.add_button("Previous action", icon=Icon.PLAYER_SKIP_BACK)
        self.forward = gui.add_button("Next action", icon=Icon.PLAYER_SKIP_FORWARD)
        self.speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value=speed)
        self.slider = gui.add_slider("Time (s)", min=0.0, max=1.0, step=0.02, initial_value=0.0)
        with gui.add_folder("Car"):
            self._cars = gui.add_dropdown("Car", ("0",))
            self._state = gui.add_html("")
        with gui.add_folder("Actions"):
            self._list = gui.add_html("")
        self._when(self.run.on_update, lambda: self.controls.choose(self.run.value))
        self._when(self.play.on_click, lambda: self.controls.toggle())
        self._when(self.back.on_click, lambda: self.controls.step_back())
        self._when(self.forward.on_click, lambda: self.controls.step())
        self._when(self.slider.on_update, lambda: self.controls.seek(float(self.slider.value)))
        self._when(self._cars.on_update, lambda: self.look_at(int(self._cars.value)))

    def _when(
        self, register: Callable[[Callable[[GuiEvent[Any]], None]], Any], do: Callable[[], None]
    ) -> None:
        def note(event: GuiEvent[Any]) -> None:
            # What this program sets has no client.
            if event.client is not None:
                self.ask(do)

        register(note)

    def offer(self, runs: Sequence[str], times_s: tuple[float, float] | None) -> None:
        """Offer runs to choose from, and moments between two times, where it is a recorded one."""
        _put(self.run, "options", tuple(runs) or ("",))
        self.run.visible = len(runs) > 1
        for part in (self.back, self.forward, self.slider):
            part.visible = times_s is not None
        if times_s is not None:
            first_s, last_s = times_s
            self.slider.min, self.slider.max = first_s, max(last_s, first_s + self.slider.step)
            if self.speed.value == AS_IT_GOES:
                _put(self.speed, "value", REAL_TIME)
            _put(self.speed, "options", tuple(name for name in SPEEDS if name != AS_IT_GOES))

    def ask(self, do: Callable[[], None]) -> None:
        """Have something done at the next :meth:`attend`; from any thread."""
        self._pending.put(do)

    def attend(self) -> bool:
        """Do what people asked for since the last call; return whether there was anything."""
        asked = not self._pending.empty()
        while not self._pending.empty():
            self._pending.get()()
        return asked

    def show_world(self, title: str, physics: PhysicsWorld, marks: Mapping[Cell, float]) -> None:
        """Show another world; ``marks`` as of :class:`BrowserScene`."""
        self._title.content = title_html(title)
        self.scene = BrowserScene(
            self._server, physics, marks, lambda car: self.ask(lambda: self.look_at(car))
        )
        self._cars.options = tuple(str(car) for car in range(len(physics.cars))) or ("0",)
        self.look_at(0)

    def look_at(self, car: int) -> None:
        """Choose the car whose state is shown."""
        self.car = car
        _put(self._cars, "value", str(car))
        self.hurry()

    def show(self, qpos: NDArray[np.float64], found: Moment, attempts: Sequence[Attempt]) -> None:
        """Show a moment: poses at once, words not more often than they can be read."""
        assert self.scene is not None, "show_world() comes first"
        self.scene.show(qpos)
        if (now := time.monotonic()) < self._next_text_s:
            return
        self._next_text_s = now + _TEXT_S
        with self._server.atomic():
            time_s = min(max(found.time_s, self.slider.min), self.slider.max)
            _put(self.slider, "value", round(time_s, 3))
            if found.cars:
                _put(self._state, "content", car_html(found, self.car))
            _put(self._list, "content", list_html(attempts, found.time_s))

    def show_playing(self, playing: bool) -> None:
        """Let the button say what it does now."""
        _put(self.play, "label", "Pause" if playing else "Play")
        _put(self.play, "icon", self._icons[playing])

    def hurry(self) -> None:
        """Show words with the next moment, however short ago they were shown."""
        self._next_text_s = 0.0

    @property
    def clients(self) -> tuple[ClientHandle, ...]:
        """The browsers that look on."""
        return tuple(self._server.get_clients().values())

    def print_error(self, text: str) -> None:
        """Show what is wrong to everybody."""
        for client in self.clients:
            client.add_notification("This cannot be shown", text, color="red")


def _put(handle: Any, name: str, value: object) -> None:
    """Set a property of a part of the panel; the same value is not sent again."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)

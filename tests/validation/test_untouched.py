"""Nothing but physics steps changes a PhysicsWorld between its reset and its end, watched in random worlds.

That these are MuJoCo's own is held by tests/models/test_world.py.
"""

import numpy as np

import craftsim
from craftsim.models.stepping import Stepping
from craftsim.models.world import PhysicsWorld


class Watch:
    """Compares positions and velocities before physics steps with those that the last ones left."""

    def __init__(self, monkeypatch):
        self.steps = self.changed = 0
        self._left: dict[int, np.ndarray] = {}
        run = Stepping.run

        def watched(stepping, n_steps):
            _, data = stepping._world
            now = self._state(data)
            if (left := self._left.get(id(data))) is not None:
                self.changed += not np.array_equal(now, left)
            n_capped = run(stepping, n_steps)
            self.steps += n_steps
            self._left[id(data)] = self._state(data)
            return n_capped

        monkeypatch.setattr(Stepping, "run", watched)
        for name in ("reset", "restore"):
            monkeypatch.setattr(PhysicsWorld, name, self._forgetting(getattr(PhysicsWorld, name)))

    @staticmethod
    def _state(data) -> np.ndarray:
        return np.concatenate([data.qpos, data.qvel])

    def _forgetting(self, write):
        def wrapped(physics, *args):
            self._left.pop(id(physics.data), None)
            # A reset steps once it has written, before it returns: what it leaves counts from there.
            write(physics, *args)
            self._left[id(physics.data)] = self._state(physics.data)

        return wrapped


def test_no_campaign_writes_positions_or_velocities_between_steps(monkeypatch):
    watch = Watch(monkeypatch)
    result = craftsim.validate(
        "random", n_cars=2, n_blocks=2, max_steps=3, seed=5, randomize="none", trials=1
    )
    assert result.to_frame()["performed"].any()
    assert watch.steps > 200
    assert watch.changed == 0


def test_the_watch_sees_a_write(monkeypatch):
    watch = Watch(monkeypatch)
    physics = PhysicsWorld(craftsim.Grid.empty((3, 1, 1), n_cars=1))
    physics.advance()
    assert watch.changed == 0
    physics.data.qvel[0] += 1e-9
    physics.advance()
    assert watch.changed == 1

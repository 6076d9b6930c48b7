"""Nothing but mj_step changes a PhysicsWorld between its reset and its end, watched in a campaign of random worlds."""

import mujoco
import numpy as np

import craftsim
from craftsim.models.world import PhysicsWorld


class Watch:
    """Compares positions and velocities before each physics step with those that the last one left."""

    def __init__(self, monkeypatch):
        self.steps = self.changed = 0
        self._left: dict[int, np.ndarray] = {}
        step = mujoco.mj_step

        def watched(model, data, nstep=1):
            now = self._state(data)
            if (left := self._left.get(id(data))) is not None:
                self.changed += not np.array_equal(now, left)
            step(model, data, nstep)
            self.steps += nstep
            self._left[id(data)] = self._state(data)

        monkeypatch.setattr(mujoco, "mj_step", watched)
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
    result = craftsim.validate("random", n_cars=2, n_blocks=2, max_steps=3, seed=5)
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

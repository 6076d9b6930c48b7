"""What a user brings: gains, observers, own observations, batches; and nothing that is handed out is shared."""

from contextlib import closing
from dataclasses import replace
from importlib import import_module

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from craftsim.discrete.kinds import Action
from craftsim.envs import GYMNASIUM_IDS, env, parallel_env, vector_env
from craftsim.envs.observations import Observe
from craftsim.envs.vector import GridVectorEnv
from craftsim.errors import InputError
from craftsim.mjcf.parameters import Machines, SmartcarParameters
from craftsim.skills.gains import load_gains
from craftsim.testing import check_api

MOVE = {"car_0": int(Action.MOVE_LEFT), "car_1": int(Action.STOP)}
BOTH = np.array([Action.MOVE_LEFT, Action.STOP])


def _central(**options):
    return gymnasium.make(GYMNASIUM_IDS["strip"], disable_env_checker=True, **options).unwrapped


def _slow_gains():
    gains = load_gains()
    return replace(gains, drive=replace(gains.drive, max_speed=0.25 * gains.drive.max_speed))


def test_gains_of_ones_own_drive_the_cars_in_every_form():
    plain = parallel_env("strip", "physics")
    plain.reset(seed=0)
    fast_s = plain.step(MOVE)[4]["car_0"]["duration_s"]
    slow = parallel_env("strip", "physics", gains=_slow_gains())
    slow.reset(seed=0)
    slow_s = slow.step(MOVE)[4]["car_0"]["duration_s"]
    assert slow_s > 1.3 * fast_s
    central = _central(backend="physics", gains=_slow_gains())
    central.reset(seed=0)
    assert central.step(BOTH)[4]["duration_s"] == slow_s


def test_machines_of_ones_own_stand_in_the_world():
    heavy = Machines(
        cars=(replace(SmartcarParameters(), chassis_mass_kg=1.1 * SmartcarParameters().chassis_mass_kg),)
    )
    masses = []
    for options in ({}, {"machines": heavy}):
        world = parallel_env("strip", "physics", **options)
        world.reset(seed=0)
        masses.append(world.core.backend.judge.physics.model.body_mass.sum())
    assert masses[1] > masses[0]
    assert world.core.backend.judge.physics.machines == heavy


@pytest.mark.parametrize("form", ["parallel", "turns", "central"])
def test_observers_see_the_site_after_every_control_period(form):
    times: list[float] = []

    def observer(physics):
        times.append(physics.time_s)

    if form == "central":
        world = _central(backend="physics", observers=[observer])
        world.reset(seed=0)
        duration_s = world.step(BOTH)[4]["duration_s"]
    elif form == "parallel":
        world = parallel_env("strip", "physics", observers=[observer])
        world.reset(seed=0)
        duration_s = world.step(MOVE)[4]["car_0"]["duration_s"]
    else:
        world = env("strip", "physics", observers=[observer])
        world.reset(seed=0)
        for action in BOTH:
            world.step(int(action))
        duration_s = world.infos["car_0"]["duration_s"]
    assert np.ptp(times) == pytest.approx(duration_s, abs=0.1)
    assert np.diff(times) == pytest.approx(0.02)


def _distance(grid, car):
    x, y, z = grid.cars[car, :3]
    return np.array([x, y, z, len(grid.cars)], np.float32)


OWN = Observe(spaces.Box(-2, 128, (4,), np.float32), _distance)


def test_observations_of_ones_own_replace_the_rows_and_the_mask_stays():
    world = parallel_env("strip", "grid", observe=OWN)
    observations, _ = world.reset(seed=0)
    assert world.observation_space("car_1")["observation"] == OWN.space
    for car, seen in enumerate(observations.values()):
        np.testing.assert_array_equal(seen["observation"], _distance(world.grid, car))
        assert seen["action_mask"].any()
    check_api(lambda: parallel_env("strip", "grid", observe=OWN))
    with pytest.raises(InputError, match="TransformObservation"):
        _central(backend="grid", observe=OWN)


def test_a_batch_of_either_backend_is_made_by_one_function():
    assert isinstance(vector_env("strip", 3), GridVectorEnv)
    assert vector_env("strip", 3, helper_depth=5).num_envs == 3
    for options, words in (
        ({"render_mode": "ansi"}, "knows no 'render_mode'"),
        ({"gains": load_gains()}, "backend='physics'"),
        ({"helper": 3}, "unknown key 'helper'; did you mean 'helper_depth'"),
        ({"backend": "grit"}, "allowed: physics, grid"),
        ({"backend": "physics", "num_envs": 0}, "num_envs: 0 is out of range"),
        ({"backend": "physics", "noise": 0.1}, "instance of SensorNoise"),
    ):
        with pytest.raises(InputError, match=words):
            vector_env("strip", **({"num_envs": 2} | options))


def test_a_batch_in_physics_takes_the_same_options_and_resets_in_the_same_step():
    with closing(vector_env("strip", 2, "physics", gains=_slow_gains())) as envs:
        envs.reset(seed=[5, 5])
        _, _, _, _, infos = envs.step(np.stack([BOTH, BOTH]))
        assert infos["duration_s"][0] == infos["duration_s"][1] > 1.0
        assert envs.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.SAME_STEP


def _spoil(array):
    array[...] = 1 - array


@pytest.mark.parametrize("form", ["parallel", "central", "vector"])
def test_what_is_handed_out_may_be_changed_without_any_consequence(form):
    """A mask that is turned around neither changes its twin in the infos nor what counts as illegal."""

    def play(spoils):
        if form == "parallel":
            world, actions = parallel_env("strip", "grid", helper_depth=3), MOVE
            observations, infos = world.reset(seed=0)
            masks = [observations["car_0"]["action_mask"], infos["car_0"]["action_mask"]]
        elif form == "central":
            world, actions = _central(backend="grid", helper_depth=3), BOTH
            observation, info = world.reset(seed=0)
            masks = [observation["action_mask"], info["action_mask"]]
        else:
            world, actions = GridVectorEnv("strip", 2, helper_depth=3), np.stack([BOTH, BOTH])
            observation, _ = world.reset(seed=0)
            masks = [observation["action_mask"]]
            vectors = world.car_vectors().copy()
        if spoils:
            for number, mask in enumerate(masks):
                others = [other.copy() for other in masks[number + 1 :]]
                _spoil(mask)
                np.testing.assert_array_equal(masks[number + 1 :], others)
            if form == "vector":
                _spoil(observation["observation"])
                np.testing.assert_array_equal(world.car_vectors(), vectors)
        infos = world.step(actions)[4]
        return [info["illegal"] for info in infos.values()] if form == "parallel" else infos["illegal"]

    np.testing.assert_array_equal(play(spoils=True), play(spoils=False))


@pytest.mark.parametrize(
    ("old", "name", "now"),
    [
        ("answers", "answer_text", "text"),
        ("collecting", "reached_worlds", "datasets"),
        ("conversation", "converse", "text"),
        ("entity_sets", "observe_entities", "observations"),
        ("images", "Images", "observations"),
        ("observe", "Observe", "observations"),
        ("physics_vector", "PhysicsVectorEnv", "vector"),
    ],
)
def test_names_of_0_2_go_on_working_and_say_where_they_are_now(old, name, now):
    with pytest.warns(DeprecationWarning, match=rf"craftsim\.envs\.{now}\.{name} now"):
        found = getattr(import_module(f"craftsim.envs.{old}"), name)
    assert found is getattr(import_module(f"craftsim.envs.{now}"), name)

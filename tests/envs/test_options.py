"""Options: each reaches the physics or what is observed, in every form; wrong ones are refused with what is allowed."""

from contextlib import closing
from dataclasses import replace
from importlib import import_module

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from craftsim.checking.setup import setup_of
from craftsim.discrete.kinds import Action
from craftsim.envs import GYMNASIUM_IDS, env, parallel_env, vector_env
from craftsim.envs.observations import Images, Observe
from craftsim.envs.vector import GridVectorEnv
from craftsim.errors import InputError
from craftsim.mjcf.parameters import NOMINAL, Machines, SmartcarParameters
from craftsim.models.config import SimulationConfig
from craftsim.models.randomization import DomainRandomization
from craftsim.models.sensing import MILD, NOISY
from craftsim.skills.gains import load_gains
from craftsim.testing import check_api

MOVE = {"car_0": int(Action.MOVE_LEFT), "car_1": int(Action.STOP)}
BOTH = np.array([Action.MOVE_LEFT, Action.STOP])
SLOW = replace(load_gains(), drive=replace(load_gains().drive, max_speed=0.25 * load_gains().drive.max_speed))
HEAVY = Machines(
    cars=(replace(SmartcarParameters(), chassis_mass_kg=1.1 * SmartcarParameters().chassis_mass_kg),)
)


def _central(**options):
    return gymnasium.make(GYMNASIUM_IDS["strip"], disable_env_checker=True, **options).unwrapped


@pytest.mark.parametrize("make", [lambda **options: parallel_env("strip", **options), _central])
def test_options_of_the_physics_are_those_of_the_world(make):
    drawn, config = DomainRandomization(), SimulationConfig()
    given = {"rule_set": "published", "gains": SLOW, "machines": HEAVY, "noise": NOISY, "assumed": MILD}
    world = make(backend="physics", randomization=drawn, config=config, check_contacts=True, **given)
    world.reset(seed=0)
    backend = world.core.backend
    setup = backend.setup
    found = setup.rules, setup.gains, setup.machines, setup.randomization, setup.assumed, setup.simulation
    assert found == ("published", SLOW, HEAVY, replace(drawn, sensors=NOISY), MILD, config)
    assert backend.judge.physics.machines == HEAVY
    assert backend.judge.log is not None


def test_environments_have_the_reduced_drive_and_validation_has_rollers_unless_told_otherwise():
    for options, drive in (
        ({}, "reduced"),
        ({"drive": "rollers"}, "rollers"),
        ({"machines": NOMINAL}, "rollers"),
        ({"machines": NOMINAL, "drive": "reduced"}, "reduced"),
    ):
        setup = parallel_env("strip", "physics", **options).core.backend.setup
        assert (setup.machines.drive, setup.simulation.timestep_s) == (drive, 0.004)
    assert setup_of().machines.drive == "rollers"
    reduced = setup_of(drive="reduced")
    assert (reduced.machines.drive, reduced.simulation.timestep_s) == ("reduced", 0.004)
    assert reduced.digests["machines"] != setup_of().digests["machines"]
    with pytest.raises(InputError, match=r"Machines.drive: unknown value 'roller'; did you mean 'rollers'"):
        replace(NOMINAL, drive="roller")


@pytest.mark.parametrize("form", ["parallel", "turns", "central"])
def test_observers_see_the_world_after_every_control_period_and_gains_make_cars_slow(form):
    times: list[float] = []
    options = {"gains": SLOW, "observers": [lambda physics: times.append(physics.time_s)]}
    if form == "central":
        world = _central(backend="physics", **options)
        world.reset(seed=0)
        duration_s = world.step(BOTH)[4]["duration_s"]
    elif form == "parallel":
        world = parallel_env("strip", "physics", **options)
        world.reset(seed=0)
        duration_s = world.step(MOVE)[4]["car_0"]["duration_s"]
    else:
        world = env("strip", "physics", **options)
        world.reset(seed=0)
        for action in BOTH:
            world.step(int(action))
        duration_s = world.infos["car_0"]["duration_s"]
    assert duration_s > 1.3, "the shipped gains take less than a second"
    assert np.ptp(times) == pytest.approx(duration_s, abs=0.1)
    assert np.diff(times) == pytest.approx(0.02)


def test_a_batch_in_physics_takes_the_same_options_and_resets_in_the_same_step():
    with closing(vector_env("strip", 2, "physics", gains=SLOW)) as envs:
        envs.reset(seed=[5, 5])
        infos = envs.step(np.stack([BOTH, BOTH]))[4]
        assert infos["duration_s"][0] == infos["duration_s"][1] > 1.3
        assert envs.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.SAME_STEP


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


def test_wrong_options_are_refused_in_both_forms():
    for options, words in [
        ({"task": "strap"}, "did you mean 'strip'"),
        ({"task": 3}, "a task is a Task"),
        ({"backend": "grit"}, "did you mean 'grid'.*allowed: physics, grid"),
        ({"rule_set": "pysical"}, "did you mean 'physical'"),
        ({"render_mode": "rgb"}, "rgb_array"),
        ({"helper_dept": 3}, "unknown key 'helper_dept'; did you mean 'helper_depth'"),
        ({"helper_depth": -1}, "allowed: 0 to 100"),
        ({"helper_depth": 2.5}, "integer from 0 to 100"),
        ({"time_weight": float("nan")}, "finite"),
        ({"time_weight": "much"}, "a number of at least 0, not 'much'"),
        ({"backend": "physics", "noise": 0.1}, "instance of SensorNoise"),
        ({"backend": "physics", "randomization": 0.1}, "instance of DomainRandomization"),
        ({"backend": "physics", "config": {"sleep": False}}, "instance of SimulationConfig"),
        ({"backend": "physics", "gains": {"drive": 3}}, "instance of Gains"),
        ({"backend": "physics", "machines": "heavy.yaml"}, "instance of Machines"),
        ({"backend": "physics", "render_size": (640, 0)}, r"render_size\[1\]: 0 is out of range"),
        ({"backend": "physics", "observers": 3}, "observers: must be"),
        ({"backend": "physics", "images": "front"}, "instance of Images"),
        ({"observe": print}, "instance of Observe"),
        *(
            ({name: value}, f"the grid backend knows no '{name}'; leave it out, or take backend='physics'")
            for name, value in {
                "randomization": DomainRandomization(),
                "gains": SLOW,
                "drive": "reduced",
                "check_contacts": True,
                "render_camera": "top",
                "observers": [print],
                "images": Images(),
            }.items()
        ),
    ]:
        given = {"task": "strip", "backend": "grid"} | options
        for make in (parallel_env, lambda **options: vector_env(num_envs=2, **options)):
            with pytest.raises(InputError, match=words):
                make(**given)


def test_a_batch_of_grid_worlds_has_fewer_options():
    assert isinstance(vector_env("strip", 3), GridVectorEnv)
    assert vector_env("strip", 3, helper_depth=5).num_envs == 3
    for options, words in (
        ({"render_mode": "ansi"}, "knows no 'render_mode'"),
        ({"observe": OWN}, "knows no 'observe'"),
        ({"workers": 2}, "knows no 'workers'"),
        ({"engine": "ray"}, "knows no 'engine'"),
        ({"num_envs": 0}, "num_envs: 0 is out of range"),
        ({"backend": "physics", "num_envs": 0}, "num_envs: 0 is out of range"),
    ):
        with pytest.raises(InputError, match=words):
            vector_env("strip", **({"num_envs": 2} | options))


def test_images_that_there_are_not_are_refused():
    for arguments, words in [
        ({"camera": "frond"}, "did you mean 'front'"),
        ({"size": (64, 0)}, "width, height"),
        ({"kinds": "rgb"}, "one or more of rgb, depth, segmentation"),
    ]:
        with pytest.raises(InputError, match=words):
            Images(**arguments)


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
                mask[...] = 1 - mask
                np.testing.assert_array_equal(masks[number + 1 :], others)
            if form == "vector":
                observation["observation"][...] = 1 - observation["observation"]
                np.testing.assert_array_equal(world.car_vectors(), vectors)
        infos = world.step(actions)[4]
        return [info["illegal"] for info in infos.values()] if form == "parallel" else infos["illegal"]

    np.testing.assert_array_equal(play(spoils=True), play(spoils=False))


def test_names_of_0_2_go_on_working_and_say_where_they_are_now():
    for old, name, now in [
        ("answers", "answer_text", "text"),
        ("conversation", "converse", "text"),
        ("entity_sets", "observe_entities", "observations"),
        ("images", "Images", "observations"),
        ("observe", "Observe", "observations"),
    ]:
        with pytest.warns(DeprecationWarning, match=rf"craftsim\.envs\.{now}\.{name} now"):
            found = getattr(import_module(f"craftsim.envs.{old}"), name)
        assert found is getattr(import_module(f"craftsim.envs.{now}"), name)

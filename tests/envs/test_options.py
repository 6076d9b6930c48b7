"""Options reach the physics or what is observed, in every form; wrong ones, starts, seeds and actions are refused."""

from contextlib import closing
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from craftsim.checking.setup import RANDOMIZE, setup_of
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.envs import TASK_IDS, env, parallel_env, vector_env
from craftsim.envs.actions import ObjectChoice
from craftsim.envs.observations import Images, Observe
from craftsim.envs.options import Options
from craftsim.envs.physics_backend import setup_from
from craftsim.envs.vector import GridVectorEnv
from craftsim.errors import InputError
from craftsim.mjcf.machines import NOMINAL, Machines
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.models.config import SimulationConfig
from craftsim.models.randomization import DomainRandomization
from craftsim.models.sensing import SensorNoise
from craftsim.skills.gains import load_gains
from craftsim.tasks import make_task
from craftsim.testing import check_api

NOISY = RANDOMIZE["strong"].sensors
MILD = RANDOMIZE["mild"].sensors

MOVE = {"car_0": int(Action.MOVE_LEFT), "car_1": int(Action.STOP)}
BOTH = np.array([Action.MOVE_LEFT, Action.STOP])
STOP = int(Action.STOP)
SLOW = replace(
    load_gains(), drive=replace(load_gains().drive, max_speed=0.25 * load_gains().drive.max_speed)
)
HEAVY = Machines(
    cars=(
        replace(SmartcarParameters(), chassis_mass_kg=1.1 * SmartcarParameters().chassis_mass_kg),
    )
)


def _central(**options):
    return gymnasium.make(TASK_IDS["strip"], disable_env_checker=True, **options).unwrapped


@pytest.mark.parametrize("make", [lambda **options: parallel_env("strip", **options), _central])
def test_options_of_the_physics_are_those_of_the_world(make):
    drawn, config = DomainRandomization(), SimulationConfig()
    given = {
        "rule_set": "published",
        "gains": SLOW,
        "machines": HEAVY,
        "noise": NOISY,
        "assumed": MILD,
    }
    world = make(
        backend="physics", randomization=drawn, config=config, check_contacts=True, **given
    )
    world.reset(seed=0)
    backend = world.core.backend
    setup = backend.setup
    found = (
        setup.rules,
        setup.gains,
        setup.machines,
        setup.randomization,
        setup.assumed,
        setup.simulation,
    )
    assert found == ("published", SLOW, HEAVY, replace(drawn, sensors=NOISY), MILD, config)
    assert backend.judge.physics.machines == HEAVY
    assert backend.judge.log is not None


def test_wheels_have_one_contact_unless_told_otherwise():
    rollers = replace(NOMINAL, drive="rollers")
    for options, drive in (
        ({}, "wheels"),
        ({"drive": "rollers"}, "rollers"),
        ({"machines": rollers}, "rollers"),
        ({"machines": rollers, "drive": "wheels"}, "wheels"),
    ):
        setup = parallel_env("strip", "physics", **options).core.backend.setup
        assert (setup.machines.drive, setup.simulation.timestep_s) == (drive, 0.004)
    assert setup_of().machines.drive == "wheels"
    assert setup_of(drive="rollers").digests["machines"] != setup_of().digests["machines"]
    with pytest.raises(
        InputError, match=r"Machines.drive: unknown value 'roller'; did you mean 'rollers'"
    ):
        replace(NOMINAL, drive="roller")


def test_observers_see_the_world_after_every_control_period_and_gains_make_cars_slow():
    times: list[float] = []
    world = env(
        "strip", "physics", gains=SLOW, observers=[lambda physics: times.append(physics.time_s)]
    )
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
        ({"backend": "physics", "randomization": "mld"}, "did you mean 'mild'"),
        ({"backend": "physics", "noise": "no.yaml"}, "no.yaml: no such file"),
        ({"backend": "physics", "config": {"sleep": False}}, "instance of SimulationConfig"),
        ({"backend": "physics", "gains": {"drive": 3}}, "instance of Gains"),
        ({"backend": "physics", "machines": "heavy.yaml"}, "instance of Machines"),
        ({"backend": "physics", "render_size": (640, 0)}, r"render_size\[1\]: 0 is out of range"),
        ({"backend": "physics", "observers": 3}, "observers: must be"),
        ({"backend": "physics", "images": "front"}, "instance of Images"),
        ({"observe": print}, "instance of Observe"),
        (
            {"backend": "physics", "record": 3},
            r"Options.record: must be an instance of Path, not '3'",
        ),
        ({"backend": "physics", "record": "/dev/null"}, "cannot make the output directory"),
        ({"record": "folder"}, "knows no 'record'"),
        ({"object_choice": ObjectChoice()}, "needs the action helper; give helper_depth"),
        ({"object_choice": 3, "helper_depth": 20}, "must be an instance of ObjectChoice"),
        ({"local_view": -1}, r"local_view: -1 is out of range, allowed: 0 to 64"),
        ({"jitter": 0.1}, "asynchronous"),
        ({"execution": "asynchronous", "wait_s": 0.0}, "wait_s"),
        (
            {"execution": "asynchronous", "backend": "physics", "failures": 0.1},
            "physics knows no 'failures'",
        ),
        ({"execution": "later"}, "execution"),
        *(
            (
                {name: value},
                f"the grid backend knows no '{name}'; leave it out, or take backend='physics'",
            )
            for name, value in {
                "randomization": DomainRandomization(),
                "gains": SLOW,
                "drive": "wheels",
                "check_contacts": True,
                "recovers": True,
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
        ({"backend": "physics", "engine": "rye"}, r"did you mean 'ray'.*allowed: local, ray"),
        ({"backend": "physics", "workers": 0}, "workers: 0 is out of range, allowed: 1 to 256"),
        (
            {"backend": "physics", "workers": "two"},
            "workers: must be an integer from 1 to 256, not 'two'",
        ),
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


@pytest.mark.parametrize("form", ["parallel", "vector"])
def test_what_is_handed_out_may_be_changed_without_any_consequence(form):
    """A mask that is turned around neither changes its twin in the infos nor what counts as illegal."""
    found = []
    for spoils in (False, True):
        if form == "parallel":
            world, actions = parallel_env("strip", "grid", helper_depth=3), MOVE
            observations, infos = world.reset(seed=0)
            twin, seen = infos["car_0"]["action_mask"], observations["car_0"]
        else:
            world, actions = GridVectorEnv("strip", 2, helper_depth=3), np.stack([BOTH, BOTH])
            seen, _ = world.reset(seed=0)
            twin = world.car_vectors()
        before = twin.copy()
        if spoils:
            for array in seen.values():
                array[...] = 1 - array
        np.testing.assert_array_equal(world.car_vectors() if form == "vector" else twin, before)
        infos = world.step(actions)[4]
        wrong = (
            [info["illegal"] for info in infos.values()] if form == "parallel" else infos["illegal"]
        )
        found.append(np.array(wrong).tolist())
    assert found[0] == found[1]


def _start(change):
    grid = make_task("strip").draw(np.random.default_rng(0))
    change(grid)
    return grid


def _one_block_more(grid):
    grid.kind[0, 0, 1] = Kind.BLOCK


def _a_slope(grid):
    grid.cars[0, 4] = Kind.FSLOPE


def _a_car_outside(grid):
    grid.cars[1, 0] = 77


def test_randomization_sensors_and_gains_are_given_by_name_as_to_the_commands():
    named = Options(randomization="strong", noise="mild", assumed="none", gains="fast")
    assert (named.noise, named.assumed) == (MILD, SensorNoise())
    assert named.gains == load_gains("fast")
    assert setup_from(named, 2) == setup_of(
        "strong", "physical", "fast", None, "mild", "none", "wheels"
    )


@pytest.mark.parametrize("preset", RANDOMIZE)
def test_physics_that_is_drawn_is_judged_as_by_validation(preset):
    assert setup_from(Options(randomization=preset), 2) == setup_of(preset, drive="wheels")


def test_starts_that_do_not_fit_are_refused_and_the_next_reset_works():
    for options, words in [
        ({"grid": "strip"}, "must be a Grid"),
        ({"grid": Grid.empty((3, 3, 2), 2)}, r"task 'strip' has \(4, 4, 3\)"),
        ({"grid": Grid.empty((4, 4, 3), 3)}, "3 cars"),
        ({"grid": _start(_one_block_more)}, "has 5 blocks; task 'strip' observes at most 4"),
        ({"grid": _start(_a_slope)}, "has 1 slopes"),
        ({"grid": _start(_a_car_outside)}, r"car 1 is at \(77, 3, 1\)"),
        ({"blueprint": "no-such-file.yaml"}, "no such file"),
        ({"bluprint": "strip"}, "no option 'bluprint'; did you mean 'blueprint'"),
        ({"blueprint": 3}, "must be a path"),
        ({"grid": _start(lambda grid: None), "blueprint": "strip.yaml"}, "give one of them"),
    ]:
        env = parallel_env("strip", "grid")
        with pytest.raises(InputError, match=words):
            env.reset(seed=0, options=options)
        env.reset(seed=0)
        assert env.grid.same_visible(_start(lambda grid: None))


@pytest.mark.parametrize("seed", [-1, "one"])
def test_a_seed_is_a_whole_number_from_0(seed):
    with pytest.raises(InputError, match="the seed is"):
        parallel_env("strip", "grid").reset(seed=seed)


@pytest.mark.parametrize(
    "make",
    [lambda: parallel_env("strip", "grid"), lambda: _central(backend="grid")],
    ids=["parallel", "central"],
)
def test_before_a_reset_and_after_the_end_a_reset_is_asked_for(make):
    env = make()
    stop = {"car_0": STOP, "car_1": STOP} if hasattr(env, "possible_agents") else [STOP, STOP]
    for act in (lambda: env.step(stop), lambda: env.core.grid, lambda: env.core.state()):
        with pytest.raises(InputError, match=r"reset\(\)"):
            act()
    env.reset(seed=0)
    for _ in range(20):
        env.step(stop)
    with pytest.raises(InputError, match=r"the episode is over; call reset\(\)"):
        env.step(stop)
    env.reset()
    env.step(stop)


def test_actions_that_are_none_are_refused_and_change_nothing():
    for actions, words in [
        ([STOP], r"shape \(2,\), not \(1,\)"),
        ([[STOP], [STOP, STOP]], r"shape \(2,\)"),
        ([-1, STOP], "0 to 14"),
        ([15, STOP], "0 to 14"),
        ([1.5, STOP], "whole numbers"),
        (["LIFT", "STOP"], "whole numbers"),
    ]:
        env = _central(backend="grid")
        env.reset(seed=0)
        before = env.core.grid
        with pytest.raises(InputError, match=words):
            env.step(actions)
        assert env.core.grid.same_visible(before)
        envs = GridVectorEnv("strip", 1)
        envs.reset(seed=0)
        with pytest.raises(InputError, match=words.replace("2,", "1, 2").split(", not")[0]):
            envs.step([actions])


def test_every_agent_needs_an_action():
    env = parallel_env("strip", "grid")
    env.reset(seed=0)
    with pytest.raises(InputError, match="no action for car_1"):
        env.step({"car_0": STOP})
    with pytest.raises(InputError, match="must be a dictionary"):
        env.step([STOP, STOP])
    with pytest.raises(InputError, match="0 to 14"):
        env.step({"car_0": 15, "car_1": STOP})

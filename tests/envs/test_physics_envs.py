"""The environments in contact physics: equal to the grid where all goes well, honest where it does not."""

import urllib.request
from contextlib import closing
from dataclasses import replace

import forked
import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from skills.disturbances import push
from tasks.platforms import platform

from craftsim.checking.recipe import perform_step, run_up
from craftsim.checking.setup import RANDOMIZE
from craftsim.discrete.kinds import Action
from craftsim.envs import TASK_IDS, parallel_env
from craftsim.errors import InputError
from craftsim.models.randomization import DomainRandomization
from craftsim.rendering.trajectory import Trajectory
from craftsim.tasks import make_task
from craftsim.testing import (
    check_api,
    check_deterministic,
    check_masks,
    check_skills,
    random_policy,
)

NOISY = RANDOMIZE["strong"].sensors

STOP = int(Action.STOP)


def _episode(env, seed, ticks, policy_seed=0):
    """Play masked random actions and return what was seen."""
    act = random_policy(np.random.default_rng(policy_seed))
    observations, _ = env.reset(seed=seed)
    seen = []
    for _ in range(ticks):
        observations, rewards, terminated, truncated, infos = env.step(act(observations))
        seen.append((observations, rewards, terminated, truncated, infos, env.state()))
        if not env.agents:
            break
    return seen


def _level(task):
    """Return masked play that leaves slopes as they are: folding takes ten seconds."""
    return make_task(task, max_steps=4)


@pytest.mark.parametrize("task", ["strip", "breaking_barrier", "complex_two_story", 1, 8])
def test_the_tasks_pass_the_tests_of_interface_determinism_masks_and_skills(task):
    task = platform(task) if isinstance(task, int) else _level(task)
    env = parallel_env(task, "physics")
    check_api(lambda: env, cycles=3)
    check_deterministic(lambda: parallel_env(task, "physics"), ticks=2)
    check_masks(env, states=1, tries=6)
    check_skills(env, ticks=2)


@pytest.mark.parametrize("helper_depth", [None, 10])
def test_a_policy_moves_from_the_grid_to_physics_without_a_change(helper_depth):
    grid, physics = (
        parallel_env("simple_two_story", backend, helper_depth=helper_depth)
        for backend in ("grid", "physics")
    )
    assert grid.observation_space("car_0") == physics.observation_space("car_0")
    assert grid.action_space("car_0") == physics.action_space("car_0")
    assert grid.state_space == physics.state_space
    one, two = (_episode(env, seed=2, ticks=12) for env in (grid, physics))
    assert len(one) == len(two)
    for (seen, *rest, infos, state), (seen2, *rest2, infos2, state2) in zip(one, two, strict=True):
        for agent in seen:
            for part in ("observation", "action_mask"):
                np.testing.assert_array_equal(seen[agent][part], seen2[agent][part])
            assert infos[agent]["illegal"] == infos2[agent]["illegal"]
            assert infos2[agent]["duration_s"] > 0
        assert rest == rest2
        np.testing.assert_array_equal(state, state2)


def test_noise_and_varied_physics_are_drawn_anew_for_every_episode_from_the_seed():
    def make():
        return parallel_env(
            _level("strip"), "physics", noise=NOISY, randomization=DomainRandomization()
        )

    check_deterministic(make, episodes=2, ticks=2)
    env = make()
    first = _episode(env, seed=0, ticks=2)
    second = _episode(env, seed=1, ticks=2)
    assert first[0][4]["car_0"]["car_error_m"] != second[0][4]["car_0"]["car_error_m"]


@pytest.fixture
def env():
    with closing(parallel_env("strip", "physics")) as made:
        made.reset(seed=0)
        yield made


def test_a_failed_skill_shows_as_what_happened_and_in_the_infos(env):
    physics = env.core.backend.judge.physics
    weak = physics.baseline.copy()
    weak.actuator_forcerange[physics.cars[0].wheel_actuators] = 0.0
    physics.set_baseline(weak)
    before = env.grid
    observations, _, terminated, truncated, infos = env.step(
        {"car_0": int(Action.MOVE_LEFT), "car_1": STOP}
    )
    info = infos["car_0"]
    assert info["outcome"].startswith(("blocked", "slipped"))
    assert (info["result"], info["reason"], info["illegal"]) == ("failed", info["outcome"], False)
    assert info["finding"] != "agrees"
    assert info["disagreement"] == ("car 0: predicted 0,1,1 +x, read 1,1,1 +x",)
    assert env.grid.same_visible(before)
    assert observations["car_0"]["observation"][0] == 1
    other = infos["car_1"]
    assert (other["result"], other["reason"], other["outcome"]) == ("as predicted", "", "succeeded")
    assert not any({**terminated, **truncated}.values())


def test_every_car_is_told_what_the_judge_found(env):
    infos = env.step({"car_0": int(Action.MOVE_LEFT), "car_1": int(Action.LIFT)})[4]
    keys = {"result", "reason", "outcome", "finding", "disagreement", "action_duration_s"}
    keys |= {"car_error_m", "heading_error_rad", "bystander_displacement_m"}
    for info in infos.values():
        assert info.keys() - keys == {"action_mask", "illegal", "success", "duration_s", "problems"}
    moved, forbidden = infos["car_0"], infos["car_1"]
    assert (moved["result"], moved["finding"], moved["disagreement"]) == (
        "as predicted",
        "agrees",
        (),
    )
    assert 0.5 < moved["action_duration_s"] <= moved["duration_s"]
    found = forbidden["illegal"], forbidden["result"], forbidden["outcome"]
    assert found == (True, "failed", "not performed")
    assert forbidden["reason"].startswith("the rules forbid it: ")


def test_a_bystander_that_moves_too_far_disagrees_though_the_reading_is_as_predicted():
    env = parallel_env("strip", "physics", observers=(push(0, 0.004),))
    env.reset(seed=0)
    told = env.step({"car_0": int(Action.MOVE_LEFT), "car_1": STOP})[4]["car_0"]
    assert 0.001 < told["bystander_displacement_m"] < 0.025
    assert (told["result"], told["finding"], told["problems"]) == ("side effect", "agrees", ())
    assert told["reason"].startswith("block 0 was moved by")


def test_a_car_beyond_its_limit_disagrees_though_the_reading_is_as_predicted(env):
    judge = env.core.backend.judge
    judge.thresholds = replace(judge.thresholds, place_m=1e-9)
    told = env.step({"car_0": int(Action.MOVE_LEFT), "car_1": STOP})[4]["car_0"]
    assert (told["result"], told["finding"]) == ("failed", "agrees")
    assert told["reason"].startswith("the car is ")


@pytest.mark.parametrize("check_contacts", [False, True])
def test_a_recorded_episode_is_re_run_bit_for_bit(check_contacts):
    options = {
        "noise": NOISY,
        "randomization": DomainRandomization(),
        "check_contacts": check_contacts,
    }
    env = parallel_env(_level("strip"), "physics", **options)
    assert _episode(env, seed=3, ticks=3)
    backend = env.core.backend
    judge = run_up(replace(backend.recipe, steps=()))
    again = [perform_step(judge, step) for step in backend.recipe.steps]
    ticks = list(backend.ticks)
    if not check_contacts:  # then nothing is known of forces, and a reason names no contact
        blind = {"peak_force_n": 0.0, "reason": ""}
        again, ticks = (
            [tuple(replace(a, **blind) for a in tick) for tick in all_] for all_ in (again, ticks)
        )
    assert again == ticks
    assert len(again) == 3
    for name in ("qpos", "qvel", "qacc_warmstart"):
        one, other = (getattr(world.physics.data, name) for world in (judge, backend.judge))
        assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize("breaks_down", [False, True])
def test_a_world_that_cannot_be_read_or_breaks_down_truncates_the_episode_and_says_why(
    env, breaks_down
):
    physics = env.core.backend.judge.physics
    if breaks_down:  # MuJoCo then starts over, and all seems to stand where it stood
        physics.data.qvel[physics.blocks[0].dof] = 1e12
    else:
        physics.data.qpos[physics.blocks[0].qpos] += 0.06  # what no skill would do
    _, rewards, terminated, truncated, infos = env.step({"car_0": STOP, "car_1": STOP})
    assert (set(truncated.values()), set(terminated.values())) == ({True}, {False})
    assert (rewards["car_0"], env.agents) == (0.0, [])
    assert ("the simulation broke down" if breaks_down else "block 0") in infos["car_1"][
        "problems"
    ][0]
    env.reset(seed=0)
    assert env.step({"car_0": STOP, "car_1": STOP})[4]["car_0"]["problems"] == ()


def test_gymnasium_accepts_the_central_form():
    env = gymnasium.make(TASK_IDS["strip"], backend="physics")
    check_env(env.unwrapped, skip_render_check=True)


def test_gymnasium_runs_physics_in_processes():
    forked.ensure_running()
    envs = gymnasium.make_vec(
        TASK_IDS["strip"],
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={"context": "forkserver"},
    )
    with closing(envs):
        observations, _ = envs.reset(seed=[5, 5])
        np.testing.assert_array_equal(
            observations["observation"][0], observations["observation"][1]
        )
        _, _, _, _, infos = envs.step(np.full((2, 2), int(Action.MOVE_LEFT)))
        assert infos["duration_s"][0] == infos["duration_s"][1] > 0.5


@pytest.fixture
def no_display(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)


def test_without_a_display_and_the_viewer_human_is_refused_in_words(no_display, monkeypatch):
    monkeypatch.setattr("craftsim.envs.physics_backend.has_viser", lambda: False)
    with pytest.raises(InputError, match="needs a display"):
        parallel_env("strip", "physics", render_mode="human").reset(seed=0)


def test_recorded_episodes_are_those_that_were_played(tmp_path):
    with closing(parallel_env(_level("strip"), "physics", record=tmp_path / "new")) as env:
        plain = _episode(parallel_env(_level("strip"), "physics"), 5, 4)
        for seed in (5, 6):
            played = _episode(env, seed, 4)
            assert seed == 6 or str(played) == str(plain), "recording changes nothing"
    paths = sorted((tmp_path / "new").iterdir())
    assert [path.name[:13] for path in paths] == ["episode-0000-", "episode-0001-"]
    trajectories = [Trajectory.read(path) for path in paths]
    for trajectory in trajectories:
        again = run_up(trajectory.story.recipe)
        perform_step(again, trajectory.story.recipe.steps[-1])
        assert np.array_equal(again.physics.data.qpos, trajectory.qpos[-1])
        assert len(trajectory.story.attempts) == 2 * len(trajectory.story.recipe.steps)
    assert trajectories[0].story.design
    with closing(parallel_env(_level("strip"), "physics", record=tmp_path / "new")) as env:
        _episode(env, 5, 4, policy_seed=1)
    assert len(list((tmp_path / "new").iterdir())) == 3, "what was done otherwise replaces nothing"


def test_without_a_display_human_is_the_viewer_in_the_browser(no_display, capsys):
    pytest.importorskip("viser", reason="needs the extra 'view'")
    with closing(parallel_env("strip", "physics", render_mode="human")) as env:
        env.reset(seed=0)
        address = capsys.readouterr().out.split()[-1]
        with urllib.request.urlopen(address, timeout=10) as answer:
            assert answer.status == 200

"""The viewer in the browser, without a browser: what is shown, and what its buttons do."""

import threading
from dataclasses import replace
from importlib.util import find_spec

import gymnasium
import mujoco
import numpy as np
import pytest

import craftsim
from craftsim import Action, Executor, Grid, LiveView, PhysicsWorld, Trajectory, parallel_env, view
from craftsim.checking.recipe import Recipe, Step, perform_step, start
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.errors import InputError
from craftsim.rendering.trajectory import Recorder
from craftsim.rendering.viewer.page import car_html, list_html
from craftsim.rendering.viewer.scene import shapes_of
from craftsim.rendering.viewer.views import RecordedView, live, recorded

pytestmark = pytest.mark.skipif(not find_spec("viser"), reason="needs the extra 'view'")
SAMPLED = ("time", "qpos", "ctrl", "force", "measured", "path", "contact")


def test_playing_pauses_at_the_end_and_starts_over_and_steps_lead_from_action_to_action(
    run: Trajectory, opened: LiveView
):
    attempts = [replace(run.story.attempts[0], start_s=at_s) for at_s in (0.5, 1.0, 0.5, 99.0)]
    acted = replace(run, story=replace(run.story, attempts=tuple(attempts)))
    shown, (start_s, end_s) = RecordedView(opened.page, {"one": lambda: acted}), run.time[[0, -1]]
    opened.page.speed.value = "1/4 x"
    shown.advance(1.0)
    assert shown.time_s == start_s, "it begins paused"
    for wall_s, expected in ((2.0, (start_s + 0.5, True)), (4 * run.duration_s, (end_s, False))):
        if not shown.playing:
            shown.toggle()
        shown.advance(wall_s)
        assert (shown.time_s, shown.playing) == expected
    shown.toggle()
    assert (shown.time_s, shown.playing) == (start_s, True), "it starts over"
    seen = []
    for move in (*[shown.step] * 4, lambda: shown.seek(1.2), *[shown.step_back] * 4):
        move()
        seen.append(shown.time_s)
    assert (seen, shown.playing) == (
        [0.5, 1.0, end_s, end_s, 1.2, 1.0, 0.5, start_s, start_s],
        False,
    )


def test_a_bundle_opens_where_the_first_action_begins_that_fails(run: Trajectory, opened: LiveView):
    attempts = [
        replace(run.story.attempts[0], start_s=at_s, result=result)
        for at_s, result in ((0.4, "as predicted"), (1.0, "failed"), (1.2, "failed"))
    ]
    failed = replace(run, story=replace(run.story, attempts=tuple(attempts)))
    assert RecordedView(opened.page, {"one": lambda: failed}, at_failure=True).time_s == 1.0
    assert RecordedView(opened.page, {"one": lambda: failed}).time_s == run.time[0]
    assert RecordedView(opened.page, {"one": lambda: run}, at_failure=True).time_s == run.time[0]


def test_a_recorded_moment_has_the_action_the_poses_the_forces_and_the_verdict(run: Trajectory):
    turn, move = run.story.attempts
    sample = run.at(move.start_s + 0.3)
    car = recorded(run, sample, 0)
    assert (car.action, car.attempt) == ("MOVE_RIGHT", move)
    assert car.pose == run.pose("car 0")[sample, :3].tolist()
    assert car.measured == pytest.approx(run.measured[sample, 0])
    assert [force for _, force, _ in car.motors] == pytest.approx(run.force[sample, :5])
    assert [limit for _, _, limit in car.motors] == [2.5, 2.5, 2.5, 2.5, 80.0]
    after = recorded(run, len(run) - 1, 0)
    assert (after.action, after.attempt) == ("", move)
    assert recorded(run, run.at(turn.start_s), 0).attempt == turn


def test_a_live_moment_is_what_the_recorder_writes_down():
    recipe = Recipe(
        blueprint_text(Grid.empty((3, 1, 1), n_cars=1)), (Step.single(0, 0, Action.MOVE_RIGHT),)
    )
    judge, recorder, seen = start(recipe), Recorder(), []
    judge.executor.observers.append(lambda physics: seen.append(live(physics, judge, {}, (), 0)))
    recorder.begin(judge)
    attempts = perform_step(judge, recipe.steps[0])
    whole = recorder.trajectory("", recipe, attempts)
    now, then = seen[19], recorded(whole, 20, 0)
    assert (now.time_s, now.pose) == (then.time_s, then.pose)
    assert now.measured == pytest.approx(then.measured)
    assert [force for _, force, _ in now.motors] == pytest.approx(
        [force for _, force, _ in then.motors]
    )
    assert now.contact_n == pytest.approx(then.contact_n)


def test_words_name_the_verdict_and_cannot_be_code(run: Trajectory):
    text = car_html(recorded(run, len(run) - 1, 0))
    assert "last: MOVE_RIGHT" in text
    assert "as predicted" in text
    assert "2.5" in text
    listed = list_html(run.story.attempts, run.story.attempts[1].start_s)
    assert listed.index("ROTATE_LEFT") < listed.index("MOVE_RIGHT")
    assert listed.count("font-weight:600") == 1, "what runs stands out"
    nasty = [replace(attempt, action="<script>") for attempt in run.story.attempts]
    assert "<script>" not in list_html(nasty, 0.0)


def test_the_meshes_are_where_mujoco_has_its_own(run: Trajectory):
    model = run.model
    data = mujoco.MjData(model)
    data.qpos[:] = run.qpos[-1]  # wheels and rollers have turned
    mujoco.mj_kinematics(model, data)
    boxes: dict[int, list] = {}
    for body, mesh in shapes_of(model).items():
        turned = mesh.vertices @ data.xmat[body].reshape(3, 3).T + data.xpos[body]
        boxes.setdefault(int(model.body_rootid[body]), []).append(turned)
    expected: dict[int, list] = {}
    for geom in np.flatnonzero((model.geom_group < 3) & (model.geom_bodyid > 0)):
        half, centre = model.geom_aabb[geom, 3:], model.geom_aabb[geom, :3]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            first = model.mesh_vertadr[model.geom_dataid[geom]]
            points = model.mesh_vert[first : first + model.mesh_vertnum[model.geom_dataid[geom]]]
        else:
            points = centre + half * np.vstack([np.eye(3), -np.eye(3)])
        turned = points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        expected.setdefault(int(model.body_rootid[model.geom_bodyid[geom]]), []).append(turned)
    assert set(boxes) == set(expected)
    for root, points in expected.items():
        drawn, whole = np.vstack(boxes[root]), np.vstack(points)
        assert drawn.min(axis=0) == pytest.approx(whole.min(axis=0), abs=2e-3)
        assert drawn.max(axis=0) == pytest.approx(whole.max(axis=0), abs=2e-3)


def test_only_what_has_moved_is_sent_and_a_step_shows_where_the_next_action_begins(
    run: Trajectory, opened: LiveView
):
    shown, page = RecordedView(opened.page, {"one": lambda: run}), opened.page
    before = page.scene.sent
    page.scene.show(run.qpos[0])
    assert page.scene.sent == before
    page.scene.show(run.qpos[-1])
    assert 0 < page.scene.sent - before <= 2 * 6, "the car's parts; the block has stayed"
    page.ask(shown.step)
    shown.advance(0.0)
    begin_s = run.story.attempts[1].start_s
    assert page.slider.value == pytest.approx(begin_s, abs=0.021)
    car = next(n for n in page.scene.nodes.values() if n.name.endswith("/smartcar"))
    assert car.position == pytest.approx(run.pose("car 0")[run.at(begin_s), :3], abs=2e-5)


def test_another_run_can_be_chosen_whenever_it_was(run: Trajectory, opened: LiveView):
    later = replace(run, time=run.time + 1000)
    moment = replace(later, **{name: getattr(later, name)[:1] for name in SAMPLED})
    runs = {"one": lambda: run, "later": lambda: later, "a moment": lambda: moment}
    runs["gone"] = lambda: Trajectory.read("no.npz")
    shown = RecordedView(opened.page, runs)
    for name, chosen in (("later", later), ("a moment", moment), ("one", run)):
        shown.choose(name)
        assert shown.trajectory is chosen
        assert opened.page.slider.value == pytest.approx(chosen.time[0])
    shown.choose("gone")
    assert shown.trajectory is run, "one that cannot be read leaves the one before"


def test_looking_on_changes_nothing(opened: LiveView):
    ends = []
    for observer in (None, opened):
        physics = PhysicsWorld(Grid.empty((2, 1, 1), n_cars=1))
        Executor(physics, observer=observer).run({0: Action.ROTATE_LEFT})
        ends.append(physics.data.qpos.copy())
    assert np.array_equal(*ends)
    assert opened.page.scene is not None


def test_a_pause_holds_what_runs_until_somebody_lets_it_go_on(opened: LiveView):
    physics = PhysicsWorld(Grid.empty((2, 1, 1), n_cars=1))
    opened.page.ask(opened.toggle)
    thread = threading.Thread(target=opened, args=(physics,))
    thread.start()
    thread.join(0.5)
    assert thread.is_alive()
    opened.page.ask(opened.toggle)
    thread.join(10)
    assert not thread.is_alive()


def test_each_form_of_the_environment_shows_its_episodes_and_what_was_judged():
    env = parallel_env("strip")
    with view(env, port=0) as shown:
        _, infos = env.reset(seed=0)
        env.step({agent: int(infos[agent]["action_mask"].argmax()) for agent in env.agents})
        assert {attempt.car for attempt in shown.judged} == {0, 1}
        env.reset(seed=1)
        assert len(shown.judged) == 0
    for env in (craftsim.env("strip"), gymnasium.make("craftsim/Strip-v0", backend="physics")):
        with view(env, port=0) as shown:
            env.reset(seed=0)
            assert shown.page.scene is not None
    with pytest.raises(InputError, match="backend='physics'"):
        view(parallel_env("strip", "grid"))
    with pytest.raises(InputError, match="there is no speed '3 x'"):
        LiveView(port=0, speed="3 x")

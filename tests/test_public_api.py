"""The public names: one list, each with a docstring, types and an example that runs; importing craftsim stays light."""

import doctest
import inspect

import pytest
from registered import forget

import craftsim

PUBLIC = sorted(set(craftsim.__all__) - {"__version__"})

STABLE = """
    Action Attempt BlockParameters Blueprint Command DomainRandomization Executor Gains Grid Kind LiveView Machines
    Mecanum PhysicsWorld Plan Planned Reason Rules SensorNoise Sensors SimulationConfig Skill SlopeParameters
    SmartcarParameters Task Trajectory Validation designs_task env load_gains load_machines load_policy make_task
    parallel_env perform plan random_task read_blueprint read_plan register_action register_task take_images
    validate vector_env view write_blueprint write_plan
"""
"""What tools outside the repository may use; a name goes only with a new minor version."""


def test_the_public_names_are_those_that_are_promised():
    assert STABLE.split() == PUBLIC
    assert set(dir(craftsim)) >= set(PUBLIC)
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = craftsim.no_such_name


def test_public_callables_have_types():
    for name in sorted({*PUBLIC} - {"Action", "Kind", "Reason"}):  # which are enumerations
        thing = getattr(craftsim, name)
        signature = inspect.signature(thing.__init__ if inspect.isclass(thing) else thing)
        parameters = [p for p in signature.parameters.values() if p.name != "self"]
        assert all(p.annotation is not inspect.Parameter.empty for p in parameters), name
        assert (
            inspect.isclass(thing) or signature.return_annotation is not inspect.Signature.empty
        ), name


@pytest.mark.parametrize("name", PUBLIC)
def test_the_example_of_a_public_name_runs(name, tmp_path, request):
    examples = doctest.DocTestParser().get_examples(inspect.getdoc(getattr(craftsim, name)) or "")
    assert examples, f"craftsim.{name} has no example in its docstring"
    names = {"folder": tmp_path}
    if name == "load_policy":
        names["trained"] = request.getfixturevalue("trained")
    test = doctest.DocTest(examples, names, name, None, None, None)
    report: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    failed = runner.run(test, out=report.append).failed
    forget()
    assert failed == 0, "".join(report)


@pytest.fixture(scope="session")
def trained(tmp_path_factory):
    """A policy as training begins with."""
    pytest.importorskip("torch")
    from craftsim.learning.config import TrainConfig
    from craftsim.learning.trainer import Trainer

    out = tmp_path_factory.mktemp("trained")
    Trainer(TrainConfig("strip", worlds=1, width=4)).save(out)
    return out


def test_results_show_themselves_in_a_notebook():
    physics = craftsim.PhysicsWorld(craftsim.Grid.empty((2, 1, 1), n_cars=1))
    attempt = craftsim.perform(physics, 0, "MOVE_RIGHT")
    assert "as predicted" in attempt._repr_html_()
    assert attempt.to_frame().shape[0] == 1
    result = craftsim.validate("strip", trials=1, drive="wheels")
    assert "Validation(1 of 1 runs agree" in result._repr_html_()
    assert result.attempts[0].agrees

"""The parts of the interface by themselves: network, inbox with its watchdog, extrapolation and clock."""

import numpy as np
import pytest

from craftsim.errors import InputError
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.sensing import CarMeasurement
from craftsim.robots.extrapolation import Extrapolation
from craftsim.robots.fleet import RealClock
from craftsim.robots.messages import Commands
from craftsim.robots.server import Channel, Inbox, Network
from craftsim.skills.skill import Command


def drained(network: Network, seed: int, n: int = 400) -> list[tuple[float, int]]:
    channel = Channel(network, np.random.default_rng(seed))
    for number in range(n):
        channel.send(0.02 * number, number)
    found = []
    while channel.due_s < np.inf:
        at_s = channel.due_s
        found += [(at_s, number) for number in channel.due(at_s)]
    return found


def test_a_network_is_late_loses_and_lets_overtake_as_it_is_told():
    network = Network(0.03, 0.025, 0.1)
    found = drained(network, 0)
    late = [at_s - 0.02 * number for at_s, number in found]
    assert 0.005 <= min(late) < 0.01 < 0.05 < max(late) <= 0.055
    assert 0.05 < 1 - len(found) / 400 < 0.15
    numbers = [number for _, number in found]
    assert numbers != sorted(numbers)
    assert found == drained(network, 0) != drained(network, 1)


def test_a_network_that_cannot_be_is_refused():
    for figures in ((0.01, 0.02, 0.0), (-0.1, 0.0, 0.0), (0.0, 0.0, 1.5), (11.0, 0.0, 0.0)):
        with pytest.raises(InputError, match="allowed: "):
            Network(*figures)


def message(number: int, at_s: float) -> Commands:
    return Commands(number, at_s, (Command((float(number),) * 4),))


def test_commands_wait_for_their_time_and_the_newest_is_obeyed():
    inbox = Inbox()
    assert inbox.obey(0.0) is None
    assert inbox.take(message(2, 0.04), 0.01)
    assert inbox.take(message(1, 0.02), 0.01)  # overtaken, and still in time
    assert not inbox.take(message(2, 0.04), 0.01)  # a copy
    assert inbox.obey(0.0) is None
    assert inbox.obey(0.02).number == 1
    assert inbox.take(message(4, 0.03), 0.04)  # too late for its time
    assert inbox.obey(0.04).number == 4
    assert not inbox.take(message(3, 0.05), 0.05)  # after a newer one has begun
    assert inbox.dropped == 1
    assert inbox.obey(0.06).number == 4
    assert (inbox.heard, inbox.late_s) == (4, pytest.approx(0.01))


def test_commands_from_afar_in_time_or_without_end_are_dropped():
    inbox = Inbox()
    assert not inbox.take(message(1, 5.0), 0.0)
    assert sum(inbox.take(message(number, 0.5), 0.0) for number in range(1, 1000)) == 64
    assert inbox.obey(0.05) is None


@pytest.mark.parametrize("last_s", [0.0, 0.013])
def test_without_a_command_for_100_ms_robots_stop_until_one_comes(last_s):
    inbox = Inbox()
    inbox.take(message(1, 0.0), last_s)
    obeyed = {round(0.02 * k, 2): inbox.obey(0.02 * k) for k in range(1, 10)}
    stopped_s = min(at_s for at_s, commands in obeyed.items() if commands is None)
    assert 0.1 <= stopped_s - last_s < 0.12
    assert inbox.stops == 1
    inbox.take(message(2, 0.2), 0.2)
    assert inbox.obey(0.2).number == 2


def car(**values) -> CarMeasurement:
    still = CarMeasurement(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, (0.0,) * 4, 0.0, 0.0, None, None)
    return still._replace(**values)


def test_an_extrapolation_goes_on_as_the_commands_say():
    machine = NOMINAL.car(0)
    prediction = Extrapolation(machine, NOMINAL, 0.02)
    droop = machine.gear_friction_nm / machine.wheel_gain_nms_rad
    ahead = Command((10.0 + droop,) * 4, 0.05, -0.3)
    found = prediction.after(car(heading=np.pi / 2, slope=0, hinge_rad=1.0), [ahead] * 5)
    way_m = 10.0 * machine.wheel_radius_m * 0.1
    assert (found.x, found.y) == pytest.approx((0.0, way_m))
    assert found.wheel_speeds == pytest.approx((50.0,) * 4)  # of five periods at once
    prediction.note(found._replace(wheel_speeds=(10.0,) * 4), ahead)
    later = prediction.since(found)
    assert later.wheel_speeds == pytest.approx((10.0,) * 4)
    assert prediction.after(later, [ahead] * 5).wheel_speeds == pytest.approx((10.0,) * 4)
    assert (found.board_m, found.hinge_rad) == pytest.approx((0.005, 0.97))
    up = prediction.after(car(board_m=0.044), [ahead] * 5)
    assert (up.board_m, up.hinge_rad) == (pytest.approx(machine.board_travel_m), None)
    assert (
        Extrapolation(machine, NOMINAL, 0.02).after(found, [])._replace(wheel_speeds=(50.0,) * 4)
        == found
    )


def test_no_period_counts_twice_and_none_is_left_out():
    prediction = Extrapolation(NOMINAL.car(0), NOMINAL, 0.02)
    newest = car(wheel_speeds=(4.0,) * 4)
    prediction.note(newest, Command())
    prediction.note(newest, Command(), periods=2)
    first, again = prediction.since(newest), prediction.since(newest)
    assert (first.wheel_speeds, first.fresh) == ((12.0,) * 4, True)
    assert (again.wheel_speeds, again.fresh) == ((0.0,) * 4, False)


def test_an_extrapolation_learns_how_far_wheels_lag_behind():
    prediction = Extrapolation(NOMINAL.car(0), NOMINAL, 0.02)
    told = Command((5.0,) * 4)
    for _ in range(100):
        prediction.note(car(wheel_speeds=(4.0,) * 4), told)
    prediction.after(car(), [told])
    assert prediction.after(car(), [told] * 2).wheel_speeds == pytest.approx((4.0,) * 4, abs=1e-3)


@pytest.mark.parametrize("lag_s", [0.005, 0.02, 0.05])
def test_an_extrapolation_learns_the_lag_of_motors(lag_s):
    # With that of the command alone, speeds that alternate were doubled, and cars shook behind a network.
    machine = NOMINAL.car(0)
    prediction = Extrapolation(machine, NOMINAL, 0.02)
    droop = machine.gear_friction_nm / machine.wheel_gain_nms_rad
    share = 1 - np.exp(-0.02 / lag_s)
    servo = 0.0
    rng = np.random.default_rng(0)
    for _ in range(200):
        told = 12.0 + rng.uniform(-3.0, 3.0)
        servo += share * (told - servo)
        prediction.note(car(wheel_speeds=(servo - droop,) * 4), Command((told,) * 4))
    prediction.after(car(), [])
    ahead_m = prediction.after(car(), [Command((6.0,) * 4)] * 2).x
    expected = sum(6.0 + (servo - 6.0) * (1 - share) ** n - droop for n in (1, 2))
    assert ahead_m == pytest.approx(expected * machine.wheel_radius_m * 0.02, rel=0.05)


def test_a_real_clock_keeps_to_its_periods_and_does_not_catch_up():
    now = [0.0]

    def sleep(duration_s: float) -> None:
        now[0] += duration_s

    clock = RealClock(0.02, lambda: now[0], sleep)
    now[0] += 0.005
    clock.wait()
    assert now[0] == pytest.approx(0.02)
    now[0] += 0.05
    clock.wait()
    assert (now[0], clock.overruns) == (pytest.approx(0.07), 1)
    clock.wait()
    assert now[0] == pytest.approx(0.09)

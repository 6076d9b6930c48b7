"""The incline at which a braked car starts to slide.

MuJoCo's friction is regularised: a car that holds still creeps, by up to a few mm/s. It slides when it has passed
20 mm/s after a second on the incline, which an incline 1 % too steep already makes it do.
"""

import math

import pytest

CASES = ((0.8, 0.0), (0.4, math.pi), (0.8, math.pi / 2))
"""Friction, and the direction from the car's nose in which its floor falls."""


def sliding_angle(car, threshold, downhill: float, seconds: float = 1.0) -> float:
    def slides(angle: float) -> bool:
        car.rest()
        car.tilt(angle, downhill)
        car.run(seconds, [0.0] * 4)
        return car.speed > 0.02

    return threshold(slides, 0.1, 0.9)


@pytest.mark.parametrize(("mu", "downhill"), CASES)
def test_with_wheels_and_rollers_braked_the_car_slides_at_the_friction_angle(
    lone_car, threshold, mu, downhill
):
    """Coulomb: m g sin(a) = mu m g cos(a), so a = atan(mu), in every direction. Band: 2 %."""
    lone_car.baseline.geom_friction[:, 0] = mu
    lone_car.baseline.dof_frictionloss[[*lone_car.wheels, *lone_car.rollers]] = 50.0
    assert sliding_angle(lone_car, threshold, downhill) == pytest.approx(math.atan(mu), rel=0.02)


@pytest.mark.parametrize(("mu", "downhill"), CASES)
@pytest.mark.parametrize(("drive", "seconds", "band"), [("rollers", 1.0, 0.02), ("reduced", 2.0, 0.03)])
def test_with_free_rollers_only_the_force_along_their_axes_holds_the_car(
    make_car, threshold, mu, downhill, drive, seconds, band
):
    """The real car's brakes hold the wheels, never the rollers. Band: 2 % of atan(mu cos 45 deg), 3 % without rollers.

    A free roller carries force only along its axis, at most mu N. The axes lie at 45 degrees to the fall line, be it
    along the car or across, and the parts beside that line cancel in pairs: mu m g cos(a) cos(45 deg) = m g sin(a).
    The rollers' bearings, which add 2 N, are oiled here.
    """
    car = make_car(drive)
    car.baseline.geom_friction[:, 0] = mu
    car.baseline.dof_frictionloss[car.rollers] = 0
    car.set_gears(50.0 if drive == "rollers" else 1.0)
    expected = math.atan(mu * math.cos(math.pi / 4))
    assert sliding_angle(car, threshold, downhill, seconds) == pytest.approx(expected, rel=band)

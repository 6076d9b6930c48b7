"""Logs of cars whose figures are hidden."""

from dataclasses import replace

from craftsim import Machines, SmartcarParameters
from craftsim.checking.setup import RANDOMIZE, Seed, setup_of
from craftsim.tuning.excitation import Area, drive, excitation, free_area

HIDDEN = {
    "smartcar.wheel_radius_m": 0.0492,
    "smartcar.gear_friction_nm": 0.36,
    "smartcar.board_mass_kg": 0.12,
    "noise.delay_s": 0.047,
    "noise.motor_lag_s": 0.025,
}
NOMINAL = Machines(drive="wheels")


def log_of(hidden, time_s, noise=RANDOMIZE["mild"].sensors, seed=0):
    car = {
        key.partition(".")[2]: value for key, value in hidden.items() if key.startswith("smartcar.")
    }
    delay_s, lag_s = hidden.get("noise.delay_s", 0.0), hidden.get("noise.motor_lag_s", 0.0)
    noise = replace(noise, min_delay_s=delay_s, max_delay_s=delay_s, motor_lag_s=lag_s)
    machines = Machines(cars=(SmartcarParameters(**car),), drive="wheels")
    setup = setup_of(machines=machines, noise=noise)
    commands = excitation(time_s, Area(), NOMINAL.car(0), 0.02)
    return drive(free_area(Area()), setup, Seed((seed,)), commands).log

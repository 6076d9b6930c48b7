"""The contact law beside tosses of a real cube: each is simulated from its first recorded state.

Errors are those of Acosta, Yang and Posa, "Validating Robotics Simulators on Real-World Impacts" (2022): means along a
toss of the distance in widths of the cube, and of the angle between orientations.

The recorded velocities are differences to the row before. They are taken as they are; what it changes to take them as
of half a row before, to start from the velocities of the whole flight, on a board where the cubes came to rest, and in
shorter steps are checks beside it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any, Final

import mujoco
import numpy as np

from craftsim.compiled.arrays import Floats
from craftsim.errors import InputError
from craftsim.mjcf.building import TOUCHES, new_world, surface
from craftsim.mjcf.parameters import GRAVITY, ContactParameters
from craftsim.models.config import SimulationConfig
from craftsim.reality.recordings import CubeParameters, Tosses
from craftsim.reality.resampling import draws, estimate_of, interval_of

FITTED_TO: Final = 100
"""Tosses that a law is fitted to, or half of fewer than twice as many."""
_CORNERS: Final = np.array([*product((-1.0, 1.0), repeat=3)])
_TOGETHER: Final = 32
"""Tosses of similar length that are simulated as one batch."""
_MOST_THREADS: Final = 4
_FLIGHT_CLEARANCE: Final = 0.1
"""Half widths above the board from which on a cube flies."""
_FEWEST_FLYING: Final = 6
"""Rows of a flight whose velocities say more than those of its first row."""

_SEARCHED: Final = {
    "ground_friction": (0.05, 1.0),
    "damping_ratio": (0.4, 4.0),
    "time_constant_s": (0.0075, 0.03),
    "impedance_min": (0.5, 0.98),
    "impedance_depth_m": (2e-4, 3e-3),
}
"""What is fitted, between which values, all on a logarithmic scale. A time constant is two steps or more."""
_FIRST_LOOK: Final = 128
"""Laws that are tried all over the range, a power of two."""
_REFINED: Final = 2
"""The best of them from which the search goes on, besides the measured friction in the law as it is."""
_STEPS: Final = 100
"""Laws that are tried from each."""
_SPREAD: Final = 0.15
"""Size of the search's first simplex as a share of the range."""
_LOST: Final = 1e3
"""The error of a simulation that breaks down."""
_ITSELF: Final = "the law against itself, starts as uncertain as recorded"
_FRICTION_SHARE: Final = 0.1
"""By what share of it a fitted friction has to differ, interval and all, to count."""


@dataclass(frozen=True)
class ContactLaw:
    """How a cube and a board touch."""

    name: str
    contact: ContactParameters
    of_mujoco: bool = False
    """With MuJoCo's default cone and ratio of friction to normal impedance, in place of craftsim's."""


def assumed_laws(cube: CubeParameters) -> list[ContactLaw]:
    """Return the laws that nothing was fitted for, with craftsim's assumed friction and with that of the pair."""
    ours = ContactParameters()
    defaults = ContactParameters(
        time_constant_s=0.02,
        impedance_min=0.9,
        impedance_max=0.95,
        impedance_depth_m=0.001,
        ground_friction=cube.friction,
    )
    measured = replace(ours, ground_friction=cube.friction)
    return [
        ContactLaw(f"craftsim, friction {ours.ground_friction:g} as assumed", ours),
        ContactLaw(f"craftsim, friction {cube.friction:g} as measured", measured),
        ContactLaw("MuJoCo's default stiffness", defaults),
        ContactLaw("MuJoCo's default stiffness and cone", defaults, of_mujoco=True),
    ]


def cube_model(cube: CubeParameters, law: ContactLaw, step_share: float = 1.0) -> mujoco.MjModel:
    """Return the model of a cube above a board, in steps of a whole part of a row; a share makes them shorter."""
    config = SimulationConfig()
    spec = new_world(law.contact, (0.0, 0.0, 0.05), (0.0, 0.0, 0.0), visual=False)
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    spec.option.iterations = config.solver_iterations
    spec.option.impratio = config.friction_impedance_ratio
    spec.option.timestep = 1 / cube.rate_hz / steps_per_row(cube, step_share)
    if law.of_mujoco:
        default = mujoco.MjSpec().option
        spec.option.cone = default.cone
        spec.option.impratio = default.impratio
    body = spec.worldbody.add_body(name="cube")
    body.add_freejoint()
    body.explicitinertial = True
    body.mass = cube.mass_kg
    body.inertia = [cube.inertia_kgm2] * 3
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[cube.half_width_m] * 3,
        **TOUCHES["things"],
        **surface(law.contact, law.contact.ground_friction),
    )
    model: mujoco.MjModel = spec.compile()
    return model


def steps_per_row(cube: CubeParameters, step_share: float = 1.0) -> int:
    """Return the physics steps of a row: as long as craftsim's, or a little shorter."""
    return math.ceil(1 / cube.rate_hz / (SimulationConfig().timestep_s * step_share) - 1e-9)


def simulate_tosses(
    model: mujoco.MjModel, starts: Floats, lengths: Sequence[int], steps: int
) -> list[Floats]:
    """Return position and quaternion, (n, 7), of each toss from its first state, (tosses, 13), each so many steps."""
    from mujoco import rollout

    n_qpos = 7
    first = np.column_stack([np.zeros(len(starts)), starts])
    poses: list[Floats] = [np.zeros((0, n_qpos))] * len(starts)
    order = np.argsort(lengths, kind="stable")
    data = [mujoco.MjData(model) for _ in range(_threads())]
    for begin in range(0, len(order), _TOGETHER):
        batch = order[begin : begin + _TOGETHER]
        longest = max(lengths[toss] for toss in batch)
        states, _ = rollout.rollout(
            model, data, initial_state=first[batch], nstep=(longest - 1) * steps
        )
        for toss, motion in zip(batch, states, strict=True):
            rows = motion[steps - 1 :: steps][: lengths[toss] - 1, 1 : 1 + n_qpos]
            poses[toss] = np.vstack([starts[toss, :n_qpos], rows])
    return poses


def _threads() -> int:
    """Return the number of threads of a batch; results do not depend on it."""
    return min(_MOST_THREADS, len(os.sched_getaffinity(0)))


def toss_errors(tosses: Sequence[Floats], poses: Sequence[Floats], width_m: float) -> Floats:
    """Return the mean errors of each toss, (n, 2): position in widths of the cube, and rotation in radians."""
    errors = np.zeros((len(tosses), 2))
    for number, (recorded, simulated) in enumerate(zip(tosses, poses, strict=True)):
        distance = np.linalg.norm(recorded[1:, :3] - simulated[1:, :3], axis=1)
        along = np.abs((recorded[1:, 3:7] * simulated[1:, 3:7]).sum(axis=1))
        lengths = np.linalg.norm(recorded[1:, 3:7], axis=1)
        angle = 2 * np.arccos(np.clip(along / lengths, 0.0, 1.0))
        errors[number] = distance.mean() / width_m, angle.mean()
    return np.where(np.isfinite(errors), errors, _LOST)


def law_errors(
    tosses: Tosses, law: ContactLaw, starts: Floats | None = None, step_share: float = 1.0
) -> Floats:
    """Return the errors, (n, 2), of a law on tosses, from other first states than the recorded ones if given."""
    cube = tosses.cube
    if starts is None:
        starts = recorded_starts(tosses)
    poses = simulate_tosses(
        cube_model(cube, law, step_share),
        starts,
        [len(states) for states in tosses.states],
        steps_per_row(cube, step_share),
    )
    return toss_errors(tosses.states, poses, 2 * cube.half_width_m)


def recorded_starts(tosses: Tosses) -> Floats:
    """Return the first state of each toss, (n, 13)."""
    return np.array([states[0] for states in tosses.states])


def heights(cube: CubeParameters, states: Floats) -> Floats:
    """Return the height in metres of the lowest corner, (n,), in states (n, 13)."""
    w, x, y, z = states[:, 3:7].T
    up = np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    lowest: Floats = (up @ _CORNERS.T).min(axis=1)
    return states[:, 2] + cube.half_width_m * lowest


def flight_starts(tosses: Tosses) -> Floats:
    """Return first states, (n, 13), with the velocities of the whole flight up to the first touch.

    A cube with equal inertias turns with one velocity, and its centre falls; shorter flights keep what was recorded.
    """
    cube = tosses.cube
    starts = recorded_starts(tosses)
    for start, states in zip(starts, tosses.states, strict=True):
        low = heights(cube, states) < _FLIGHT_CLEARANCE * cube.half_width_m
        rows = int(np.argmax(low)) if low.any() else len(states)
        if rows < _FEWEST_FLYING:
            continue
        time_s = np.arange(rows) / cube.rate_hz
        positions = states[:rows, :3].copy()
        positions[:, 2] += GRAVITY * time_s**2 / 2
        start[7:10] = np.polyfit(time_s, positions, 1)[0]
        start[10:13] = states[1:rows, 10:13].mean(axis=0)
    return starts


def resting_height_m(tosses: Tosses) -> float:
    """Return the height above the board's plane of the lowest corners at the end of tosses, in the middle."""
    last = np.array([states[-1] for states in tosses.states])
    return float(np.median(heights(tosses.cube, last)))


def checks(tosses: Tosses, law: ContactLaw, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Return what a law's errors become where the recording is read in another way."""
    cube = tosses.cube
    # Semi-implicit Euler integrates positions with the velocity after the step: velocities lag by half a step.
    row_s = 1 / cube.rate_hz
    step_s = row_s / steps_per_row(cube)
    before = recorded_starts(tosses)
    before[:, 9] -= GRAVITY * (row_s - step_s) / 2
    flying = flight_starts(tosses)
    in_flight = flying.copy()
    in_flight[:, 9] += GRAVITY * step_s / 2
    shifted = []
    for states in tosses.states:
        moved = states.copy()
        moved[:, 2] -= resting_height_m(tosses)
        shifted.append(moved)
    errors = {
        "velocities taken as of half a row before": law_errors(tosses, law, before),
        "velocities of the whole flight": law_errors(tosses, law, in_flight),
        "board where the cubes came to rest": law_errors(
            replace(tosses, states=tuple(shifted)), law
        ),
        "steps of a quarter": law_errors(tosses, law, step_share=0.25),
    }
    rows = [{"reading": name, **_figures(values, rng)} for name, values in errors.items()]
    rows.append({"reading": _ITSELF, **_figures(_against_itself(tosses, law, flying, rng), rng)})
    return rows


def _against_itself(
    tosses: Tosses, law: ContactLaw, flying: Floats, rng: np.random.Generator
) -> Floats:
    """Return the errors of a law beside itself, from starts whose velocities differ as much as recorded ones.

    That is by how much those of the first row scatter around those of the flight.
    """
    cube = tosses.cube
    starts = recorded_starts(tosses)
    noise = (starts - flying)[:, 7:13].std(axis=0)
    disturbed = starts.copy()
    disturbed[:, 7:13] += rng.normal(0.0, 1.0, (len(starts), 6)) * noise
    lengths = [len(states) for states in tosses.states]
    model = cube_model(cube, law)
    steps = steps_per_row(cube)
    exact = simulate_tosses(model, starts, lengths, steps)
    return toss_errors(
        exact, simulate_tosses(model, disturbed, lengths, steps), 2 * cube.half_width_m
    )


@dataclass(frozen=True, eq=False)
class LawFit:
    """A law that was fitted to tosses."""

    law: ContactLaw
    candidates: Floats
    """(laws, parameters) that were tried, in the order of ``_SEARCHED``."""
    errors: Floats
    """(laws, tosses): mean position error of each."""

    def intervals(self, rng: np.random.Generator) -> dict[str, Any]:
        """Return each parameter with its interval: that of the best of the laws that were tried, on other samples."""
        means = np.array(
            [self.errors[:, sample].mean(axis=1) for sample in draws(self.errors.shape[1], rng)]
        )
        best = self.candidates[means.argmin(axis=1)]
        chosen = self.candidates[self.errors.mean(axis=1).argmin()]
        return {
            name: interval_of(chosen[column], best[:, column])
            for column, name in enumerate(_SEARCHED)
        }


def fit_law(tosses: Tosses, seed: int, tell: Callable[[str, int], None]) -> LawFit:
    """Fit friction, damping ratio, time constant and impedance to the mean position error on tosses.

    A look all over the range by a Sobol sequence, then simplex searches (Nelder and Mead) from its best and from
    craftsim's law with the measured friction.
    """
    from scipy.optimize import minimize
    from scipy.stats import qmc

    low, high = np.log([*_SEARCHED.values()]).T
    candidates: list[Floats] = []
    errors: list[Floats] = []

    def cost(point: Floats) -> float:
        inside = np.clip(point, low, high)
        law = _law_at(np.exp(inside))
        candidates.append(np.exp(inside))
        errors.append(law_errors(tosses, law)[:, 0])
        tell("contact law", len(errors))
        # Beyond the border it rises, so that the search turns back.
        return float(errors[-1].mean()) + float(np.abs(point - inside).sum())

    look = qmc.scale(qmc.Sobol(len(low), rng=seed).random(_FIRST_LOOK), low, high)
    costs = [cost(point) for point in look]
    ours = asdict(ContactParameters(ground_friction=tosses.cube.friction))
    begins = [look[place] for place in np.argsort(costs)[:_REFINED]]
    begins.append(np.clip(np.log([ours[name] for name in _SEARCHED]), low, high))
    for begin in begins:
        corners = [begin]
        for axis in np.eye(len(low)):
            step = _SPREAD * (high - low) * axis
            outside = (begin + step > high).any()
            corners.append(begin - step if outside else begin + step)
        minimize(
            cost,
            begin,
            method="Nelder-Mead",
            options={"maxfev": _STEPS, "initial_simplex": np.array(corners)},
        )
    tried = np.array(errors)
    best = np.array(candidates)[tried.mean(axis=1).argmin()]
    return LawFit(_law_at(best), np.array(candidates), tried)


def _law_at(values: Floats) -> ContactLaw:
    """Return the law with the values of what is fitted."""
    contact = ContactParameters(**dict(zip(_SEARCHED, map(float, values), strict=True)))
    return ContactLaw("fitted", contact)


def _figures(errors: Floats, rng: np.random.Generator) -> dict[str, Any]:
    """Return the mean errors, (n, 2), with intervals over tosses."""
    return {
        "position_widths": estimate_of(errors[:, 0], rng),
        "rotation_deg": estimate_of(np.degrees(errors[:, 1]), rng),
    }


def evaluate_tosses(tosses: Tosses, seed: int, tell: Callable[[str, int], None]) -> dict[str, Any]:
    """Return what tosses say of the contact law: a law is fitted to some, and all are tested on the others.

    Raises InputError for tosses that do not fall under gravity onto the board.
    """
    rng = np.random.default_rng(seed)
    cube = tosses.cube
    if abs(resting_height_m(tosses)) > cube.half_width_m:
        raise InputError(
            f"{tosses.name}: the cubes end {resting_height_m(tosses):.3g} m above the board; allowed: at most half a "
            "width above or below z = 0"
        )
    n = len(tosses.states)
    order = rng.permutation(n)
    n_fitted = min(FITTED_TO, n // 2)
    fitted_to = _some(tosses, order[:n_fitted])
    held_out = _some(tosses, order[n_fitted:])
    fit = fit_law(fitted_to, seed, tell)
    laws = [*assumed_laws(cube), fit.law]
    rows = []
    errors = {}
    for law in laws:
        errors[law.name] = law_errors(held_out, law)
        rows.append({"law": law.name, **_contact(law), **_figures(errors[law.name], rng)})
    measured = laws[1].name
    for row in rows:
        change = errors[row["law"]][:, 0] - errors[measured][:, 0]
        row["more_than_measured"] = estimate_of(change, rng)
    intervals = fit.intervals(rng)
    friction = intervals["ground_friction"]
    return {
        "fitted_to": n_fitted,
        "tested_on": n - n_fitted,
        "laws": rows,
        "fitted": intervals,
        "friction": {
            "declared": cube.friction,
            "fitted": friction,
            "differs": _is_outside(friction, cube.friction),
        },
        "checks": checks(held_out, laws[1], rng),
        "resting_height_widths": resting_height_m(tosses) / cube.half_width_m / 2,
    }


def _is_outside(estimate: Any, declared: float) -> bool:
    """Return whether an interval lies beyond a declared friction, and further than measurements of one scatter."""
    low = estimate.value if estimate.low is None else estimate.low
    high = estimate.value if estimate.high is None else estimate.high
    return bool(high < (1 - _FRICTION_SHARE) * declared or low > (1 + _FRICTION_SHARE) * declared)


def _contact(law: ContactLaw) -> dict[str, float]:
    values = asdict(law.contact)
    return {name: values[name] for name in _SEARCHED}


def _some(tosses: Tosses, numbers: np.ndarray) -> Tosses:
    """Return some of the tosses, in their order."""
    return replace(tosses, states=tuple(tosses.states[number] for number in np.sort(numbers)))

"""Which textbook integrator is this engine? Its trajectories tell.

A method is run on several scenarios at several steps and compared, state by state, with every known
integrator in float64. Where its positions are those of one integrator to round-off, that is what it
is, whatever its manual says. The velocity that it reports is compared separately, since it may belong
to another time than the position: half a kick earlier or later, or a whole step.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from umbra_bench.analysis.identity import undamped
from umbra_bench.errors import UmbraBenchError, UnsupportedScenario
from umbra_bench.integrators import INTEGRATORS, Integrator, kick
from umbra_bench.methods import find_method
from umbra_bench.metrics import gyration, position_distance, velocity_distance
from umbra_bench.scenario import Scenario, load_scenario
from umbra_bench.simulation import simulate
from umbra_bench.state import State
from umbra_bench.system import System, build_system, initial_state
from umbra_bench.umbra.bodies import Array

SCENARIOS = ("spring", "elastic_pendulum", "orbit_eccentric", "torsion_spring")
"""Where methods are told apart unless the user names others: linear, nonlinear, turning."""

FRACTIONS = (1.0, 0.25, 0.0625)
"""The steps of a comparison, as parts of the longest."""

STEPS = 60
"""How many steps are compared: enough to tell methods apart, too few for rounding to grow."""

LONGEST = 0.25
"""The longest step over the time in which the initial acceleration undoes the initial velocity."""

NUDGE = 1e-9
"""By how much a start is moved, relatively, to see how the motion magnifies rounding."""

MATCH = 5.0 * STEPS
"""Units of round-off within which two trajectories are one: a few of them in every step."""


def drift_kick(system: System, state: State, dt: Array) -> State:
    """x += v dt; then v += a(x, v) dt at the new x. Order 1, symplectic: the other order of the two.

    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration, I.1.2.
    """
    x = state.position + state.velocity * dt
    return State(x, kick(system, x, state.velocity, dt))


def drift_kick_drift(system: System, state: State, dt: Array) -> State:
    """x += v dt/2; v += a(x) dt; x += v dt/2. Order 2, symmetric, symplectic: position Verlet."""
    x = state.position + state.velocity * (dt / 2)
    v = kick(system, x, state.velocity, dt)
    return State(x + v * (dt / 2), v)


def midpoint(system: System, state: State, dt: Array) -> State:
    """The explicit midpoint rule. Order 2.

    Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.1.
    """
    x, v = state
    half_x, half_v = x + v * (dt / 2), v + system.acceleration(x, v) * (dt / 2)
    return State(x + half_v * dt, v + system.acceleration(half_x, half_v) * dt)


def heun(system: System, state: State, dt: Array) -> State:
    """Heun's method. Order 2. Source: ditto."""
    x, v = state
    a = system.acceleration(x, v)
    end_v = v + a * dt
    end_a = system.acceleration(x + v * dt, end_v)
    return State(x + (v + end_v) * (dt / 2), v + (a + end_a) * (dt / 2))


def taylor(system: System, state: State, dt: Array) -> State:
    """x += v dt + a dt^2/2; v += a dt: exact for a constant force, of order 1 otherwise."""
    x, v = state
    a = system.acceleration(x, v)
    return State(x + v * dt + a * (dt * dt / 2), v + a * dt)


CANDIDATES: dict[str, tuple[str, Integrator]] = {
    "explicit-euler": ("explicit Euler", INTEGRATORS["explicit-euler"]),
    "semi-implicit-euler": (
        "semi-implicit Euler, velocity first",
        INTEGRATORS["semi-implicit-euler"],
    ),
    "drift-kick": ("semi-implicit Euler, position first", drift_kick),
    "taylor": ("x += v dt + a dt²/2, v += a dt", taylor),
    "velocity-verlet": ("velocity Verlet", INTEGRATORS["velocity-verlet"]),
    "drift-kick-drift": ("position Verlet", drift_kick_drift),
    "midpoint": ("the midpoint rule", midpoint),
    "heun": ("Heun's method", heun),
    "rk4": ("Runge-Kutta 4", INTEGRATORS["rk4"]),
    "yoshida4": ("Yoshida 4", INTEGRATORS["yoshida4"]),
}
"""Every known integrator, and what to call it."""

_READINGS: dict[
    str, tuple[str, Callable[[np.ndarray, np.ndarray, np.ndarray, float], np.ndarray]]
] = {
    "same-time": ("belongs to the same time as the position", lambda x, v, a, dt: v[1:]),
    "half-kick-early": (
        "lags the position: it is the one half a kick earlier",
        lambda x, v, a, dt: v[1:] - a[:-1] * (dt / 2),
    ),
    "half-kick-late": (
        "leads the position: it is the one half a kick later",
        lambda x, v, a, dt: v[1:] + a[1:] * (dt / 2),
    ),
    "half-kick-early-here": (
        "lags the position: it is the one half a kick earlier",
        lambda x, v, a, dt: v[1:] - a[1:] * (dt / 2),
    ),
    "step-early": ("lags the position by a step", lambda x, v, a, dt: v[:-1]),
}
"""To which time a reported velocity can belong, from an integrator's own x, v and a(x, v)."""


class Comparison(NamedTuple):
    """A method against one candidate over all runs, in units of round-off, the largest of each.

    Attributes:
        candidate: a name in :data:`CANDIDATES`.
        position: the distance of the positions.
        reading, velocity: the time to which the velocity fits best, a name of `_READINGS`, and the
            distance of the velocities then.
    """

    candidate: str
    position: float
    reading: str
    velocity: float


class Identity(NamedTuple):
    """What a method was found to be.

    Attributes:
        runs: how many trajectories were compared.
        comparisons: all candidates, the nearest first.
    """

    method: str
    precision: str
    runs: int
    comparisons: list[Comparison]

    @property
    def matches(self) -> list[Comparison]:
        """The candidates whose positions are the method's, to round-off."""
        return [c for c in self.comparisons if c.position <= MATCH]

    @property
    def match(self) -> Comparison | None:
        """The only one, if there is one."""
        return self.matches[0] if len(self.matches) == 1 else None

    @property
    def integrator(self) -> str:
        """The answer in words."""
        names = [CANDIDATES[c.candidate][0] for c in self.matches]
        if not names:
            return "none of the known integrators"
        return names[0] if len(names) == 1 else f"cannot tell between {', '.join(names)}"

    @property
    def velocity(self) -> str:
        """To which time the reported velocity belongs, in words."""
        if self.match is None:
            return "not told"
        if not self.match.velocity <= MATCH:
            return "is that of no time that was tried"
        return _READINGS[self.match.reading][0]


def identify(method: str, scenarios: Sequence[Scenario] = ()) -> Identity:
    """Compare a method with all candidates.

    Args:
        method: a name of a method that takes steps.
        scenarios: where; by default :data:`SCENARIOS`. What depends on the velocity is left out.

    Raises:
        UmbraBenchError: a method that is unknown, missing or runs none of the scenarios.
    """
    if find_method(method).kind == "reference":
        raise UmbraBenchError(f"METHOD {method!r}: it takes no steps of its own")
    chosen = [s for s in scenarios or map(load_scenario, SCENARIOS) if undamped(s)]
    precision = find_method(method).precision or "float64"
    worst = {name: (0.0, dict.fromkeys(_READINGS, 0.0)) for name in CANDIDATES}
    runs, reason = 0, "they are damped"
    for scenario in chosen:
        for dt in _steps(scenario):
            try:
                found = simulate(scenario, method, dt, steps=STEPS, precision=precision)
            except UnsupportedScenario as error:
                reason = str(error)
                break
            runs += 1
            for name in CANDIDATES:
                position, readings = _distances(scenario, name, dt, found.position, found.velocity)
                unit = float(np.finfo(precision).eps)
                before, kept = worst[name]
                worst[name] = (
                    max(before, position / unit),
                    {key: max(kept[key], readings[key] / unit) for key in kept},
                )
    if not runs:
        raise UmbraBenchError(f"METHOD {method!r}: it runs none of the scenarios: {reason}")
    comparisons = []
    for name, (position, readings) in worst.items():
        reading = next(
            (key for key in readings if readings[key] <= MATCH),
            min(readings, key=lambda key: readings[key]),
        )
        comparisons.append(Comparison(name, position, reading, readings[reading]))
    return Identity(method, precision, runs, sorted(comparisons, key=lambda c: c.position))


def _steps(scenario: Scenario) -> list[float]:
    """The steps of a comparison, s: from long enough to tell methods apart."""
    system, start = build_system(scenario), initial_state(scenario)
    with np.errstate(all="ignore"):
        acceleration = np.abs(system.acceleration(*start)[:2]).max()
        speed = np.hypot(*start.velocity[:2]).max()
    pace = acceleration / speed if speed > 0.0 and acceleration > 0.0 else 1.0
    longest = min(LONGEST / pace, 2 * scenario.dt.start)
    # Powers of two, which float32 holds as float64 does.
    return [2.0 ** round(math.log2(longest * fraction)) for fraction in FRACTIONS]


def _distances(
    scenario: Scenario, candidate: str, dt: float, position: np.ndarray, velocity: np.ndarray
) -> tuple[float, dict[str, float]]:
    """The largest distances from a candidate's trajectory, over the motion's size and sensitivity."""
    document = scenario.model_dump_json()
    x, v, a = _trajectory(document, candidate, dt, 0.0)
    nudged_x, nudged_v, _ = _trajectory(document, candidate, dt, NUDGE)
    radius = gyration(build_system(scenario).bodies)
    size = max(float(np.abs(x[:, :2]).max()), float((np.pi * radius).max()), 1e-300)
    speed = max(float(velocity_distance(v[1:], np.zeros_like(v[1:]), radius).max()), 1e-300)
    with np.errstate(all="ignore"):
        # What an error of one unit at the start becomes: rounding cannot do less.
        place_growth = float(position_distance(nudged_x, x, radius).max()) / size / NUDGE
        speed_growth = float(velocity_distance(nudged_v, v, radius).max()) / speed / NUDGE
        apart = float(position_distance(position, x, radius).max()) / size
        readings = {
            name: float(velocity_distance(velocity[1:], read(x, v, a, dt), radius).max())
            / (speed * max(speed_growth, 1.0))
            for name, (_, read) in _READINGS.items()
        }
    return apart / max(place_growth, 1.0), readings


@functools.lru_cache(maxsize=4096)
def _trajectory(
    document: str, candidate: str, dt: float, nudge: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and accelerations of a candidate, float64, shape (STEPS + 1, 3, N)."""
    scenario = Scenario.model_validate_json(document)
    system, start = build_system(scenario), initial_state(scenario)
    state = State(start.position * (1.0 + nudge), start.velocity * (1.0 - nudge))
    step = CANDIDATES[candidate][1]
    states, accelerations = [], []
    with np.errstate(all="ignore"):
        for n in range(STEPS + 1):
            states.append(state)
            accelerations.append(system.acceleration(*state))
            if n < STEPS:
                state = step(system, state, np.float64(dt))
    return (
        np.stack([s.position for s in states]),
        np.stack([s.velocity for s in states]),
        np.stack(accelerations),
    )

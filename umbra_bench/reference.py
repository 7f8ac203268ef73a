"""The truth: a high-order solution in float64, and the certificate of how true it is.

Diffrax's Dopri8 under a PID controller with a tolerance at the edge of float64, in legs from one
sample time to the next so that no interpolation enters. Exponential damping is its continuous limit,
dv/dt = a + ln(d) v. Before anything is measured against the solution it is compared with a second
solution at another tolerance and with an independent one: the closed form where physics has one,
SciPy's DOP853 otherwise. The larger distance is the certified bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import scipy.integrate

from umbra_bench.closed_form import solve_closed_form
from umbra_bench.compiled import Observables, observe
from umbra_bench.errors import UmbraBenchError
from umbra_bench.jax_settings import float64_allowed
from umbra_bench.metrics import gyration, position_distance, velocity_distance
from umbra_bench.scenario import Scenario
from umbra_bench.state import inertial_mass
from umbra_bench.system import System, build_system, initial_state

TOLERANCE = 1e-14
COARSER_TOLERANCE = 1e-13
DOP853_TOLERANCE = 1e-13
MAXIMUM_STEPS_PER_LEG = 16_384
CONSTANT = 1e-9
"""A quantity of the reference that varies by less than this, relative to its scale, is conserved."""


class Scales(NamedTuple):
    """What errors are relative to: the largest values along the reference, never zero.

    Attributes:
        length: the largest distance from the start, m.
        speed: the largest speed, m/s.
        energy: the largest kinetic energy, or the range of the potential energy if that is larger
            (bodies that barely move), J. Unlike the total energy it has no arbitrary zero.
        angular_momentum: the largest sum of the bodies' unsigned angular momenta, N m s.
    """

    length: float
    speed: float
    energy: float
    angular_momentum: float


class Certificate(NamedTuple):
    """How far the reference can be from the truth.

    Attributes:
        position, velocity, energy: certified bounds of the errors, m, m/s, J/J.
        independent: what the reference was compared with.
        independent_difference: its largest distance from that, relative to the length scale.
        tolerance_difference: its largest distance from the solution at a coarser tolerance, ditto.
        energy_drift: largest change of the energy over the energy scale; None where physics lets it
            change. angular_momentum_drift, momentum_drift: ditto for the momenta.
    """

    position: float
    velocity: float
    energy: float
    independent: str
    independent_difference: float
    tolerance_difference: float
    energy_drift: float | None
    angular_momentum_drift: float | None


@dataclass(frozen=True)
class Reference:
    """The certified solution of a scenario at its sample times.

    Attributes:
        times: shape (S + 1,), s, from 0 to the duration.
        position, velocity: shape (S + 1, 3, N), float64; angles are not wrapped.
        observables: energy and momenta, shape (S + 1,) each.
        radius: the bodies' radii of gyration, shape (N,), m.
    """

    times: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    observables: Observables
    radius: np.ndarray
    scales: Scales
    certificate: Certificate

    def conserves(self, name: str) -> bool:
        """Whether the observable `name` ("energy" or "angular_momentum") stays constant."""
        values = getattr(self.observables, name)
        return bool(np.ptp(values) <= CONSTANT * getattr(self.scales, name))


def sample_times(scenario: Scenario) -> np.ndarray:
    """The instants of comparison, s, shape (S + 1,)."""
    return scenario.duration * np.arange(scenario.samples + 1) / scenario.samples


def solve_reference(
    scenario: Scenario, times: np.ndarray, tolerance: float = TOLERANCE, first_step: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities at `times` (s, increasing, the first is the start), (T, 3, N) each.

    The solver first tries a step of `first_step` times the gap between two of the times.

    Raises:
        UmbraBenchError: the solver did not reach the end (a collision under gravity, say).
    """
    system, start = build_system(scenario), initial_state(scenario)
    unit = _units(start.position, start.velocity)
    with float64_allowed():
        scaled, complete = _solve(
            system, np.stack(start) / unit, unit, times, tolerance, first_step
        )
        if not (complete and np.isfinite(scaled).all()):
            raise UmbraBenchError(
                f"scenario {scenario.name}: the reference did not reach t = {float(times[-1])!r} s; "
                "allowed are motions without collisions or singularities"
            )
        solution = np.asarray(scaled) * unit
    return solution[:, 0], solution[:, 1]


@jax.jit
def _solve(
    system: System, start: Any, unit: Any, times: Any, tolerance: Any, first_step: Any
) -> Any:
    """Integrate (position, velocity) in units of their own size, shape (2, 3, N), leg by leg."""

    def field(_: Any, y: Any, __: Any) -> Any:
        return jnp.stack(derivative(system, *(y * unit))) / unit

    def solve_leg(y: Any, begin: Any, end: Any) -> Any:
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Dopri8(),
            t0=begin,
            t1=end,
            dt0=first_step * (end - begin),
            y0=y,
            saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            max_steps=MAXIMUM_STEPS_PER_LEG,
            throw=False,
        )
        return solution.ys[0], solution.result == diffrax.RESULTS.successful

    def leg(carry: Any, ends: Any) -> Any:
        y, complete = carry
        carry = jax.lax.cond(complete, solve_leg, lambda y, *_: (y, complete), y, *ends)
        return carry, carry[0]

    legs = jnp.stack([times[:-1], times[1:]], axis=1)
    (_, complete), ends = jax.lax.scan(leg, (start, jnp.array(True)), legs)
    return jnp.concatenate([start[None], ends]), complete


def derivative(system: System, position: Any, velocity: Any) -> tuple[Any, Any]:
    """dx/dt = v and dv/dt = a(x, v) + ln(d) v, the equations of motion that every method means."""
    acceleration = system.acceleration(position, velocity)
    if system.bodies.damping is not None:
        xp = velocity.__array_namespace__()
        acceleration = acceleration + xp.log(system.bodies.damping) * velocity
    return velocity, acceleration


def _units(position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Sizes of lengths and speeds, so that tolerances are relative; shape (2, 3, 1), never zero."""
    length = float(np.ptp(position[:2], axis=1).max()) or float(abs(position[:2]).max()) or 1.0
    speed = float(np.hypot(*velocity[:2]).max()) or length
    return np.array([[length, length, 1.0], [speed, speed, 1.0]])[:, :, None]


def solve_dop853(scenario: Scenario, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The independent solution: another method, another library, NumPy instead of JAX.

    Raises:
        UmbraBenchError: the solver did not reach the end.
    """
    system, start = build_system(scenario), initial_state(scenario)
    unit = _units(start.position, start.velocity)
    shape = (2, *start.position.shape)

    def field(_: float, y: np.ndarray) -> np.ndarray:
        return (np.stack(derivative(system, *(y.reshape(shape) * unit))) / unit).ravel()

    solution = scipy.integrate.solve_ivp(
        field,
        (times[0], times[-1]),
        (np.stack(start) / unit).ravel(),
        method="DOP853",
        t_eval=times,
        rtol=DOP853_TOLERANCE,
        atol=DOP853_TOLERANCE,
    )
    if not solution.success:
        raise UmbraBenchError(f"scenario {scenario.name}: DOP853 failed: {solution.message}")
    states = solution.y.T.reshape(-1, *shape) * unit
    return states[:, 0], states[:, 1]


def certified_reference(scenario: Scenario) -> Reference:
    """Solve a scenario at its sample times and certify the solution.

    Raises:
        UmbraBenchError: as :func:`solve_reference`.
    """
    times = sample_times(scenario)
    system = build_system(scenario)
    position, velocity = solve_reference(scenario, times)
    observables = observe_all(system, position, velocity)
    scales = _scales(system, position, velocity)
    radius = gyration(system.bodies)

    def distances(other: tuple[np.ndarray, np.ndarray]) -> tuple[float, float, float]:
        energy = observe_all(system, *other).energy
        return (
            float(position_distance(position, other[0], radius).max()),
            float(velocity_distance(velocity, other[1], radius).max()),
            float(abs(observables.energy - energy).max()) / scales.energy,
        )

    # Where one step bridges two samples at either tolerance, the two solutions would be one: the
    # second therefore starts each leg with another step.
    coarser = distances(solve_reference(scenario, times, COARSER_TOLERANCE, first_step=0.3))
    if scenario.closed_form is not None:
        independent = distances(solve_closed_form(scenario, times))
        bounds = independent
    else:
        independent = distances(solve_dop853(scenario, times))
        bounds = tuple(map(max, independent, coarser))  # type: ignore[assignment]
    # Below a few units of rounding no comparison can certify anything.
    rounding = 4 * np.finfo(float).eps
    size = float(abs(position[:, :2]).max()) or scales.length
    energy_rounding = rounding * float(abs(observables.energy).max()) / scales.energy

    def constant(values: np.ndarray, scale: float) -> float | None:
        change = float(np.ptp(values)) / scale
        return change if change <= CONSTANT else None

    certificate = Certificate(
        position=max(bounds[0], rounding * size),
        velocity=max(bounds[1], rounding * scales.speed),
        energy=max(bounds[2], rounding, energy_rounding),
        independent=scenario.closed_form or "DOP853",
        independent_difference=independent[0] / scales.length,
        tolerance_difference=coarser[0] / scales.length,
        energy_drift=constant(observables.energy, scales.energy),
        angular_momentum_drift=constant(observables.angular_momentum, scales.angular_momentum),
    )
    return Reference(times, position, velocity, observables, radius, scales, certificate)


@jax.jit
def _observe_all(system: System, position: Any, velocity: Any) -> Observables:
    return jax.vmap(observe, in_axes=(None, 0, 0))(system, position, velocity)


def observe_all(system: System, position: np.ndarray, velocity: np.ndarray) -> Observables:
    """Energy and momenta of many states, (T, 3, N) each, as NumPy arrays of shape (T,)."""
    count = len(position)
    # Rounded up to a power of two, most numbers of states need no program of their own.
    padding = [(0, max(256, 1 << (count - 1).bit_length()) - count), (0, 0), (0, 0)]
    padded = (np.pad(part, padding, mode="edge") for part in (position, velocity))
    with float64_allowed():
        return jax.tree.map(lambda all: np.asarray(all)[:count], _observe_all(system, *padded))


def _scales(system: System, position: np.ndarray, velocity: np.ndarray) -> Scales:
    """The scales of a motion; a scenario at rest is measured in SI units, since it has none."""
    mass = inertial_mass(system.bodies)
    kinetic = (0.5 * mass * velocity**2).sum(axis=(1, 2))
    potential = observe_all(system, position, velocity).energy - kinetic
    radius = gyration(system.bodies)
    momenta = np.abs(
        mass[0] * (position[:, 0] * velocity[:, 1] - position[:, 1] * velocity[:, 0])
    ) + np.abs(mass[2] * velocity[:, 2])
    still = np.zeros_like(velocity)
    away = position - position[0]
    away[:, 2] = np.clip(away[:, 2], -np.pi, np.pi)
    length = float(np.hypot(np.hypot(away[:, 0], away[:, 1]), radius * away[:, 2]).max())
    speed = float(velocity_distance(velocity, still, radius).max())
    return Scales(
        length=length or 1.0,
        speed=speed or 1.0,
        energy=float(max(kinetic.max(), np.ptp(potential))) or 1.0,
        angular_momentum=float(momenta.sum(axis=1).max()) or 1.0,
    )

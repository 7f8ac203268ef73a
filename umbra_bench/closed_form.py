"""Exact solutions, where physics has them.

They are written from the scenario's own numbers and share no code with the force laws, so that an
agreement with the reference certifies both. A closed form is a function ``(scenario, times) ->
(position, velocity)``, shape (T, 3, N) each; angles are not wrapped.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from umbra_bench.scenario import Body, CentralGravity, Scenario, Spring, TorsionSpring

Solution = tuple[np.ndarray, np.ndarray]


class ClosedForm(NamedTuple):
    """An exact solution and the test of whether it solves a scenario."""

    fits: Callable[[Scenario], bool]
    solve: Callable[[Scenario, np.ndarray], Solution]


def fitting_closed_forms(scenario: Scenario) -> list[str]:
    """The names of the closed forms that solve a scenario."""
    # Numbers at the edge of float64 overflow: no closed form is then of use.
    with contextlib.suppress(OverflowError), np.errstate(all="ignore"):
        return [name for name, form in CLOSED_FORMS.items() if form.fits(scenario)]
    return []


def solve_closed_form(scenario: Scenario, times: np.ndarray) -> Solution:
    """The exact solution of a scenario that names one, at `times` (s)."""
    assert scenario.closed_form is not None, "the scenario names no closed form"
    return CLOSED_FORMS[scenario.closed_form].solve(scenario, times)


# Facts of a scenario, in its own numbers ----------------------------------------------------------


def _moves_by_force(body: Body) -> bool:
    return body.kind == "dynamic" and body.mass > 0.0


def _inertia(body: Body) -> float:
    """I as given, else of the shape (m r^2/2; m (w^2 + h^2)/12), else 1.0 x m."""
    if body.inertia is not None:
        return body.inertia
    match body.shape:
        case None:
            return body.mass
        case shape if shape.kind == "circle":
            return body.mass * shape.radius**2 / 2
        case shape:
            return body.mass * (shape.width**2 + shape.height**2) / 12


def _decay_rates(scenario: Scenario, body: Body) -> tuple[float, float]:
    """The rates at which linear and angular velocity decay, 1/s: -ln of the fraction kept."""
    if not _moves_by_force(body):
        return 0.0, 0.0
    linear = body.linear_damping or scenario.linear_damping
    angular = body.angular_damping or scenario.angular_damping
    return -math.log(linear), -math.log(angular)


def _start(body: Body) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    return (*body.position, body.angle), (*body.velocity, body.angular_velocity)


# Free motion --------------------------------------------------------------------------------------


def _free_motion(
    x0: float, v0: float, g: float, rate: float, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Solve x'' = g - rate x'. Source: separation of variables."""
    if rate == 0.0:
        return x0 + v0 * t + 0.5 * g * t**2, v0 + g * t
    stretch = -np.expm1(-rate * t) / rate
    return x0 + v0 * stretch + g * (t - stretch) / rate, v0 * np.exp(-rate * t) + g * stretch


def _free_bodies(scenario: Scenario, times: np.ndarray) -> Solution:
    """Uniform gravity alone, with exponential damping; bodies turn freely."""
    shape = (len(times), 3, len(scenario.bodies))
    position, velocity = np.empty(shape), np.empty(shape)
    for i, body in enumerate(scenario.bodies):
        linear, angular = _decay_rates(scenario, body)
        falls = body.affected_by_gravity and _moves_by_force(body)
        gravity = (*scenario.gravity, 0.0) if falls else (0.0, 0.0, 0.0)
        x0, v0 = _start(body)
        for row, rate in enumerate((linear, linear, angular)):
            position[:, row, i], velocity[:, row, i] = _free_motion(
                x0[row], v0[row], gravity[row], rate, times
            )
    return position, velocity


# Kepler -------------------------------------------------------------------------------------------


def _is_kepler(scenario: Scenario) -> bool:
    if len(scenario.bodies) != 1 or len(scenario.forces) != 1 or any(scenario.gravity):
        return False
    body, force = scenario.bodies[0], scenario.forces[0]
    if not isinstance(force, CentralGravity) or not _moves_by_force(body):
        return False
    if any(_decay_rates(scenario, body)):
        return False
    r, v = np.subtract(body.position, force.centre), np.array(body.velocity)
    bound = v @ v / 2 - force.mu / np.hypot(*r) < 0.0
    return bool(bound and r[0] * v[1] - r[1] * v[0] != 0.0)


def _kepler(scenario: Scenario, times: np.ndarray) -> Solution:
    """An elliptic orbit by Kepler's equation M = E - e sin E, solved by Newton's method.

    Source: Goldstein, Classical Mechanics, 3.8.
    """
    body, force = scenario.bodies[0], scenario.forces[0]
    assert isinstance(force, CentralGravity)
    mu, centre = force.mu, np.array(force.centre)
    r0, v0 = np.array(body.position) - centre, np.array(body.velocity)
    distance = np.hypot(*r0)
    axis = 1.0 / (2.0 / distance - v0 @ v0 / mu)
    # e cos E and e sin E of the start: exact for circular orbits too, where e = 0.
    e_cos, e_sin = 1.0 - distance / axis, (r0 @ v0) / math.sqrt(mu * axis)
    eccentricity, start = math.hypot(e_cos, e_sin), math.atan2(e_sin, e_cos)
    mean_motion = math.sqrt(mu / axis**3)
    mean = start - eccentricity * math.sin(start) + mean_motion * times
    turns = np.round(mean / (2 * math.pi))
    mean = mean - 2 * math.pi * turns
    anomaly = mean + eccentricity * np.sign(mean)
    for _ in range(60):
        residual = anomaly - eccentricity * np.sin(anomaly) - mean
        anomaly = anomaly - residual / (1.0 - eccentricity * np.cos(anomaly))
    # The ellipse's own axes, from the initial position and velocity.
    minor = axis * math.sqrt((1 - eccentricity) * (1 + eccentricity))
    rate0 = mean_motion * axis / distance
    in_plane = np.array(
        [
            [axis * (math.cos(start) - eccentricity), minor * math.sin(start)],
            [-axis * math.sin(start) * rate0, minor * math.cos(start) * rate0],
        ]
    )
    axes = np.linalg.solve(in_plane, np.array([r0, v0]))  # rows: towards pericentre, and across
    rate = mean_motion / (1.0 - eccentricity * np.cos(anomaly))
    place = np.stack([axis * (np.cos(anomaly) - eccentricity), minor * np.sin(anomaly)], axis=-1)
    pace = np.stack([-axis * np.sin(anomaly) * rate, minor * np.cos(anomaly) * rate], axis=-1)
    position, velocity = np.empty((len(times), 3, 1)), np.empty((len(times), 3, 1))
    position[:, :2, 0], velocity[:, :2, 0] = centre + place @ axes, pace @ axes
    position[:, 2, 0] = body.angle + body.angular_velocity * times
    velocity[:, 2, 0] = body.angular_velocity
    return position, velocity


# Normal modes -------------------------------------------------------------------------------------


def _is_linear(scenario: Scenario) -> bool:
    """Springs of no rest length between centres, torsion springs that stay within half a turn."""
    bodies = {body.name: body for body in scenario.bodies}
    if not scenario.forces or any(body.kind == "kinematic" for body in scenario.bodies):
        return False
    moving = [body for body in scenario.bodies if _moves_by_force(body)]
    if len({_decay_rates(scenario, body) for body in moving}) > 1:
        return False
    twisted: set[str] = set()
    for force in scenario.forces:
        match force:
            case Spring(rest_length=0.0, damping=0.0, point=(0.0, 0.0)):
                pass
            case TorsionSpring(damping=0.0) if force.stiffness > 0.0 and force.body not in twisted:
                twisted.add(force.body)
                body = bodies[force.body]
                twist = body.angle - force.rest_angle
                reach = twist**2 + _inertia(body) * body.angular_velocity**2 / force.stiffness
                if abs(twist) >= math.pi or reach >= math.pi**2 or _inertia(body) == 0.0:
                    return False
            case _:
                return False
    return bool(moving)


def _normal_modes(scenario: Scenario, times: np.ndarray) -> Solution:
    """Solve M x'' + rate M x' + K x = b in each row by the modes of M^(-1/2) K M^(-1/2).

    Source: Goldstein, Classical Mechanics, 6.2.
    """
    names = [body.name for body in scenario.bodies]
    moving = [i for i, body in enumerate(scenario.bodies) if _moves_by_force(body)]
    shape = (len(times), 3, len(names))
    start = np.array([_start(body) for body in scenario.bodies])  # (N, 2, 3)
    position = np.broadcast_to(start[:, 0].T, shape).copy()
    velocity = np.broadcast_to(start[:, 1].T, shape).copy()
    rates = _decay_rates(scenario, scenario.bodies[moving[0]])
    for row in range(3):
        stiffness, load = np.zeros((len(names), len(names))), np.zeros(len(names))
        for force in scenario.forces:
            match force:
                case Spring() if row < 2:
                    i = names.index(force.body)
                    stiffness[i, i] += force.stiffness
                    if force.anchor is not None:
                        load[i] += force.stiffness * force.anchor[row]
                    else:
                        j = names.index(str(force.other))
                        stiffness[j, j] += force.stiffness
                        stiffness[i, j] -= force.stiffness
                        stiffness[j, i] -= force.stiffness
                case TorsionSpring() if row == 2:
                    i = names.index(force.body)
                    stiffness[i, i] += force.stiffness
                    load[i] += force.stiffness * force.rest_angle
        mass = np.array([_inertia(b) if row == 2 else b.mass for b in scenario.bodies])
        # An inertia of 0 means that no torque turns the body: it keeps its spin.
        swinging = [i for i in moving if mass[i] > 0.0]
        for i in set(moving) - set(swinging):
            position[:, row, i], velocity[:, row, i] = _free_motion(
                start[i, 0, row], start[i, 1, row], 0.0, rates[row == 2], times
            )
        if not swinging:
            continue
        if row < 2:
            pulled = np.array([b.affected_by_gravity for b in scenario.bodies])
            load = load + mass * scenario.gravity[row] * pulled
        fixed = np.setdiff1d(np.arange(len(names)), moving)
        load = load - stiffness[:, fixed] @ start[fixed, 0, row]
        root = np.sqrt(mass[swinging])
        squares, modes = np.linalg.eigh(
            stiffness[np.ix_(swinging, swinging)] / np.outer(root, root)
        )
        amplitude = modes.T @ (root * start[swinging, 0, row])
        pace = modes.T @ (root * start[swinging, 1, row])
        push = modes.T @ (load[swinging] / root)
        q, dq = np.empty((len(times), len(root))), np.empty((len(times), len(root)))
        negligible = 1e-12 * max(squares.max(), 0.0)
        for k, square in enumerate(squares):
            q[:, k], dq[:, k] = _mode(
                amplitude[k], pace[k], push[k], rates[row == 2], square, negligible, times
            )
        position[:, row, swinging] = q @ modes.T / root
        velocity[:, row, swinging] = dq @ modes.T / root
    return position, velocity


def _mode(
    q0: float, v0: float, push: float, rate: float, square: float, negligible: float, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Solve q'' + rate q' + square q = push for one mode, whatever its damping."""
    if square <= negligible:
        return _free_motion(q0, v0, push, rate, t)
    rest = push / square
    swing, half = q0 - rest, rate / 2
    inside = half**2 - square
    # decay cosh(s t) and decay sinh(s t)/s, with decay = exp(-half t), free of overflow.
    if inside > 0.0:
        s = math.sqrt(inside)
        slow, fast = np.exp(-square / (half + s) * t), np.exp(-(half + s) * t)
        cosh, sinh_over_s = (slow + fast) / 2, -slow * np.expm1(-2 * s * t) / (2 * s)
    else:
        s = math.sqrt(-inside)
        decay = np.exp(-half * t)
        cosh, sinh_over_s = decay * np.cos(s * t), decay * (np.sin(s * t) / s if s else t)
    q = swing * cosh + (v0 + half * swing) * sinh_over_s
    v = v0 * cosh - (half * v0 + square * swing) * sinh_over_s
    return rest + q, v


CLOSED_FORMS: dict[str, ClosedForm] = {
    "free_motion": ClosedForm(lambda scenario: not scenario.forces, _free_bodies),
    "kepler": ClosedForm(_is_kepler, _kepler),
    "normal_modes": ClosedForm(_is_linear, _normal_modes),
}

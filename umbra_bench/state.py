"""The mechanical state, and the quantities that a mechanics book defines on it.

Generalised coordinates, component first and body last: every array has shape (3, N), rows x, y,
angle, in SI units. Bodies of infinite mass (static, kinematic) carry no energy and no momentum here.
"""

from __future__ import annotations

from typing import NamedTuple

from umbra_bench.umbra.bodies import Array, Bodies


class State(NamedTuple):
    """Positions (m, m, rad) and velocities (m/s, m/s, rad/s), shape (3, N) each."""

    position: Array
    velocity: Array


def inertial_mass(bodies: Bodies) -> Array:
    """m, m, I of the bodies that forces move, 0 for the others; shape (3, N)."""
    xp = bodies.mass.__array_namespace__()
    return xp.where(bodies.inverse_mass > 0.0, bodies.mass, 0.0)


def kinetic_energy(bodies: Bodies, velocity: Array) -> Array:
    """T = m v^2/2 + I omega^2/2 of each body, J, shape (N,)."""
    mass, _, inertia = inertial_mass(bodies)
    vx, vy, omega = velocity
    return 0.5 * (mass * (vx * vx + vy * vy) + inertia * omega * omega)


def linear_momentum(bodies: Bodies, velocity: Array) -> Array:
    """P = sum of m v, N s, shape (2,)."""
    mx, my, _ = inertial_mass(bodies)
    xp = velocity.__array_namespace__()
    return xp.stack([(mx * velocity[0]).sum(), (my * velocity[1]).sum()])


def angular_momentum(bodies: Bodies, position: Array, velocity: Array) -> Array:
    """L = m (x vy - y vx) + I omega of each body about the origin, N m s, shape (N,)."""
    mass, _, inertia = inertial_mass(bodies)
    x, y, _ = position
    vx, vy, omega = velocity
    return mass * (x * vy - y * vx) + inertia * omega

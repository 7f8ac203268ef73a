"""The textbook methods: each a rule that advances a state by one step.

An integrator is a function ``(system, state, dt) -> state`` of pure array operations. The symplectic
ones of second and fourth order are one composition of kicks and drifts with different coefficients.
"""

from __future__ import annotations

from collections.abc import Callable

from umbra_bench.state import State
from umbra_bench.system import System
from umbra_bench.umbra.bodies import Array

Integrator = Callable[[System, State, Array], State]


def explicit_euler(system: System, state: State, dt: Array) -> State:
    """x += v dt; v += a(x, v) dt, both from the old state. Order 1; unstable on every oscillator.

    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration, I.1.1.
    """
    x, v = state
    a = system.acceleration(x, v)
    return State(x + v * dt, v + a * dt)


def semi_implicit_euler(system: System, state: State, dt: Array) -> State:
    """v += a(x, v) dt; then x += v dt with the new v. Order 1, symplectic.

    Source: Hairer, Lubich, Wanner, I.1.2 (symplectic Euler).
    """
    x, v = state
    v = v + system.acceleration(x, v) * dt
    return State(x + v * dt, v)


def rk4(system: System, state: State, dt: Array) -> State:
    """The classical Runge-Kutta method. Order 4.

    Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.1.
    """
    x, v = state

    def slope(x: Array, v: Array) -> tuple[Array, Array]:
        return v, system.acceleration(x, v)

    k1x, k1v = slope(x, v)
    k2x, k2v = slope(x + k1x * (dt / 2), v + k1v * (dt / 2))
    k3x, k3v = slope(x + k2x * (dt / 2), v + k2v * (dt / 2))
    k4x, k4v = slope(x + k3x * dt, v + k3v * dt)
    return State(
        x + (k1x + 2 * k2x + 2 * k3x + k4x) * (dt / 6),
        v + (k1v + 2 * k2v + 2 * k3v + k4v) * (dt / 6),
    )


def composition(*fractions: float) -> Integrator:
    """Compose kick-drift-kick steps of the given fractions of dt.

    A symmetric sequence of fractions that adds up to 1 gives a symmetric, symplectic method.
    Adjacent half kicks are merged into one.

    Source: Hairer, Lubich, Wanner, V.3.2.
    """
    halves = [fraction / 2 for fraction in fractions]
    kicks = [before + after for before, after in zip([0.0, *halves], [*halves, 0.0], strict=True)]

    def step(system: System, state: State, dt: Array) -> State:
        x, v = state
        for kick_fraction, drift_fraction in zip(kicks, fractions, strict=False):
            v = kick(system, x, v, kick_fraction * dt)
            x = x + v * (drift_fraction * dt)
        v = kick(system, x, v, kicks[-1] * dt)
        return State(x, v)

    return step


def kick(system: System, x: Array, v: Array, h: Array) -> Array:
    """The velocity after the forces at frozen positions acted for a time h: dv/dt = a(x, v).

    One evaluation where the forces do not depend on the velocity: v + a(x) h is then the exact flow.
    Otherwise the classical Runge-Kutta method, whose error is below that of every composition here.
    """
    if not system.velocity_dependent:
        return v + system.acceleration(x, v) * h
    k1 = system.acceleration(x, v)
    k2 = system.acceleration(x, v + k1 * (h / 2))
    k3 = system.acceleration(x, v + k2 * (h / 2))
    k4 = system.acceleration(x, v + k3 * h)
    return v + (k1 + 2 * k2 + 2 * k3 + k4) * (h / 6)


velocity_verlet = composition(1.0)
"""v += a(x) dt/2; x += v dt; v += a(x) dt/2. Order 2, symmetric, symplectic.

The same as x += v dt + a dt^2/2; v += (a_old + a_new)/2 dt. Source: Hairer, Lubich, Wanner, I.3.1.
"""

_OUTER = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))

yoshida4 = composition(_OUTER, 1.0 - 2.0 * _OUTER, _OUTER)
"""Three velocity Verlet steps, the middle one backwards. Order 4, symmetric, symplectic.

Source: H. Yoshida, Physics Letters A 150 (1990) 262.
"""

INTEGRATORS: dict[str, Integrator] = {
    "explicit-euler": explicit_euler,
    "semi-implicit-euler": semi_implicit_euler,
    "velocity-verlet": velocity_verlet,
    "rk4": rk4,
    "yoshida4": yoshida4,
}

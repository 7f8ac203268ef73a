"""Symplecticity, proved at many states: J^T Omega J = Omega, with J by automatic differentiation.

A pipeline that stores an acceleration maps (x, v, a) to (x, v, a), and that map cannot be symplectic:
it has an odd number of dimensions. After its first steps, though, the stored acceleration is a
function of the past, and position and velocity determine everything. So the map is followed from the
(x, v) of a start through two steps, and then through one more: with E the state after two steps and F
after three, J = DF (DE)^-1 is the Jacobian of the map from the (x, v) that a game reads to the next.

The same is done for (x, u) with u = v + a dt/2, the velocity half a kick later.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from umbra_bench.compiled import COMPILED_METHODS
from umbra_bench.jax_settings import float64_allowed
from umbra_bench.reference import Reference
from umbra_bench.scenario import Scenario
from umbra_bench.state import State, inertial_mass
from umbra_bench.system import build_system, initial_state

STATES = 64
"""At how many states along the true motion, each moved a little, the Jacobian is taken."""

ROUNDING = 1e-11
"""A defect below this is rounding: the Jacobians are products of a few matrices of order one."""


class Defect(NamedTuple):
    """The largest |J^T Omega J - Omega| over the states, 0 for a symplectic map.

    Attributes:
        as_read: of the map of position and velocity as a game reads them.
        half_a_kick_later: of the map of position and v + a dt/2; the same where no a is stored.
        determinant: the largest |det J - 1| of the map as read.
        whole_determinant: |det| of the map of all that is stored, (x, v) or (x, v, a).
    """

    as_read: float
    half_a_kick_later: float
    determinant: float
    whole_determinant: float


def symplectic_defect(
    scenario: Scenario, reference: Reference, method: str, dt: float = 0.01
) -> Defect:
    """Measure a method on a scenario without damping whose bodies are all dynamic."""
    compiled = COMPILED_METHODS[method]
    system = build_system(scenario)
    scales = reference.scales
    mass = np.asarray(inertial_mass(system.bodies), float)
    moved = mass > 0.0
    form = np.diag((mass / mass.max())[moved])
    omega = np.block([[0.0 * form, form], [-form, 0.0 * form]])
    unit = (scales.length, scales.speed)
    stores = hasattr(compiled.start(system, initial_state(scenario)), "acceleration")

    def readings(z: Any, base: State) -> Any:
        """(x, v) and (x, u) after two and after three steps, shape (2, 2, 2 M)."""
        x, v = jnp.split(z, 2)
        state = compiled.start(
            system,
            State(
                base.position.at[moved].set(x * unit[0]), base.velocity.at[moved].set(v * unit[1])
            ),
        )
        found = []
        for _ in range(3):
            state = compiled.step(system, state, dt)
            place, speed = state.position[moved] / unit[0], state.velocity[moved] / unit[1]
            half = state.acceleration[moved] * (dt / 2 / unit[1]) if stores else 0.0
            found.append(jnp.stack([jnp.concatenate([place, v]) for v in (speed, speed + half)]))
        return jnp.stack(found[1:])

    def defects(position: Any, velocity: Any) -> Any:
        base = State(position, velocity)
        z = jnp.concatenate([position[moved] / unit[0], velocity[moved] / unit[1]])
        before, behind = jax.jacfwd(readings)(z, base)
        jacobian = behind @ jnp.linalg.inv(before)  # of both readings, (2, 2 M, 2 M)
        defect = jnp.abs(jnp.swapaxes(jacobian, 1, 2) @ omega @ jacobian - omega).max((1, 2))
        return jnp.append(defect, jnp.abs(jnp.linalg.det(jacobian[0]) - 1.0))

    position, velocity = _states(reference)
    with float64_allowed():
        values = jax.jit(jax.vmap(defects))(jnp.asarray(position), jnp.asarray(velocity))
        as_read, later, determinant = np.asarray(values).max(axis=0)
        whole_determinant = _whole_determinant(compiled, system, position[0], velocity[0], dt)
    return Defect(float(as_read), float(later), float(determinant), whole_determinant)


def _states(reference: Reference) -> tuple[np.ndarray, np.ndarray]:
    """States along the true motion, each moved by up to a hundredth of the motion's size."""
    chosen = np.linspace(0, len(reference.times) - 1, STATES).astype(int)
    random = np.random.default_rng(2024)
    position, velocity = reference.position[chosen].copy(), reference.velocity[chosen].copy()
    position[:, :2] += 0.01 * reference.scales.length * random.uniform(-1, 1, position[:, :2].shape)
    velocity[:, :2] += 0.01 * reference.scales.speed * random.uniform(-1, 1, velocity[:, :2].shape)
    position[:, 2] = np.mod(position[:, 2] + 1.0, 2 * np.pi)  # away from where angles are wrapped
    return position, velocity


def _whole_determinant(
    compiled: Any, system: Any, position: np.ndarray, velocity: np.ndarray, dt: float
) -> float:
    """|det| of one step of everything that the method stores but its empty accumulators."""
    state = compiled.start(system, State(jnp.asarray(position), jnp.asarray(velocity)))
    names = [n for n in ("position", "velocity", "acceleration") if hasattr(state, n)]
    shape = position.shape

    def step(flat: Any) -> Any:
        parts = dict(zip(names, flat.reshape(len(names), *shape), strict=True))
        after = compiled.step(system, state._replace(**parts), dt)
        return jnp.stack([getattr(after, name) for name in names]).ravel()

    flat = jnp.stack([getattr(state, name) for name in names]).ravel()
    return float(abs(jnp.linalg.det(jax.jit(jax.jacfwd(step))(flat))))

"""Force laws: the force on every body, and the potential energy of those that have one.

A law is a small pytree of parameters with two pure functions of arrays of shape (3, N), rows x, y,
angle. All forces of one kind that share a form are one law with a row for each, so that a chain of
33 springs is one vector operation. NumPy and JAX arrays are both welcome.

A force with a point p in body coordinates acts at r = R(angle) p from the centre of mass and adds
the torque r x F (the devlog, "The Force Pipeline").
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import jax
import numpy as np

from umbra_bench import scenario as problem
from umbra_bench.scenario import Scenario
from umbra_bench.umbra.bodies import Array, Bodies
from umbra_bench.umbra.pipeline import TWO_PI, gravity_force


class ForceLaw(Protocol):
    """What every law of this module offers.

    `conservative` laws have a potential energy, J, whose negative gradient is the force;
    `velocity_dependent` ones read the velocity.
    """

    conservative: ClassVar[bool]

    @property
    def velocity_dependent(self) -> bool: ...

    def force(self, position: Array, velocity: Array) -> Array:
        """Fx, Fy and torque on every body, N and N m, shape (3, N)."""
        ...

    def potential(self, position: Array) -> Array:
        """Potential energy of each row of the law, J, of any shape; zero for a law that has none."""
        ...


def _static() -> Any:
    """A field that is part of a law's shape, not one of its parameters."""
    return dataclasses.field(metadata={"static": True})


@dataclass(frozen=True)
class Acting:
    """Which of N bodies each row of a law acts on."""

    bodies: tuple[int, ...]
    count: int

    @property
    def each_once(self) -> bool:
        """Row i acts on body i: nothing needs to be moved."""
        return self.bodies == tuple(range(self.count))

    def take(self, rows: Array) -> Array:
        """The columns of `rows`, shape (..., N), that belong to the acting rows, (..., S)."""
        return rows if self.each_once else rows[..., np.array(self.bodies)]

    def collect(self, rows: Array) -> Array:
        """Sum what acts on each body: (..., S) to (..., N)."""
        if self.each_once:
            return rows
        xp = rows.__array_namespace__()
        padded = xp.concat([rows, xp.zeros_like(rows[..., :1])], axis=-1)
        table = _incidence(self)
        total = padded[..., table[0]]
        for each in table[1:]:
            total = total + padded[..., each]
        return total


@functools.lru_cache(maxsize=256)
def _incidence(acting: Acting) -> np.ndarray:
    """For each body, the rows that act on it, padded with the index of an extra row of zeros.

    A gather in a fixed order: unlike a scatter it vectorises, and its sums are reproducible.
    """
    rows: list[list[int]] = [[] for _ in range(acting.count)]
    for row, body in enumerate(acting.bodies):
        rows[body].append(row)
    depth = max(map(len, rows), default=1)
    none = len(acting.bodies)
    return np.array([each + [none] * (depth - len(each)) for each in rows]).T


def _rotated(vector: Array, angle: Array) -> Array:
    """R(angle) vector, shape (2, S)."""
    xp = angle.__array_namespace__()
    c, s = xp.cos(angle), xp.sin(angle)
    return xp.stack([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def _cross(a: Array, b: Array) -> Array:
    """The 2D cross product a x b."""
    return a[0] * b[1] - a[1] * b[0]


def angle_difference(angle: Array, other: Array) -> Array:
    """angle - other brought to (-pi, pi]."""
    xp = angle.__array_namespace__()
    difference = angle - other
    return difference - TWO_PI * xp.ceil((difference - math.pi) / TWO_PI)


def _inverse(length: Array) -> Array:
    """1/length, and 0 where the length is 0: a force along a line that has no direction is none."""
    xp = length.__array_namespace__()
    return xp.where(length > 0.0, 1.0 / xp.where(length > 0.0, length, 1.0), 0.0)


def _length(vector: Array) -> Array:
    """|vector|, with a gradient of 0 in place of NaN at 0."""
    xp = vector.__array_namespace__()
    square = vector[0] ** 2 + vector[1] ** 2
    return xp.where(square > 0.0, xp.sqrt(xp.where(square > 0.0, square, 1.0)), 0.0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class UniformGravity:
    """F = m g on every body whose flag is set, through the devlog's own formula."""

    conservative: ClassVar[bool] = True
    weight: Array  # (3, N), N

    velocity_dependent: ClassVar[bool] = False

    def force(self, position: Array, velocity: Array) -> Array:
        return self.weight

    def potential(self, position: Array) -> Array:
        return -(self.weight[0] * position[0] + self.weight[1] * position[1])


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Spring:
    """F = -(k (l - l0) + c dl/dt) d/l, with d from the spring's far end to its point on the body.

    The far end is an anchor in the world or another body's centre of mass, which then feels -F.
    A spring of length zero has no direction: it exerts only -k d, which is then zero.
    """

    conservative: ClassVar[bool] = True
    stiffness: Array  # (S,), N/m
    rest_length: Array | None  # (S,), m; None where no spring has any
    damping: Array | None  # (S,), N s/m; None where no spring has any
    anchor: Array | None  # (2, S), m; None where the far end is a body
    point: Array | None  # (2, S), m, body coordinates; None where all hold the centre of mass
    acting: Acting = _static()
    other: Acting | None = _static()

    @property
    def velocity_dependent(self) -> bool:
        return self.damping is not None

    def force(self, position: Array, velocity: Array) -> Array:
        xp = position.__array_namespace__()
        arm, reach = self._reach(position)
        tension = -self.stiffness
        if self.rest_length is not None:
            tension = tension * (1.0 - self.rest_length * _inverse(_length(reach)))
        if self.damping is not None:
            rate = self._rate(velocity, arm)
            tension = tension - self.damping * (reach * rate).sum(0) * _inverse(_length(reach)) ** 2
        pull = tension * reach
        none = xp.zeros_like(tension)
        torque = none if arm is None else _cross(arm, pull)
        total = self.acting.collect(xp.stack([pull[0], pull[1], torque]))
        if self.other is not None:
            total = total - self.other.collect(xp.stack([pull[0], pull[1], none]))
        return total

    def potential(self, position: Array) -> Array:
        _, reach = self._reach(position)
        if self.rest_length is None:
            return 0.5 * self.stiffness * (reach**2).sum(0)
        return 0.5 * self.stiffness * (_length(reach) - self.rest_length) ** 2

    def _reach(self, position: Array) -> tuple[Array | None, Array]:
        """The arm r = R p (None: no arm) and the vector d from the far end to the held point."""
        held = self.acting.take(position)
        far = self.anchor if self.other is None else self.other.take(position)[:2]
        if self.point is None:
            return None, held[:2] - far
        arm = _rotated(self.point, held[2])
        return arm, held[:2] + arm - far

    def _rate(self, velocity: Array, arm: Array | None) -> Array:
        """The velocity of the held point relative to the far end."""
        xp = velocity.__array_namespace__()
        held = self.acting.take(velocity)
        rate = held[:2]
        if arm is not None:
            rate = rate + held[2] * xp.stack([-arm[1], arm[0]])
        return rate if self.other is None else rate - self.other.take(velocity)[:2]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TorsionSpring:
    """torque = -k (angle - rest) - c omega, the difference taken in (-pi, pi]."""

    conservative: ClassVar[bool] = True
    stiffness: Array  # (S,), N m/rad
    rest_angle: Array  # (S,), rad
    damping: Array | None  # (S,), N m s/rad
    acting: Acting = _static()

    @property
    def velocity_dependent(self) -> bool:
        return self.damping is not None

    def force(self, position: Array, velocity: Array) -> Array:
        xp = position.__array_namespace__()
        twist = angle_difference(self.acting.take(position)[2], self.rest_angle)
        torque = -self.stiffness * twist
        if self.damping is not None:
            torque = torque - self.damping * self.acting.take(velocity)[2]
        none = xp.zeros_like(torque)
        return self.acting.collect(xp.stack([none, none, torque]))

    def potential(self, position: Array) -> Array:
        twist = angle_difference(self.acting.take(position)[2], self.rest_angle)
        return 0.5 * self.stiffness * twist**2


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CentralGravity:
    """F = -mu m r / |r|^3, with r from the centre to the body."""

    conservative: ClassVar[bool] = True
    strength: Array  # (S,), mu m, N m^2
    centre: Array  # (2, S), m
    acting: Acting = _static()

    velocity_dependent: ClassVar[bool] = False

    def force(self, position: Array, velocity: Array) -> Array:
        xp = position.__array_namespace__()
        x, y, inverse = self._from_centre(position)
        pull = -(self.strength * inverse) * (inverse * inverse)
        return self.acting.collect(xp.stack([pull * x, pull * y, xp.zeros_like(pull)]))

    def potential(self, position: Array) -> Array:
        _, _, inverse = self._from_centre(position)
        return -(self.strength * inverse)

    def _from_centre(self, position: Array) -> tuple[Array, Array, Array]:
        """The vector r and 1/|r|, which force and potential share."""
        xp = position.__array_namespace__()
        x, y, _ = self.acting.take(position)
        x, y = x - self.centre[0], y - self.centre[1]
        return x, y, 1.0 / xp.sqrt(x * x + y * y)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MutualGravity:
    """F_i = G m_i sum_j m_j (x_j - x_i) / |x_j - x_i|^3 over every two of the bodies."""

    conservative: ClassVar[bool] = True
    gravitational_constant: Array  # (), m^3/(kg s^2)
    mass: Array  # (S,), kg
    acting: Acting = _static()

    velocity_dependent: ClassVar[bool] = False

    def force(self, position: Array, velocity: Array) -> Array:
        xp = position.__array_namespace__()
        gap, square, others = self._pairs(position)
        pull = xp.where(others, self.gravitational_constant / (square * xp.sqrt(square)), 0.0)
        fx, fy = self.mass * (gap * (pull * self.mass[:, None])).sum(1)
        return self.acting.collect(xp.stack([fx, fy, xp.zeros_like(fx)]))

    def potential(self, position: Array) -> Array:
        xp = position.__array_namespace__()
        _, square, others = self._pairs(position)
        products = self.mass[:, None] * self.mass[None, :]
        pairs = xp.where(others, products / xp.sqrt(square), 0.0)
        return -0.5 * self.gravitational_constant * pairs

    def _pairs(self, position: Array) -> tuple[Array, Array, Array]:
        """Gaps x_j - x_i, shape (2, S, S) as [:, j, i]; their squares, 1 where i = j; where i != j."""
        xp = position.__array_namespace__()
        place = self.acting.take(position)[:2]
        gap = place[:, :, None] - place[:, None, :]
        others = ~np.eye(len(self.acting.bodies), dtype=bool)
        square = xp.where(others, gap[0] ** 2 + gap[1] ** 2, 1.0)
        return gap, square, others


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class WorldForce:
    """A force F fixed in the world at a point of the body; its potential is -F . (x + R p)."""

    conservative: ClassVar[bool] = True
    push: Array  # (2, S), N
    point: Array | None  # (2, S), m, body coordinates
    acting: Acting = _static()

    velocity_dependent: ClassVar[bool] = False

    def force(self, position: Array, velocity: Array) -> Array:
        xp = position.__array_namespace__()
        torque = xp.zeros_like(self.push[0])
        if self.point is not None:
            torque = _cross(_rotated(self.point, self.acting.take(position)[2]), self.push)
        return self.acting.collect(xp.stack([self.push[0], self.push[1], torque]))

    def potential(self, position: Array) -> Array:
        held = self.acting.take(position)
        place = held[:2]
        if self.point is not None:
            place = place + _rotated(self.point, held[2])
        return -(self.push * place).sum(0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class BodyForce:
    """A thruster: a force that turns with the body, at a point of it. It has no potential."""

    conservative: ClassVar[bool] = False
    push: Array  # (2, S), N, body coordinates
    point: Array  # (2, S), m, body coordinates
    acting: Acting = _static()

    velocity_dependent: ClassVar[bool] = False

    def force(self, position: Array, velocity: Array) -> Array:
        xp = position.__array_namespace__()
        push = _rotated(self.push, self.acting.take(position)[2])
        torque = _cross(self.point, self.push)  # the same in the world: both turn together
        return self.acting.collect(xp.stack([push[0], push[1], torque]))

    def potential(self, position: Array) -> Array:
        return position.__array_namespace__().zeros_like(position[0, 0])


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ConstantTorque:
    """A constant torque. Angles wrap, so it has no potential that is a function of the state."""

    conservative: ClassVar[bool] = False
    torque: Array  # (S,), N m
    acting: Acting = _static()

    velocity_dependent: ClassVar[bool] = False

    def force(self, position: Array, velocity: Array) -> Array:
        xp = position.__array_namespace__()
        none = xp.zeros_like(self.torque)
        return self.acting.collect(xp.stack([none, none, self.torque]))

    def potential(self, position: Array) -> Array:
        return position.__array_namespace__().zeros_like(position[0, 0])


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Drag:
    """F = -c v."""

    conservative: ClassVar[bool] = False
    coefficient: Array  # (S,), N s/m
    acting: Acting = _static()

    velocity_dependent: ClassVar[bool] = True

    def force(self, position: Array, velocity: Array) -> Array:
        xp = position.__array_namespace__()
        vx, vy = self.acting.take(velocity)[:2]
        none = xp.zeros_like(self.coefficient)
        return self.acting.collect(xp.stack([-self.coefficient * vx, -self.coefficient * vy, none]))

    def potential(self, position: Array) -> Array:
        return position.__array_namespace__().zeros_like(position[0, 0])


# From a scenario to its laws ----------------------------------------------------------------------


def build_laws(scenario: Scenario, bodies: Bodies) -> tuple[ForceLaw, ...]:
    """The force laws of a scenario, with parameters of the precision of `bodies`."""
    dtype = bodies.inverse_mass.dtype.type
    builder = _Builder(bodies, {body.name: i for i, body in enumerate(scenario.bodies)}, dtype)
    laws: list[ForceLaw] = []
    if any(scenario.gravity):
        gravity = np.array(scenario.gravity, dtype)
        weight = gravity_force(gravity, bodies.inverse_mass, bodies.affected_by_gravity)
        laws.append(UniformGravity(weight=weight))
    forces = scenario.forces
    laws += builder.springs([f for f in forces if isinstance(f, problem.Spring) and f.anchor])
    laws += builder.springs([f for f in forces if isinstance(f, problem.Spring) and f.other])
    laws += builder.torsion_springs([f for f in forces if isinstance(f, problem.TorsionSpring)])
    laws += builder.central([f for f in forces if isinstance(f, problem.CentralGravity)])
    laws += [builder.mutual(f) for f in forces if isinstance(f, problem.MutualGravity)]
    pushes = [f for f in forces if isinstance(f, problem.ConstantForce)]
    laws += builder.world_forces([f for f in pushes if f.frame == "world"])
    laws += builder.body_forces([f for f in pushes if f.frame == "body"])
    laws += builder.torques([f for f in forces if isinstance(f, problem.ConstantTorque)])
    laws += builder.drags([f for f in forces if isinstance(f, problem.Drag)])
    return tuple(laws)


@dataclass(frozen=True)
class _Builder:
    """Turns the tables of one kind into one law, or none where there are none."""

    bodies: Bodies
    places: dict[str, int]
    dtype: Any

    def array(self, values: Iterable[Any]) -> np.ndarray:
        """Values of each row last: (S,) or (2, S)."""
        return np.array(list(values), self.dtype).T

    def optional(self, values: Iterable[Any]) -> np.ndarray | None:
        """As `array`, or None where all values are zero: a term that no row has is not computed."""
        values = list(values)
        if not any(any(value) if isinstance(value, tuple) else value for value in values):
            return None
        return self.array(values)

    def acting(self, names: Iterable[str]) -> Acting:
        return Acting(tuple(self.places[name] for name in names), len(self.places))

    def mass(self, names: Iterable[str]) -> np.ndarray:
        return self.bodies.mass[0, [self.places[name] for name in names]]

    def springs(self, tables: list[problem.Spring]) -> list[ForceLaw]:
        if not tables:
            return []
        to_world = tables[0].anchor is not None
        return [
            Spring(
                stiffness=self.array(t.stiffness for t in tables),
                rest_length=self.optional(t.rest_length for t in tables),
                damping=self.optional(t.damping for t in tables),
                anchor=self.array(t.anchor for t in tables) if to_world else None,
                point=self.optional(t.point for t in tables),
                acting=self.acting(t.body for t in tables),
                other=None if to_world else self.acting(str(t.other) for t in tables),
            )
        ]

    def torsion_springs(self, tables: list[problem.TorsionSpring]) -> list[ForceLaw]:
        if not tables:
            return []
        return [
            TorsionSpring(
                stiffness=self.array(t.stiffness for t in tables),
                rest_angle=self.array(t.rest_angle for t in tables),
                damping=self.optional(t.damping for t in tables),
                acting=self.acting(t.body for t in tables),
            )
        ]

    def central(self, tables: list[problem.CentralGravity]) -> list[ForceLaw]:
        if not tables:
            return []
        return [
            CentralGravity(
                strength=self.array(t.mu for t in tables) * self.mass(t.body for t in tables),
                centre=self.array(t.centre for t in tables),
                acting=self.acting(t.body for t in tables),
            )
        ]

    def mutual(self, table: problem.MutualGravity) -> ForceLaw:
        return MutualGravity(
            gravitational_constant=np.array(table.gravitational_constant, self.dtype),
            mass=self.mass(table.bodies),
            acting=self.acting(table.bodies),
        )

    def world_forces(self, tables: list[problem.ConstantForce]) -> list[ForceLaw]:
        if not tables:
            return []
        return [
            WorldForce(
                push=self.array(t.force for t in tables),
                point=self.optional(t.point for t in tables),
                acting=self.acting(t.body for t in tables),
            )
        ]

    def body_forces(self, tables: list[problem.ConstantForce]) -> list[ForceLaw]:
        if not tables:
            return []
        return [
            BodyForce(
                push=self.array(t.force for t in tables),
                point=self.array(t.point for t in tables),
                acting=self.acting(t.body for t in tables),
            )
        ]

    def torques(self, tables: list[problem.ConstantTorque]) -> list[ForceLaw]:
        if not tables:
            return []
        return [
            ConstantTorque(
                torque=self.array(t.torque for t in tables),
                acting=self.acting(t.body for t in tables),
            )
        ]

    def drags(self, tables: list[problem.Drag]) -> list[ForceLaw]:
        if not tables:
            return []
        return [
            Drag(
                coefficient=self.array(t.coefficient for t in tables),
                acting=self.acting(t.body for t in tables),
            )
        ]

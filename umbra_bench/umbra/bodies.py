"""Bodies as the devlog stores them: inverse mass, inverse inertia, and what they are allowed to do.

Component rows first, bodies last: every array here has shape ``(3, N)``, rows x, y, angle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

Array = Any
"""A NumPy array, a JAX array or a JAX tracer: the physics is written once for all of them."""

BodyKind = Literal["dynamic", "static", "kinematic"]


def disk_inertia(mass: float, radius: float) -> float:
    """Moment of inertia of a solid disk about its centre, kg m^2: m r^2 / 2 (devlog, Newton's laws)."""
    return 0.5 * mass * radius * radius


def box_inertia(mass: float, width: float, height: float) -> float:
    """Moment of inertia of a solid rectangle about its centre, kg m^2: m (w^2 + h^2) / 12 (ditto)."""
    return mass * (width * width + height * height) / 12.0


@dataclass(frozen=True)
class BodyDefinition:
    """What a body is made of and how it starts.

    Args:
        mass: kg; 0 makes the body static.
        inertia: kg m^2; 0 means that no torque turns it. When absent it follows from the shape, and
            without a shape it is 1.0 x mass.
        box: width and height, m. disk_radius: m. At most one of the two.
        position, velocity: m, m/s. angle, angular_velocity: rad, rad/s.
        kind: a dynamic body moves by forces, a kinematic one by its velocity alone, a static one
            not at all.
        linear_damping, angular_damping: fraction of velocity kept per second, (0, 1].

    Raises:
        ValueError: a value that no body has; the message names the argument and the value.
    """

    mass: float = 1.0
    inertia: float | None = None
    box: tuple[float, float] | None = None
    disk_radius: float | None = None
    position: tuple[float, float] = (0.0, 0.0)
    angle: float = 0.0
    velocity: tuple[float, float] = (0.0, 0.0)
    angular_velocity: float = 0.0
    kind: BodyKind = "dynamic"
    affected_by_gravity: bool = True
    linear_damping: float = 1.0
    angular_damping: float = 1.0

    def __post_init__(self) -> None:
        for name in ("position", "angle", "velocity", "angular_velocity"):
            if not all(map(math.isfinite, _components(getattr(self, name)))):
                raise ValueError(f"{name} = {getattr(self, name)!r}: expected finite numbers")
        for name in ("mass", "inertia", "disk_radius"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} = {value!r}: expected a finite number >= 0")
        if self.box is not None and not all(0.0 < side < math.inf for side in self.box):
            raise ValueError(f"box = {self.box!r}: expected two finite numbers > 0")
        if self.box is not None and self.disk_radius is not None:
            raise ValueError(f"disk_radius = {self.disk_radius!r}: the body has a box already")
        if self.kind not in ("dynamic", "static", "kinematic"):
            raise ValueError(f"kind = {self.kind!r}: expected dynamic, static or kinematic")
        for name in ("linear_damping", "angular_damping"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(f"{name} = {getattr(self, name)!r}: expected a number in (0, 1]")
        for name in ("velocity", "angular_velocity"):
            if self.is_static and any(_components(getattr(self, name))):
                raise ValueError(f"{name} = {getattr(self, name)!r}: a static body does not move")

    @property
    def is_static(self) -> bool:
        return self.kind == "static" or (self.kind == "dynamic" and self.mass == 0.0)

    @property
    def moment_of_inertia(self) -> float:
        """The inertia as given, or computed from the shape, kg m^2."""
        if self.inertia is not None:
            return self.inertia
        if self.box is not None:
            return box_inertia(self.mass, *self.box)
        if self.disk_radius is not None:
            return disk_inertia(self.mass, self.disk_radius)
        return 1.0 * self.mass

    @property
    def inverse_masses(self) -> tuple[float, float, float]:
        """1/m, 1/m, 1/I: zero for a body that no force moves."""
        if self.kind != "dynamic" or self.mass == 0.0:
            return (0.0, 0.0, 0.0)
        inertia = self.moment_of_inertia
        return (1.0 / self.mass, 1.0 / self.mass, 1.0 / inertia if inertia > 0.0 else 0.0)


def _components(value: float | tuple[float, ...]) -> tuple[float, ...]:
    return value if isinstance(value, tuple) else (value,)


class Bodies(NamedTuple):
    """The constants of N bodies, each of shape (3, N) unless said.

    Attributes:
        mass: m, m, I as declared, kg and kg m^2.
        inverse_mass: 1/m, 1/m, 1/I; zero where no force moves the body.
        damping: fraction of velocity kept per second; None where all of it is kept by all.
        affected_by_gravity: shape (N,), booleans.
    """

    mass: Array
    inverse_mass: Array
    damping: Array | None
    affected_by_gravity: Array

    @classmethod
    def of(cls, definitions: Sequence[BodyDefinition], dtype: Any = np.float32) -> Bodies:
        """Collect definitions into arrays of `dtype`.

        A body of infinite mass is not damped: a kinematic one keeps the velocity that it was given.
        """
        mass = [(d.mass, d.mass, d.moment_of_inertia) for d in definitions]
        inverse = [d.inverse_masses for d in definitions]
        kept = [
            (d.linear_damping, d.linear_damping, d.angular_damping) if moved[0] else (1.0, 1.0, 1.0)
            for d, moved in zip(definitions, inverse, strict=True)
        ]

        def rows(columns: list[tuple[float, float, float]]) -> np.ndarray:
            return np.array(columns, dtype).reshape(-1, 3).T

        return cls(
            mass=rows(mass),
            inverse_mass=rows(inverse),
            damping=rows(kept) if any(each != (1.0, 1.0, 1.0) for each in kept) else None,
            affected_by_gravity=np.array([d.affected_by_gravity for d in definitions], bool),
        )


class UmbraState(NamedTuple):
    """What UMBRA keeps for each body between frames; shape (3, N) each, rows x, y, angle.

    Attributes:
        position: m, m, rad in [0, 2 pi).
        velocity: m/s, m/s, rad/s.
        acceleration: of the frame before, m/s^2, m/s^2, rad/s^2.
        force: the accumulators, N, N, N m.
    """

    position: Array
    velocity: Array
    acceleration: Array
    force: Array

    @classmethod
    def at(cls, position: Array, velocity: Array) -> UmbraState:
        """A state as created: nothing accumulated, no acceleration stored."""
        zeros_like = velocity.__array_namespace__().zeros_like
        return cls(position, velocity, zeros_like(velocity), zeros_like(velocity))

    @classmethod
    def of(cls, definitions: Sequence[BodyDefinition], dtype: Any = np.float32) -> UmbraState:
        """The state in which bodies are created."""
        position = [(*d.position, d.angle) for d in definitions]
        velocity = [(*d.velocity, d.angular_velocity) for d in definitions]
        return cls.at(
            np.array(position, dtype).reshape(-1, 3).T, np.array(velocity, dtype).reshape(-1, 3).T
        )

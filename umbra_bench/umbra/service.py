"""PhysicsService: the door that a game uses. It keeps the arrays; the physics is in the pipeline."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from umbra_bench.scenario import DEFAULT_STEP
from umbra_bench.umbra.bodies import Bodies, BodyDefinition, UmbraState
from umbra_bench.umbra.pipeline import gravity_force, step

Vector = tuple[float, float]


class BodyState(NamedTuple):
    """What a game reads of one body: m, rad, m/s, rad/s."""

    position: Vector
    angle: float
    velocity: Vector
    angular_velocity: float


class PhysicsService:
    """A world of bodies that moves by UMBRA's published pipeline.

    Args:
        gravity: m/s^2, on every body whose flag is set.
        precision: "float32", as the engine, or "float64".

    Every method raises ValueError for an unknown handle or a value that is not finite; the message
    names the argument and the value.
    """

    def __init__(self, gravity: Vector = (0.0, 0.0), precision: str = "float32") -> None:
        if precision not in ("float32", "float64"):
            raise ValueError(f"precision = {precision!r}: expected 'float32' or 'float64'")
        self._dtype: Any = np.dtype(precision).type
        self._gravity = np.array(_finite("gravity", gravity, 2), self._dtype)
        self._definitions: list[BodyDefinition] = []
        self._asleep: set[int] = set()
        self._collected: Bodies | None = None
        self._state = UmbraState.of([], self._dtype)

    def create_body(self, definition: BodyDefinition) -> int:
        """Add a body and return its handle."""
        self._definitions.append(definition)
        created = UmbraState.of([definition], self._dtype)
        self._state = UmbraState(
            *(
                np.concatenate([old, new], axis=1)
                for old, new in zip(self._state, created, strict=True)
            )
        )
        self._collected = None
        return len(self._definitions) - 1

    def apply_force(self, body: int, force: Vector) -> None:
        """Push at the centre of mass for the next step, N."""
        fx, fy = _finite("force", force, 2)
        self._accumulate(body, (fx, fy, 0.0))

    def apply_force_at_point(self, body: int, force: Vector, point: Vector) -> None:
        """Push at a point of the world for the next step, N, m: a force and the torque r x F."""
        fx, fy = _finite("force", force, 2)
        self._accumulate(body, (fx, fy, self._moment(body, (fx, fy), point)))

    def apply_torque(self, body: int, torque: float) -> None:
        """Twist for the next step, N m."""
        (moment,) = _finite("torque", (torque,), 1)
        self._accumulate(body, (0.0, 0.0, moment))

    def apply_impulse(self, body: int, impulse: Vector) -> None:
        """Change the velocity at once by J/m, N s."""
        jx, jy = _finite("impulse", impulse, 2)
        self._kick(body, (jx, jy, 0.0))

    def apply_impulse_at_point(self, body: int, impulse: Vector, point: Vector) -> None:
        """Change velocity and angular velocity at once by J/m and (r x J)/I, N s, m."""
        jx, jy = _finite("impulse", impulse, 2)
        self._kick(body, (jx, jy, self._moment(body, (jx, jy), point)))

    def sleep(self, body: int) -> None:
        """Stop a body: until woken, it has no velocity and an inverse mass of zero."""
        handle = self._handle(body)
        self._state.velocity[:, handle] = 0.0
        self._state.acceleration[:, handle] = 0.0
        self._asleep.add(handle)
        self._collected = None

    def wake(self, body: int) -> None:
        """Let a sleeping body move again, from rest."""
        self._asleep.discard(self._handle(body))
        self._collected = None

    def step(self, dt: float = DEFAULT_STEP) -> None:
        """Advance every body by one frame of `dt` seconds.

        Raises:
            ValueError: `dt` is not a finite number above zero.
        """
        if not (math.isfinite(dt) and dt > 0.0):
            raise ValueError(f"dt = {dt!r}: expected a finite number > 0, in s")
        pull = gravity_force(
            self._gravity, self._bodies.inverse_mass, self._bodies.affected_by_gravity
        )
        # Overflow is a result that the reader of the state sees, not an accident to warn of.
        with np.errstate(over="ignore", invalid="ignore"):
            state = self._state._replace(force=self._state.force + pull)
            self._state = step(self._bodies, state, self._dtype(dt))

    def read(self, body: int) -> BodyState:
        """The state of one body."""
        handle = self._handle(body)
        x, y, angle = (float(value) for value in self._state.position[:, handle])
        vx, vy, omega = (float(value) for value in self._state.velocity[:, handle])
        return BodyState((x, y), angle, (vx, vy), omega)

    def __len__(self) -> int:
        return len(self._definitions)

    @property
    def _bodies(self) -> Bodies:
        """The constants of all bodies, collected again after a body was created, slept or woke."""
        if self._collected is None:
            self._collected = Bodies.of(self._definitions, self._dtype)
            self._collected.inverse_mass[:, sorted(self._asleep)] = 0.0
        return self._collected

    def _handle(self, body: int) -> int:
        count = len(self._definitions)
        if not isinstance(body, (int, np.integer)) or not 0 <= body < count:
            raise ValueError(f"body = {body!r}: unknown handle; {count} bodies exist")
        return int(body)

    def _accumulate(self, body: int, force: tuple[float, float, float]) -> None:
        self._state.force[:, self._handle(body)] += self._represented("force", force)

    def _kick(self, body: int, impulse: tuple[float, float, float]) -> None:
        handle = self._handle(body)
        change = self._represented("impulse", impulse) * self._bodies.inverse_mass[:, handle]
        self._state.velocity[:, handle] += change

    def _represented(self, name: str, values: tuple[float, float, float]) -> np.ndarray:
        """The values in the precision of the engine, which must hold them."""
        with np.errstate(over="ignore"):
            array = np.array(values, self._dtype)
        if not np.isfinite(array).all():
            raise ValueError(f"{name} = {values!r}: beyond the engine's {np.dtype(self._dtype)}")
        return array

    def _moment(self, body: int, force: Vector, point: Vector) -> float:
        """r x F, with r from the centre of mass to the point."""
        px, py = _finite("point", point, 2)
        x, y = self._state.position[:2, self._handle(body)]
        return float((px - x) * force[1] - (py - y) * force[0])


def _finite(name: str, values: Any, count: int) -> tuple[float, ...]:
    numbers = tuple(float(value) for value in values)
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        shown = values[0] if count == 1 else values
        raise ValueError(f"{name} = {shown!r}: expected {count} finite number{'s'[: count - 1]}")
    return numbers

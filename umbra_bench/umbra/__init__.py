"""UMBRA's physics, part 1: how its devlog moves bodies.

- :mod:`bodies`: body definitions, inverse mass, inertia of shapes, and the arrays of many bodies;
- :mod:`pipeline`: the four stages, and the step that composes them as published;
- :mod:`repaired`: the same stages in the order that makes them second order;
- :mod:`uncorrected`: the published step without its a dt^2/2, to see what the term does;
- :mod:`service`: the door that a game uses.
"""

from umbra_bench.umbra.bodies import (
    Bodies,
    BodyDefinition,
    BodyKind,
    UmbraState,
    box_inertia,
    disk_inertia,
)
from umbra_bench.umbra.pipeline import (
    apply_damping,
    clear_accumulators,
    gravity_force,
    integrate_forces,
    integrate_velocities,
    step,
)
from umbra_bench.umbra.repaired import repaired_step
from umbra_bench.umbra.service import PhysicsService

__all__ = [
    "Bodies",
    "BodyDefinition",
    "BodyKind",
    "PhysicsService",
    "UmbraState",
    "apply_damping",
    "box_inertia",
    "clear_accumulators",
    "disk_inertia",
    "gravity_force",
    "integrate_forces",
    "integrate_velocities",
    "repaired_step",
    "step",
]

"""The table of contents of everything that can be measured.

Only names and facts live here, so that listing the methods imports no numerical library;
:mod:`umbra_bench.simulation` binds each name to its code.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from umbra_bench.errors import UmbraBenchError, hint

Kind = Literal["integrator", "umbra", "engine", "reference"]


@dataclass(frozen=True)
class Method:
    """One thing that is measured.

    `precision` is the precision that an engine keeps for itself, or None where the caller chooses.
    `studied` is false for what a study runs only when it is named.
    """

    name: str
    title: str
    kind: Kind
    precision: str | None = None
    studied: bool = True


METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method("explicit-euler", "Explicit Euler", "integrator"),
        Method("semi-implicit-euler", "Semi-implicit Euler", "integrator"),
        Method("velocity-verlet", "Velocity Verlet", "integrator"),
        Method("rk4", "Runge-Kutta 4", "integrator"),
        Method("yoshida4", "Yoshida 4", "integrator"),
        Method("umbra", "UMBRA, as published", "umbra"),
        Method("umbra-repaired", "UMBRA, repaired", "umbra"),
        Method("umbra-primed", "UMBRA, primed alone", "umbra", studied=False),
        Method("umbra-swapped", "UMBRA, phases swapped alone", "umbra", studied=False),
        Method("umbra-uncorrected", "UMBRA without a dt²/2", "umbra", studied=False),
        Method("umbra-service", "UMBRA, as a game calls it", "engine", "float32", studied=False),
        Method("pymunk", "pymunk, force before step", "engine", "float64"),
        Method("pymunk-velocity-func", "pymunk, force in callback", "engine", "float64"),
        Method("pymunk-spring", "pymunk, its own spring", "engine", "float64"),
        Method("reference", "Reference (Dopri8)", "reference", "float64", studied=False),
    )
}

PRECISIONS = ("float32", "float64")


def find_method(name: str) -> Method:
    """Return the method called `name`.

    Raises:
        UmbraBenchError: no method has that name; the message suggests the nearest.
    """
    try:
        return METHODS[name]
    except KeyError:
        raise UmbraBenchError(f"--method {name!r} is not a method{hint(name, METHODS)}") from None

"""The table of contents of everything that can be measured.

Only names and facts live here, so that listing the methods imports no numerical library;
:mod:`umbra_bench.simulation` binds each name to its code.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from typing import Literal

from umbra_bench.errors import EngineFailed, UmbraBenchError, hint

Kind = Literal["integrator", "umbra", "engine", "reference"]


@dataclass(frozen=True)
class Method:
    """One thing that is measured.

    `precision` is the precision that an engine keeps for itself, or None where the caller chooses.
    `studied` is false for what a study runs only when it is named. `package` is what a foreign engine
    imports, and `distribution` what installs it.
    """

    name: str
    title: str
    kind: Kind
    precision: str | None = None
    studied: bool = True
    package: str | None = None
    distribution: str | None = None

    @property
    def installed(self) -> bool:
        """Whether what it imports is there."""
        return self.package is None or importlib.util.find_spec(self.package) is not None

    @property
    def missing(self) -> str:
        """How to come by it, where it is not installed."""
        return (
            f"the engine needs {self.distribution}, which is not installed; `make engines` or "
            "`pip install 'umbra-bench[engines]'` installs it"
        )


def _engine(name: str, title: str, precision: str, package: str) -> Method:
    """A foreign engine, whose package and distribution share a name."""
    return Method(name, title, "engine", precision, package=package, distribution=package)


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
        _engine("pymunk", "pymunk, force before step", "float64", "pymunk"),
        _engine("pymunk-velocity-func", "pymunk, force in callback", "float64", "pymunk"),
        _engine("pymunk-spring", "pymunk, its own spring", "float64", "pymunk"),
        _engine("box2d", "Box2D", "float32", "Box2D"),
        _engine("bullet", "Bullet", "float64", "pybullet"),
        _engine("physx", "PhysX 5", "float32", "sapien"),
        _engine("mujoco-euler", "MuJoCo, Euler", "float64", "mujoco"),
        _engine("mujoco-rk4", "MuJoCo, Runge-Kutta 4", "float64", "mujoco"),
        Method("reference", "Reference (Dopri8)", "reference", "float64", studied=False),
    )
}

PRECISIONS = ("float32", "float64")


BROUGHT = ("native:", "process:")
"""How a method begins that names an engine which the reader brings: `native:PATH` is a shared library,
`process:COMMAND` a program."""

ENTRY_POINTS = "umbra_bench.engines"
"""The group of entry points in which a package names its engines."""


def entry_points() -> list[Method]:
    """The engines that installed packages name."""
    return [
        Method(point.name, point.value, "engine", studied=False)
        for point in metadata.entry_points(group=ENTRY_POINTS)
    ]


def find_method(name: str) -> Method:
    """Return the method called `name`: one of the table, or an engine that the reader brings.

    Raises:
        UmbraBenchError: no method has that name; the message suggests the nearest.
        EngineFailed: an engine in another process that does not answer.
    """
    if name in METHODS:
        return METHODS[name]
    if name.startswith(BROUGHT):
        from umbra_bench.engines.process import stated_precision

        return Method(name, name, "engine", stated_precision(name), studied=False)
    points = {point.name: point for point in metadata.entry_points(group=ENTRY_POINTS)}
    if name in points:
        try:
            precision = getattr(points[name].load(), "precision", "float64")
        except (ImportError, AttributeError) as error:
            raise EngineFailed(f"--method {name!r}: cannot be imported: {error}") from None
        if precision not in PRECISIONS:
            raise EngineFailed(
                f"--method {name!r}: precision = {precision!r}; allowed: {PRECISIONS}"
            )
        return Method(name, name, "engine", precision, studied=False)
    known = [*METHODS, *points, *(f"{prefix}..." for prefix in BROUGHT)]
    raise UmbraBenchError(f"--method {name!r} is not a method{hint(name, known)}") from None


def methods_of_study(methods: Sequence[str] = ()) -> list[str]:
    """The methods that a study runs: those named, or all that are studied unasked and installed.

    Raises:
        UmbraBenchError: a name that is none, is not installed or takes no steps.
    """
    names = list(dict.fromkeys(methods)) or [
        name for name, method in METHODS.items() if method.studied and method.installed
    ]
    for name in names:
        if not find_method(name).installed:
            raise UmbraBenchError(f"--method {name!r}: {find_method(name).missing}")
        if find_method(name).kind == "reference":
            raise UmbraBenchError(
                "--method 'reference': it is what the others are measured against; allowed: all others"
            )
    return names

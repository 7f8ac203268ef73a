"""A shared library as a process: `python -m umbra_bench.native_host PATH` speaks for it.

A crash in the library ends this process, and the harness lives on. Nothing but the standard library is
imported, so that it starts at once. The library's door is `examples/native/umbra_engine.h`.
"""

from __future__ import annotations

import ctypes
import json
import math
import os
import sys
from typing import Any

ABI = 1
KINDS = {"dynamic": 0, "static": 1, "kinematic": 2}


class Body(ctypes.Structure):
    """`struct umbra_body`."""

    _fields_ = (
        *((name, ctypes.c_double) for name in ("mass", "inertia", "x", "y", "angle")),
        *((name, ctypes.c_double) for name in ("vx", "vy", "omega")),
        ("kind", ctypes.c_int),
    )


class Library:
    """The eight functions of the header, answering the questions of the process door.

    Raises:
        OSError: no such library. AttributeError: it lacks a function of the header.
    """

    def __init__(self, path: str) -> None:
        library = ctypes.CDLL(path)
        pointer, number, integer = ctypes.c_void_p, ctypes.c_double, ctypes.c_int
        signatures: dict[str, tuple[Any, tuple[Any, ...]]] = {
            "abi": (integer, ()),
            "precision": (integer, ()),
            "create": (pointer, (ctypes.POINTER(Body), integer)),
            "destroy": (None, (pointer,)),
            "apply": (None, (pointer, integer, number, number, number)),
            "step": (None, (pointer, number)),
            "read": (None, (pointer, integer, ctypes.POINTER(number))),
            "set_velocity": (None, (pointer, integer, number, number, number)),
        }
        self._call: dict[str, Any] = {}
        for name, (result, arguments) in signatures.items():
            function = getattr(library, f"umbra_{name}")
            function.restype, function.argtypes = result, arguments
            self._call[name] = function
        self._engine: Any = None
        self._count = 0
        self._state = (number * 6)()

    def hello(self) -> dict[str, Any]:
        return {"abi": self._call["abi"](), "precision": f"float{self._call['precision']()}"}

    def create(self, bodies: list[dict[str, Any]]) -> dict[str, Any]:
        records = (Body * len(bodies))(
            *(
                Body(
                    body["mass"],
                    body["inertia"],
                    *body["position"],
                    body["angle"],
                    *body["velocity"],
                    body["angular_velocity"],
                    KINDS[body["kind"]],
                )
                for body in bodies
            )
        )
        self._engine = self._call["create"](records, len(bodies))
        self._count = len(bodies)
        return {} if self._engine else {"refused": "the library's umbra_create returned NULL"}

    def destroy(self) -> None:
        if self._engine:
            self._call["destroy"](self._engine)

    def step(self, dt: float, force: list[list[float]]) -> dict[str, Any]:
        for i, (fx, fy, torque) in enumerate(zip(*force, strict=True)):
            self._call["apply"](self._engine, i, fx, fy, torque)
        self._call["step"](self._engine, dt)
        rows = []
        for i in range(self._count):
            self._call["read"](self._engine, i, self._state)
            rows.append([value if math.isfinite(value) else None for value in self._state])
        columns = [list(column) for column in zip(*rows, strict=True)]
        return {"position": columns[:3], "velocity": columns[3:]}

    def set_velocity(self, velocity: list[list[float]]) -> dict[str, Any]:
        for i, (vx, vy, omega) in enumerate(zip(*velocity, strict=True)):
            self._call["set_velocity"](self._engine, i, vx, vy, omega)
        return {}


def main() -> None:
    """Answer question after question until the input ends."""
    # What the library itself prints, from its loading on, must not stand among the answers.
    with os.fdopen(os.dup(1), "w") as answers:
        os.dup2(2, 1)
        try:
            library = Library(sys.argv[1])
        except (OSError, AttributeError) as error:
            sys.exit(str(error))
        for line in sys.stdin:
            question = json.loads(line)
            answer = getattr(library, question.pop("ask"))(**question)
            answers.write(json.dumps(answer) + "\n")
            answers.flush()
        library.destroy()


if __name__ == "__main__":
    main()

"""Engines in a process of their own: a reader's command, or a shared library through its host.

One line of JSON out, one line of JSON back (`examples/process/engine.py` shows the four questions). An
engine that dies, is silent for too long or answers nonsense is an error with its reason and the end of
what it wrote to standard error; the harness lives on.

State precision: what the engine says. Gravity is one of the harness's force laws, and the harness
damps, as for every foreign engine.
"""

from __future__ import annotations

import contextlib
import functools
import json
import math
import selectors
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from umbra_bench.errors import EngineFailed, UnsupportedScenario, short
from umbra_bench.scenario import Scenario
from umbra_bench.system import body_definition, compiled_force

TIME_OUT = 10.0
"""How long an engine may take for an answer, s."""

ABI = 1


class Conversation:
    """Questions and answers with an engine's process.

    Raises:
        EngineFailed: in any method, where the process cannot be started, dies, is silent or answers
            something that is no answer.
    """

    def __init__(self, method: str) -> None:
        self._method = method
        self._process: subprocess.Popen[bytes] | None = None
        self._complaints = tempfile.TemporaryFile()  # noqa: SIM115 -- closed in close()
        self._selector = selectors.DefaultSelector()
        self._unread = b""
        try:
            self._process = subprocess.Popen(  # noqa: S603 -- the user's own command
                command_of(method),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._complaints,
            )
        except (OSError, ValueError, IndexError) as error:
            raise self._failure(f"cannot be started: {error}") from None
        assert self._process.stdout is not None
        self._selector.register(self._process.stdout, selectors.EVENT_READ)

    def ask(self, question: str, **details: Any) -> dict[str, Any]:
        """Ask one question and return the answer."""
        assert self._process is not None
        assert self._process.stdin is not None
        line = json.dumps({"ask": question, **details}, allow_nan=False).encode() + b"\n"
        try:
            self._process.stdin.write(line)
            self._process.stdin.flush()
        except (BrokenPipeError, ConnectionError):
            raise self._failure(self._death()) from None
        return self._answer(question)

    def _answer(self, question: str) -> dict[str, Any]:
        assert self._process is not None
        assert self._process.stdout is not None
        until = time.monotonic() + TIME_OUT
        while b"\n" not in self._unread:
            if not self._selector.select(max(0.0, until - time.monotonic())):
                raise self._failure(f"gave no answer to {question!r} for {TIME_OUT:g} s")
            part = self._process.stdout.read1(1 << 16)  # type: ignore[attr-defined]
            if not part:
                raise self._failure(self._death())
            self._unread += part
        line, _, self._unread = self._unread.partition(b"\n")
        try:
            answer = json.loads(line)
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict):
            said = short(line.decode(errors="replace"))
            raise self._failure(f"answered {said} to {question!r}")
        return answer

    def _death(self) -> str:
        """How the process ended."""
        assert self._process is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self._process.wait(1.0)
            if code < 0:
                return f"died of {signal.Signals(-code).name}"
            return f"ended with exit code {code}"
        return "closed its output"

    def _failure(self, what: str) -> EngineFailed:
        """The end of the conversation, with the last that the engine complained of."""
        self._end_process(patience=0.0)
        self._complaints.seek(0)
        lines = self._complaints.read().decode(errors="replace").split("\n")
        last = " / ".join(line.strip() for line in lines if line.strip())[-300:]
        self.close()
        return EngineFailed(
            f"--method {self._method!r}: {what}" + (f"; it said: {last}" if last else "")
        )

    def close(self) -> None:
        """End the process and let go of everything."""
        self._end_process(patience=1.0)
        self._selector.close()
        self._complaints.close()

    def _end_process(self, patience: float) -> None:
        if self._process is None:
            return
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        try:
            self._process.wait(patience)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __del__(self) -> None:
        self.close()


def command_of(method: str) -> list[str]:
    """The command that a method of the form `native:PATH` or `process:COMMAND` means."""
    kind, _, what = method.partition(":")
    if kind == "native":
        path = Path(what)
        library = str(path.resolve()) if path.exists() else what  # or where the loader looks
        return [sys.executable, "-m", "umbra_bench.native_host", library]
    return shlex.split(what)


@functools.lru_cache
def stated_precision(method: str) -> str:
    """The precision that an engine says it keeps.

    Raises:
        EngineFailed: as :class:`Conversation`, or an engine of another interface.
    """
    conversation = Conversation(method)
    try:
        answer = conversation.ask("hello")
    finally:
        conversation.close()
    if answer.get("abi") != ABI:
        raise EngineFailed(
            f"--method {method!r}: abi = {short(answer.get('abi'))}; this version speaks {ABI}"
        )
    precision = answer.get("precision")
    if precision not in ("float32", "float64"):
        raise EngineFailed(
            f"--method {method!r}: precision = {short(precision)}; allowed: float32, float64"
        )
    return str(precision)


class ProcessEngine:
    """An engine behind a conversation, with the bodies of a scenario."""

    damps_itself = False

    def __init__(self, method: str, scenario: Scenario) -> None:
        self._method = method
        self._force = compiled_force(scenario)
        self._shape = (3, len(scenario.bodies))
        self._conversation = Conversation(method)
        bodies = []
        for body in scenario.bodies:
            d = body_definition(body, scenario)
            bodies.append(
                {
                    "mass": d.mass,
                    "inertia": d.moment_of_inertia,
                    "position": d.position,
                    "angle": d.angle,
                    "velocity": d.velocity,
                    "angular_velocity": d.angular_velocity,
                    "kind": "static" if d.is_static else d.kind,
                }
            )
        refused = self._conversation.ask("create", bodies=bodies).get("refused")
        if refused is not None:
            raise UnsupportedScenario(f"{method}: {short(refused, 200)}")
        self._position = self._velocity = np.empty(self._shape)

    def step(self, dt: float, position: np.ndarray, velocity: np.ndarray) -> None:
        force = self._force(position, velocity)
        if not np.isfinite(force).all():  # it has diverged: no engine is asked what follows
            self._position = self._velocity = np.full(self._shape, np.nan)
            return
        answer = self._conversation.ask("step", dt=dt, force=force.tolist())
        self._position = self._array(answer, "position")
        self._velocity = self._array(answer, "velocity")

    def _array(self, answer: dict[str, Any], name: str) -> np.ndarray:
        """The part of an answer, null read as not a number."""
        try:
            array = np.array(answer.get(name), float)
        except (TypeError, ValueError):
            array = np.empty(0)
        if array.shape != self._shape:
            raise EngineFailed(
                f"--method {self._method!r}: {name} = {short(answer.get(name))} in its answer to "
                f"'step'; expected 3 rows (x, y, angle) of {self._shape[1]} numbers"
            )
        return array

    def read(self, position: np.ndarray, velocity: np.ndarray) -> None:
        position[:], velocity[:] = self._position, self._velocity

    def set_velocity(self, velocity: np.ndarray) -> None:
        if math.isfinite(velocity.sum()):
            self._conversation.ask("set_velocity", velocity=velocity.tolist())

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
import os
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

LONGEST_ANSWER = 1 << 10
"""How many parts of 64 kB an answer may have."""

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
            command = command_of(method)
            if not command:
                raise ValueError("no command is named")
            self._process = subprocess.Popen(  # noqa: S603 -- the user's own command
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._complaints,
                start_new_session=True,  # so that what it starts itself can be ended with it
            )
        except (OSError, ValueError) as error:
            raise self._failure(f"cannot be started: {error}") from None
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None
            os.set_blocking(stream.fileno(), False)

    def ask(self, question: str, **details: Any) -> dict[str, Any]:
        """Ask one question and return the answer."""
        line = json.dumps({"ask": question, **details}, allow_nan=False).encode() + b"\n"
        until = time.monotonic() + TIME_OUT
        self._write(line, question, until)
        return self._answer(question, until)

    def _write(self, line: bytes, question: str, until: float) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        stream = self._process.stdin.fileno()
        while line:
            self._wait(stream, selectors.EVENT_WRITE, question, until)
            try:
                line = line[os.write(stream, line) :]
            except BlockingIOError:
                continue
            except (BrokenPipeError, ConnectionError):
                raise self._failure(self._death()) from None

    def _answer(self, question: str, until: float) -> dict[str, Any]:
        assert self._process is not None
        assert self._process.stdout is not None
        stream = self._process.stdout.fileno()
        parts = [self._unread]
        while b"\n" not in parts[-1]:
            self._wait(stream, selectors.EVENT_READ, question, until)
            parts.append(os.read(stream, 1 << 16))
            if not parts[-1]:
                raise self._failure(self._death())
            if len(parts) > LONGEST_ANSWER:
                raise self._failure(f"answered more than {LONGEST_ANSWER >> 4} MB to {question!r}")
        line, _, self._unread = b"".join(parts).partition(b"\n")
        try:
            answer = json.loads(line)
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict):
            said = short(line.decode(errors="replace"))
            raise self._failure(f"answered {said} to {question!r}")
        return answer

    def _wait(self, stream: int, event: int, question: str, until: float) -> None:
        """Wait until a stream is ready, and no longer than the time-out."""
        self._selector.register(stream, event)
        try:
            ready = self._selector.select(max(0.0, until - time.monotonic()))
        finally:
            self._selector.unregister(stream)
        if not ready or time.monotonic() > until:
            raise self._failure(f"gave no answer to {question!r} for {TIME_OUT:g} s")

    def _death(self) -> str:
        """How the process ended."""
        assert self._process is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self._process.wait(1.0)
            if code < 0:
                known = {s.value: s.name for s in signal.Signals}
                return f"died of {known.get(-code, f'signal {-code}')}"
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
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()

    def __del__(self) -> None:
        self.close()


def _numbers(rows: Any) -> bool:
    """Whether rows hold numbers and nulls alone: not texts that look like numbers."""
    return all(v is None or type(v) in (int, float) for row in rows for v in row)


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
        rows = answer.get(name)
        try:
            told = np.array(rows, float)
            array = told if _numbers(rows) else np.empty(0)
        except (TypeError, ValueError, OverflowError):
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

"""What a claim is: a statement of the devlog, the numbers that decide it, and the verdict they give.

A statement names criteria: numbers that were measured, each beside the threshold that decides. Those
that are *required* make it hold or fail; those that are *limits* show under which condition it holds.
The verdict follows from them by :meth:`Evidence.verdict` alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

if TYPE_CHECKING:
    from umbra_bench.claims.lab import Lab

Verdict = Literal["holds", "holds with a condition", "fails", "waits"]

VERDICTS: tuple[Verdict, ...] = ("holds", "holds with a condition", "fails", "waits")


class Criterion(NamedTuple):
    """A measured number and the threshold that decides.

    Attributes:
        what: what was measured, in words.
        value: the measured number; not a number never meets a threshold.
        relation: on which side of the threshold the value has to be.
        unit: of value and threshold; empty for a ratio.
    """

    what: str
    value: float
    relation: Literal["<=", ">="]
    threshold: float
    unit: str = ""

    @property
    def met(self) -> bool:
        """Whether the value is on the right side, the threshold included."""
        if math.isnan(self.value):
            return False
        if self.relation == "<=":
            return self.value <= self.threshold
        return self.value >= self.threshold


def at_most(what: str, value: float, threshold: float, unit: str = "") -> Criterion:
    """A number that has to be small."""
    return Criterion(what, float(value), "<=", threshold, unit)


def at_least(what: str, value: float, threshold: float, unit: str = "") -> Criterion:
    """A number that has to be large."""
    return Criterion(what, float(value), ">=", threshold, unit)


@dataclass(frozen=True)
class Evidence:
    """What was measured for a statement.

    Attributes:
        required: all of them have to be met, or the statement fails.
        limits: where one of them is not met, the statement holds only under the condition.
        holds, condition, fails: one sentence of why, for each verdict that the numbers can give.
    """

    required: tuple[Criterion, ...]
    holds: str
    fails: str
    limits: tuple[Criterion, ...] = ()
    condition: str = ""

    @property
    def verdict(self) -> Verdict:
        """What follows from the numbers."""
        if not all(criterion.met for criterion in self.required):
            return "fails"
        if not all(criterion.met for criterion in self.limits):
            return "holds with a condition"
        return "holds"

    @property
    def why(self) -> str:
        """The sentence that belongs to the verdict."""
        return {
            "holds": self.holds,
            "holds with a condition": self.condition,
            "fails": self.fails,
        }[self.verdict]


class Waiting(Exception):
    """What a statement needs is not there yet; the message says what."""


class Statement(NamedTuple):
    """A checkable statement of the devlog.

    Attributes:
        name: by which it is called on the command line.
        place: the section of the devlog that makes it.
        text: the statement, in our own words.
        measure: runs what it takes and returns the evidence; raises :class:`Waiting`.
    """

    name: str
    place: str
    text: str
    measure: Callable[[Lab], Evidence]

    @property
    def chapter(self) -> str:
        """The module that holds it: statements of one chapter share their runs."""
        return self.measure.__module__.rpartition(".")[2]


STATEMENTS: dict[str, Statement] = {}
"""All statements, by name."""


def statement(
    name: str, place: str, text: str
) -> Callable[[Callable[[Lab], Evidence]], Callable[[Lab], Evidence]]:
    """Register a function as the measurement of a statement."""

    def register(measure: Callable[[Lab], Evidence]) -> Callable[[Lab], Evidence]:
        assert name not in STATEMENTS, f"two statements are named {name}"
        STATEMENTS[name] = Statement(name, place, text, measure)
        return measure

    return register

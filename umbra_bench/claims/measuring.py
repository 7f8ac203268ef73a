"""Measures statements and proofs, in processes."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import polars as pl

from umbra_bench.claims import frames, mass, steps, verlet
from umbra_bench.claims.lab import Lab
from umbra_bench.claims.proofs import PROOFS, Proof
from umbra_bench.claims.record import CURVES_SCHEMA, FORMAT, Found
from umbra_bench.claims.statement import STATEMENTS, Criterion, Statement, Waiting
from umbra_bench.errors import UmbraBenchError, hint
from umbra_bench.parallel import map_in_processes
from umbra_bench.results import environment

CHAPTERS = tuple(module.__name__.rpartition(".")[2] for module in (steps, verlet, mass, frames))

ORDERED = sorted(STATEMENTS.values(), key=lambda s: CHAPTERS.index(s.chapter))
"""All statements, in the order of the devlog's chapters."""

Listener = Callable[[str, int, int], None]

_LONGEST_FIRST = ("precision", "verlet", "symplectic", "steps", "identity", "stability")


def measure_all(
    subject: str = "umbra",
    *,
    processes: int | None = 1,
    listener: Listener = lambda what, done, total: None,
) -> Found:
    """Measure every statement and every proof; of another subject only those that depend on it.

    Args:
        subject: the method in UMBRA's place.
        processes: as in :func:`umbra_bench.study.run_study`.

    Raises:
        UmbraBenchError: a subject that is no method, or a scenario that is missing.
    """
    Lab(subject)
    names = sorted(
        (*CHAPTERS, *PROOFS),
        key=lambda name: _LONGEST_FIRST.index(name) if name in _LONGEST_FIRST else 99,
    )
    parts: dict[str, Any] = {}
    tasks = [(name, subject) for name in names]
    for name, part in zip(names, map_in_processes(_measure, tasks, processes), strict=True):
        parts[name] = part
        listener(name, len(parts), len(names))
    rows = {row["name"]: row for chapter in CHAPTERS for row in parts[chapter]}
    curves = [{"proof": name, **point} for name in PROOFS for point in parts[name].curves]
    document = {
        "format": FORMAT,
        "subject": subject,
        "statements": [
            rows[s.name] for s in ORDERED if subject == "umbra" or rows[s.name]["examines"]
        ],
        "proofs": {name: _plain(parts[name].rows) for name in PROOFS},
        "environment": environment([]),
    }
    return Found(document, pl.DataFrame(curves, CURVES_SCHEMA))


def _measure(task: tuple[str, str]) -> list[dict[str, Any]] | Proof:
    name, subject = task
    lab = _shared_lab(subject)
    if name in PROOFS:
        return PROOFS[name](lab)
    return [measure_one(s, lab) for s in ORDERED if s.chapter == name]


@functools.lru_cache
def _shared_lab(subject: str) -> Lab:
    """One lab a process, so that its chapters share references and sweeps."""
    return Lab(subject)


def measure_one(statement: Statement, lab: Lab) -> dict[str, Any]:
    """A statement with its figures, its verdict and the reason, ready to be kept."""
    row: dict[str, Any] = {
        "name": statement.name,
        "place": statement.place,
        "statement": statement.text,
    }
    lab.examined = False
    try:
        evidence = statement.measure(lab)
    except Waiting as reason:
        return {**row, "verdict": "waits", "why": str(reason), "criteria": [], "examines": False}
    row["examines"] = lab.examined  # whether it depends on the method in UMBRA's place
    criteria = [
        *(_criterion(criterion, decides="fails") for criterion in evidence.required),
        *(_criterion(criterion, decides="holds with a condition") for criterion in evidence.limits),
    ]
    return {**row, "verdict": evidence.verdict, "why": evidence.why, "criteria": criteria}


def _criterion(criterion: Criterion, decides: str) -> dict[str, Any]:
    """`decides`: the verdict where it is not met."""
    return {**_plain(criterion._asdict()), "met": criterion.met, "otherwise": decides}


def _plain(value: Any) -> Any:
    """JSON's own types; a number that is not finite is none."""
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_plain(part) for part in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def names() -> list[str]:
    """What can be measured alone: the statements, then the proofs."""
    return [*(s.name for s in ORDERED), *PROOFS]


def measure_named(wanted: Sequence[str], subject: str = "umbra") -> Found:
    """Measure some statements and proofs alone.

    Raises:
        UmbraBenchError: a name that is none, or as :func:`measure_all`.
    """
    for name in wanted:
        if name not in names():
            raise UmbraBenchError(f"--only {name!r}: no statement or proof{hint(name, names())}")
    lab = Lab(subject)
    proofs = {name: PROOFS[name](lab) for name in wanted if name in PROOFS}
    document = {
        "format": FORMAT,
        "subject": subject,
        "statements": [measure_one(STATEMENTS[name], lab) for name in wanted if name in STATEMENTS],
        "proofs": {name: _plain(proof.rows) for name, proof in proofs.items()},
    }
    curves = [{"proof": name, **point} for name, p in proofs.items() for point in p.curves]
    return Found(document, pl.DataFrame(curves, CURVES_SCHEMA))

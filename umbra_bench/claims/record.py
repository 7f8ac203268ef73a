"""What was measured, on disk beside the other results."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import polars as pl
from pydantic import BaseModel, ConfigDict

from umbra_bench.errors import UmbraBenchError
from umbra_bench.results import RESULTS, load_json, save_json, together, write_table
from umbra_bench.soundness import Machine, check_document

FORMAT = "umbra-bench claims 1"

CURVES_SCHEMA: dict[str, Any] = {
    "proof": pl.String,
    "series": pl.String,
    "x": pl.Float64,
    "measured": pl.Float64,
    "predicted": pl.Float64,
}


class _Criterion(BaseModel):
    model_config = ConfigDict(strict=True)

    what: str
    value: float | None
    relation: Literal["<=", ">="]
    threshold: float
    unit: str
    met: bool
    otherwise: str


class _Statement(BaseModel):
    model_config = ConfigDict(strict=True)

    name: str
    place: str
    statement: str
    verdict: Literal["holds", "holds with a condition", "fails", "waits"]
    why: str
    examines: bool
    criteria: list[_Criterion]


class _Document(BaseModel):
    """`claims.json`, as far as pages other than the claims' own rely on it."""

    model_config = ConfigDict(strict=True)

    subject: str
    statements: list[_Statement]
    proofs: dict[str, list[dict[str, Any]]]
    environment: Machine


@dataclass(frozen=True)
class Found:
    """What was measured: a document for the page, and a table of the curves of its figures."""

    document: dict[str, Any]
    curves: pl.DataFrame


def save_claims(found: Found, folder: Path = RESULTS) -> None:
    """Write `claims.json` and the curves.

    Raises:
        UmbraBenchError: the folder cannot be written.
    """
    with together(folder, "claims") as fresh:
        write_table(found.curves, "claims_curves", fresh)
        save_json(found.document, fresh / "claims.json")


def load_claims(folder: Path = RESULTS) -> dict[str, Any]:
    """Read `claims.json`.

    Raises:
        UmbraBenchError: it is missing or of another kind.
    """
    path = folder / "claims.json"
    if not path.is_file():
        raise UmbraBenchError(f"{path}: missing; run `umbra-bench claims` (or `make claims`) first")
    document = load_json(path)
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise UmbraBenchError(
            f"{path}: not written by this version; run `umbra-bench claims` again"
        )
    return check_document(document, _Document, path)

"""What a table or a document must hold to be read: columns, ranges, names; one line where it does not.

A file of results may come from another version, another machine or a damaged disk. What is stated here
is what everything that reads results relies on.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import polars as pl
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from umbra_bench.errors import UmbraBenchError, one_line, short
from umbra_bench.methods import PRECISIONS
from umbra_bench.schemas import (
    DRIFT_LINE,
    ENERGY_SCHEMA,
    MOTION_SCHEMA,
    ORDERS_SCHEMA,
    QUANTITIES,
    REFERENCES_SCHEMA,
    SKIPS_SCHEMA,
    STUDY_SCHEMA,
)

SCHEMAS: dict[str, dict[str, Any]] = {
    "study": STUDY_SCHEMA,
    "orders": ORDERS_SCHEMA,
    "references": REFERENCES_SCHEMA,
    "skips": SKIPS_SCHEMA,
    "motion": MOTION_SCHEMA,
    "energy": ENERGY_SCHEMA,
}
"""The columns of the tables of a study."""

_KEYS: dict[str, tuple[str, ...]] = {
    "study": ("scenario", "method", "precision", "dt"),
    "orders": ("scenario", "method", "precision", "quantity"),
    "references": ("scenario",),
    "drift": DRIFT_LINE,
    "drift_series": (*DRIFT_LINE, "step"),
}
"""What tells the rows of a table apart: no two are alike in these columns."""

_MAY_BE_EMPTY = ("diverged_at", "energy_drift", "angular_momentum_drift", "predicted")

_POSITIVE = ("dt", "position_bound", "velocity_bound", "energy_bound")
_SCALES = ("length_scale", "speed_scale", "energy_scale", "angular_momentum_scale")
_NOT_NEGATIVE = (
    *("t", "reference_error", "wall_time", "diverged_at"),
    *("independent_difference", "tolerance_difference", "energy_drift", "angular_momentum_drift"),
)
_ERRORS = (
    *("position_error_max", "velocity_error_max", "position_error_final"),
    *("energy_error_max", "angular_momentum_error_max"),
)


def _rules(columns: Mapping[str, Any]) -> dict[str, tuple[pl.Expr, str]]:
    """For each column that has one: what its values satisfy, and that in words."""
    rules: dict[str, tuple[pl.Expr, str]] = {}
    for name in columns:
        value = pl.col(name)
        if name in (*_POSITIVE, *_SCALES):
            rules[name] = value.is_finite() & (value > 0.0), "a finite number > 0"
        elif name in _NOT_NEGATIVE:
            rules[name] = value.is_finite() & (value >= 0.0), "a finite number >= 0"
        elif name in _ERRORS:
            rules[name] = value.is_not_nan() & (value >= 0.0), "a number >= 0, or infinite"
    if "scenario" in columns:
        # Names of scenarios name files of figures.
        name_of_file = ~pl.col("scenario").str.contains(r"[/\\\x00]|^\.*$")
        rules["scenario"] = name_of_file, "a name that a file can have"
    if {"scenario", "precision"} <= {*columns}:
        rules["precision"] = pl.col("precision").is_in(PRECISIONS), " or ".join(PRECISIONS)
    if "quantity" in columns:
        rules["quantity"] = pl.col("quantity").is_in(list(QUANTITIES)), ", ".join(QUANTITIES)
    for name, least in (("steps", 1), ("points", 0)):
        if name in columns:
            rules[name] = pl.col(name) >= least, f"a whole number >= {least}"
    return rules


def check_table(
    table: pl.DataFrame, name: str, path: object, schema: Mapping[str, Any] | None = None
) -> None:
    """Refuse a table that is not what its name says.

    `schema`: its columns, where it is not a table of a study.

    Raises:
        UmbraBenchError: a column is missing or of another type, or a row holds what no study writes.
    """
    schema = schema or SCHEMAS.get(name)
    if schema is None:
        return
    for column, dtype in schema.items():
        if column not in table.columns:
            raise UmbraBenchError(f"{path}: column {column!r}: missing; run the command again")
        if table.schema[column] != dtype:
            raise UmbraBenchError(
                f"{path}: column {column!r}: holds {table.schema[column]}; expected {dtype}"
            )
        _refuse_first(table, table[column].is_null(), column, path, "a value")
    for column, (holds, words) in _rules(schema).items():
        sound = table.select(holds.fill_null(column in _MAY_BE_EMPTY)).to_series()
        _refuse_first(table, ~sound, column, path, words)
    key = _KEYS.get(name)
    if key is not None and table.height:
        twice = ~table.select(pl.struct(key).is_first_distinct()).to_series()
        if twice.any():
            row = int(twice.arg_max() or 0)
            raise UmbraBenchError(
                one_line(f"{path}: row {row + 1}: the same {', '.join(key)} as a row before")
            )


def _refuse_first(
    table: pl.DataFrame, wrong: pl.Series, column: str, path: object, words: str
) -> None:
    if column in _MAY_BE_EMPTY:
        wrong = wrong & table[column].is_not_null()
    if wrong.any():
        row = int(wrong.arg_max() or 0)
        value = short(table[column][row])
        raise UmbraBenchError(f"{path}: row {row + 1}: {column} = {value}: expected {words}")


# Documents ----------------------------------------------------------------------------------------


class Machine(BaseModel):
    """What numbers depend on, whatever was measured."""

    model_config = ConfigDict(strict=True)

    python: str
    platform: str
    processor: str
    cores: int | None
    packages: dict[str, str]


class Environment(Machine):
    """What the numbers of a study depend on, as `environment.json` states it."""

    scenarios: dict[str, Annotated[str, Field(pattern="^[0-9a-f]{64}$")]]
    fingerprint: str | None = None


def check_document(value: Any, form: type[BaseModel], path: object) -> dict[str, Any]:
    """Return a document of JSON as it is, if it has the form.

    Raises:
        UmbraBenchError: a key is missing or holds what it may not.
    """
    try:
        form.model_validate(value)
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
    else:
        return dict(value)
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in fault["loc"])
    given = "" if fault["type"] == "missing" else f" = {short(fault['input'])}"
    where = f"{key.removeprefix('.')}{given}" if key else "the whole"
    raise UmbraBenchError(one_line(f"{path}: {where}: {fault['msg']}"))

"""The columns of the tables of a study: what those who write and those who read agree on."""

from __future__ import annotations

from typing import Any

import polars as pl

QUANTITIES = {
    "position": "position_error_max",
    "velocity": "velocity_error_max",
    "energy": "energy_error_max",
}
"""The quantities whose order is observed, and the column that holds their error."""

STUDY_SCHEMA: dict[str, Any] = {
    "scenario": pl.String,
    "method": pl.String,
    "precision": pl.String,
    "dt": pl.Float64,
    "steps": pl.Int64,
    "position_error_max": pl.Float64,
    "velocity_error_max": pl.Float64,
    "position_error_final": pl.Float64,
    "energy_error_max": pl.Float64,
    "energy_drift_rate": pl.Float64,
    "angular_momentum_error_max": pl.Float64,
    "reference_error": pl.Float64,
    "diverged_at": pl.Float64,
    "wall_time": pl.Float64,
}

ORDERS_SCHEMA: dict[str, Any] = {
    "scenario": pl.String,
    "method": pl.String,
    "precision": pl.String,
    "quantity": pl.String,
    "order": pl.Float64,
    "standard_error": pl.Float64,
    "points": pl.Int64,
}

REFERENCES_SCHEMA: dict[str, Any] = {
    "scenario": pl.String,
    "position_bound": pl.Float64,
    "velocity_bound": pl.Float64,
    "energy_bound": pl.Float64,
    "independent": pl.String,
    "independent_difference": pl.Float64,
    "tolerance_difference": pl.Float64,
    "energy_drift": pl.Float64,
    "angular_momentum_drift": pl.Float64,
    "length_scale": pl.Float64,
    "speed_scale": pl.Float64,
    "energy_scale": pl.Float64,
    "angular_momentum_scale": pl.Float64,
}

SKIPS_SCHEMA: dict[str, Any] = {"scenario": pl.String, "method": pl.String, "reason": pl.String}

MOTION_SCHEMA: dict[str, Any] = {
    "scenario": pl.String,
    "method": pl.String,
    "precision": pl.String,
    "dt": pl.Float64,
    "t": pl.Float64,
    "body": pl.String,
    **dict.fromkeys(("x", "y", "angle", "vx", "vy", "omega"), pl.Float64),
}

ENERGY_SCHEMA: dict[str, Any] = {
    "scenario": pl.String,
    "method": pl.String,
    "precision": pl.String,
    "dt": pl.Float64,
    "t": pl.Float64,
    "energy_error": pl.Float64,
    "lowest": pl.Float64,
    "highest": pl.Float64,
}

ENGINES_SCHEMA: dict[str, Any] = {
    "method": pl.String,
    "version": pl.String,
    "precision": pl.String,
    "integrator": pl.String,
    "velocity": pl.String,
    "position_order": pl.Float64,
    "energy_error_100": pl.Float64,
    "energy_error_60": pl.Float64,
}

DRIFT_LINE = ("scenario", "method", "precision", "dt")
"""What tells long runs apart."""

ENGINE_STEPS = (0.04, 0.02, 0.01, 0.005)
"""The steps, in s, over which the order of an engine's table is observed."""

DRIFT_SERIES_SCHEMA: dict[str, Any] = {
    "scenario": pl.String,
    "method": pl.String,
    "precision": pl.String,
    "dt": pl.Float64,
    "step": pl.Int64,
    "t": pl.Float64,
    "energy_error": pl.Float64,
    "lowest": pl.Float64,
    "highest": pl.Float64,
}

DRIFT_SCHEMA: dict[str, Any] = {
    "scenario": pl.String,
    "method": pl.String,
    "precision": pl.String,
    "dt": pl.Float64,
    "steps": pl.Int64,
    "energy_error_max": pl.Float64,
    "law": pl.String,
    "rate": pl.Float64,
    "exponent": pl.Float64,
    "standard_error": pl.Float64,
    "evidence": pl.Float64,
    "runner_up": pl.String,
    "diverged_at": pl.Float64,
}

"""The tables on disk: written whole or not at all, read back as they were.

Every table stands as CSV, to be read by people and diffs, and as Parquet, to be read by programs.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import tempfile
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from umbra_bench.errors import UmbraBenchError
from umbra_bench.scenario import Scenario, scenario_hash

if TYPE_CHECKING:
    from umbra_bench.study import Study

RESULTS = Path("results")
"""Where results are written and read by default."""

TABLES = ("study", "orders", "references", "skips")
SERIES = ("motion", "energy")
"""Tables of trajectories: Parquet alone, for pictures."""

_ENGINES = ("pymunk", "Box2D", "pybullet", "sapien", "mujoco")
_PACKAGES = ("umbra-bench", "numpy", "scipy", "jax", "jaxlib", "diffrax", "polars", *_ENGINES)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file that takes the place of `path` when the block ends well, and not before.

    Raises:
        UmbraBenchError: the folder or the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            temporary.chmod(0o644)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise UmbraBenchError(f"{path}: cannot be written: {error.strerror}") from None


def save_study(study: Study, folder: Path = RESULTS) -> None:
    """Write a study's tables and its environment into a folder.

    Raises:
        UmbraBenchError: as :func:`replacing`.
    """
    tables = dict(
        zip(TABLES, (study.runs, study.orders, study.references, study.skips), strict=True)
    )
    for name, table in tables.items():
        save_table(table, name, folder)
    for name, table in zip(SERIES, (study.motion, study.energy), strict=True):
        _write(folder / f"{name}.parquet", table.write_parquet)
    save_json(described(study.scenarios), folder / "scenarios.json")
    save_json(environment(study.scenarios), folder / "environment.json")


def save_table(table: pl.DataFrame, name: str, folder: Path = RESULTS) -> None:
    """Write a table as CSV and as Parquet.

    Raises:
        UmbraBenchError: as :func:`replacing`.
    """
    _write(folder / f"{name}.csv", table.write_csv)
    _write(folder / f"{name}.parquet", table.write_parquet)


def described(scenarios: list[Scenario]) -> dict[str, Any]:
    """What the scenarios of a study state, by name."""
    return {s.name: s.model_dump(mode="json", exclude_none=True) for s in scenarios}


def save_json(value: Any, path: Path) -> None:
    """Write JSON that diffs well."""
    text = json.dumps(value, indent=2, sort_keys=True, allow_nan=False) + "\n"
    _write(path, lambda temporary: Path(temporary).write_text(text, encoding="utf-8"))


def load_table(name: str, folder: Path = RESULTS) -> pl.DataFrame:
    """Read a table of a study.

    Raises:
        UmbraBenchError: the table is missing or cannot be read.
    """
    path = folder / f"{name}.parquet"
    try:
        return pl.read_parquet(path, glob=False)
    except FileNotFoundError:
        raise UmbraBenchError(
            f"{path}: missing; run `umbra-bench study` (or `make study`) first"
        ) from None
    except (pl.exceptions.PolarsError, OSError) as error:
        reason = str(error).splitlines()[0]
        raise UmbraBenchError(f"{path}: cannot be read as Parquet: {reason}") from None


def load_json(path: Path) -> Any:
    """Read JSON.

    Raises:
        UmbraBenchError: the file is missing or is not JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UmbraBenchError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise UmbraBenchError(f"{path}: is not valid JSON: {error}") from None


def environment(scenarios: list[Scenario]) -> dict[str, Any]:
    """What numbers depend on: versions, the processor, the scenarios' hashes."""
    return {
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
        "processor": processor(),
        "cores": os.cpu_count(),
        "packages": {name: metadata.version(name) for name in _PACKAGES if _is_installed(name)},
        "scenarios": {scenario.name: scenario_hash(scenario) for scenario in scenarios},
    }


def _is_installed(distribution: str) -> bool:
    try:
        metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return False
    return True


def processor() -> str:
    """The processor's name, as the system tells it."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"


def _write(path: Path, write: Callable[[Path], Any]) -> None:
    with replacing(path) as temporary:
        write(temporary)

"""The tables on disk: written whole or not at all, read back as they were.

Every table stands as CSV, to be read by people and diffs, and as Parquet, to be read by programs.
"""

from __future__ import annotations

import contextlib
import fcntl
import glob
import hashlib
import io
import json
import os
import platform
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from umbra_bench.errors import ScenarioError, UmbraBenchError, one_line, short
from umbra_bench.scenario import Scenario, parse_scenario, scenario_hash
from umbra_bench.soundness import Environment, check_document, check_table

if TYPE_CHECKING:
    from umbra_bench.study import Study

RESULTS = Path("results")
"""Where results are written and read by default."""

TABLES = ("study", "orders", "references", "skips")
SERIES = ("motion", "energy")
"""Tables of trajectories: Parquet alone, for pictures."""

LARGEST_FILE = 2**28
"""The largest file of results that is read, bytes."""

PATIENCE = 10.0
"""How long to wait for another command that is writing into the same folder, s."""

_ENGINES = ("pymunk", "Box2D", "pybullet", "sapien", "mujoco")
_SOLVER = ("jax", "jaxlib", "diffrax", "equinox")
_PACKAGES = ("umbra-bench", "numpy", "scipy", *_SOLVER, "polars", *_ENGINES)


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
    except (OSError, pl.exceptions.PolarsError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UmbraBenchError(one_line(f"{path}: cannot be written: {reason}")) from None


@contextlib.contextmanager
def together(folder: Path, name: str) -> Iterator[Path]:
    """A folder whose files take their places in `folder` when the block ends well: all, or none.

    Their SHA-256 stand in `NAME.sha256` beside them (`sha256sum --check` reads it), so that files which
    were damaged or come from two runs are never read as one. Killed at any moment, the old files or
    the new ones are whole: those of `.NAME.ready`, where there is one, count before those in place.

    Raises:
        UmbraBenchError: the folder or a file cannot be written, or another command is writing there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with alone_at(folder, PATIENCE):
            _put_in_place(folder)
            fresh = Path(tempfile.mkdtemp(dir=folder, prefix=f".{name}.new."))
            try:
                yield fresh
                _seal(fresh, name)
                fresh.replace(folder / f".{name}.ready")  # this moment decides
                _put_in_place(folder)
            except UmbraBenchError as error:  # of a file, which is known by its place
                raise UmbraBenchError(str(error).replace(str(fresh), str(folder))) from None
            finally:
                shutil.rmtree(fresh, ignore_errors=True)
    except OSError as error:
        raise UmbraBenchError(f"{folder}: cannot be written: {error.strerror or error}") from None


@contextlib.contextmanager
def alone_at(place: Path, patience: float = 0.0) -> Iterator[None]:
    """Be the only command that writes a file, or into a folder.

    The lock is the folder, or a file `.NAME.lock` that stays; the system lets go of it however this
    process ends. What a command that was killed left of a file half written is removed.

    Raises:
        UmbraBenchError: another command holds it for longer than `patience`, s, or it cannot be written.
    """
    try:
        if place.is_dir():
            handle = os.open(place, os.O_RDONLY)
        else:
            place.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(place.with_name(f".{place.name}.lock"), os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise UmbraBenchError(f"{place}: cannot be written: {error.strerror}") from None
    try:
        until = time.monotonic() + patience
        while True:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > until:
                    raise UmbraBenchError(
                        f"{place}: another command is writing there; try again when it is done"
                    ) from None
                time.sleep(0.02)
        if not place.is_dir():
            for left in place.parent.glob(f".{glob.escape(place.name)}.{'?' * 8}"):
                left.unlink(missing_ok=True)
        yield
    finally:
        os.close(handle)


def _put_in_place(folder: Path) -> None:
    """Finish what was decided, and remove what a command that was killed left undecided."""
    for ready in folder.glob(".*.ready"):
        for file in sorted(ready.iterdir()):
            file.replace(folder / file.name)
        ready.rmdir()
    for left in folder.glob(".*.new.*"):
        shutil.rmtree(left, ignore_errors=True)


def _seal(folder: Path, name: str) -> None:
    lines = [f"{_digest(path)}  {path.name}\n" for path in sorted(folder.iterdir())]
    seal = folder / f"{name}.sha256"
    seal.write_text("".join(lines), encoding="utf-8")


def _digest(path: Path) -> str:
    """The SHA-256 of a file of any size."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_there(path: Path) -> bool:
    """Whether a file of results is decided: in place, or about to be put there."""
    return bool(_places(path.parent, glob.escape(path.name)))


def check_seal(path: Path) -> None:
    """Refuse a table that is not what was written, without reading all of it at once.

    Raises:
        UmbraBenchError: as :func:`read_sealed`, `required`.
    """
    try:
        digest = _digest(path)
    except OSError as error:
        raise UmbraBenchError(f"{path}: cannot be read: {error.strerror}") from None
    _refuse_damaged(path, digest, required=True)


def read_sealed(path: Path, *, required: bool = False) -> bytes:
    """The content of a file of results; if it was written with others, exactly what was written.

    `required`: whether a file without a seal is refused, since the one who reads it can bear no damage.

    Raises:
        UmbraBenchError: it is missing, cannot be read or is not what was written.
    """
    content = _read(path)
    _refuse_damaged(path, hashlib.sha256(content).hexdigest(), required)
    return content


def _refuse_damaged(path: Path, digest: str, required: bool) -> None:
    stated = _stated_digests(path)
    if stated and digest not in stated:
        raise UmbraBenchError(
            f"{path}: is not what was written (see *.sha256 beside it): damaged, or of another run; "
            "remove it, and run the command that makes it again"
        )
    if required and not stated:
        raise UmbraBenchError(
            f"{path}: has no seal (a line in a *.sha256 beside it), so damage could not be told; "
            "remove it, and run the command that makes it again"
        )


def _stated_digests(path: Path) -> set[str]:
    """What the seals beside a file state of it."""
    seals = {place.name for place in _places(path.parent, "*.sha256")}
    lines = [
        line.partition("  ")
        for seal in seals
        for line in _read(path.parent / seal).decode("utf-8", "replace").splitlines()
    ]
    return {digest for digest, _, name in lines if name == path.name}


def _places(folder: Path, pattern: str) -> list[Path]:
    """Files that are decided but not yet in place, then those in place."""
    return [*folder.glob(f".*.ready/{pattern}"), *folder.glob(pattern)]


def _read(path: Path) -> bytes:
    reason = "missing; run `umbra-bench study` (or `make study`) first"
    for place in (*path.parent.glob(f".*.ready/{glob.escape(path.name)}"), path):
        try:
            if place.is_file():
                if place.stat().st_size > LARGEST_FILE:
                    reason = f"is larger than {LARGEST_FILE} bytes, the most that is allowed"
                    break
                return place.read_bytes()
        except FileNotFoundError:  # it took its place this moment
            continue
        except (OSError, ValueError) as error:
            reason = f"cannot be read: {getattr(error, 'strerror', None) or error}"
            break
    raise UmbraBenchError(f"{path}: {reason}")


def save_study(study: Study, folder: Path = RESULTS, asked: str | None = None) -> None:
    """Write a study's tables and its environment into a folder: all of them, or none.

    `asked`: its :func:`fingerprint`, by which :func:`holds` knows it again.

    Raises:
        UmbraBenchError: as :func:`together`.
    """
    tables = dict(
        zip(TABLES, (study.runs, study.orders, study.references, study.skips), strict=True)
    )
    with together(folder, "study") as fresh:
        for name, table in tables.items():
            write_table(table, name, fresh)
        for name, table in zip(SERIES, (study.motion, study.energy), strict=True):
            _write(fresh / f"{name}.parquet", table.write_parquet)
        save_json(described(study.scenarios), fresh / "scenarios.json")
        made = environment(study.scenarios) | ({"fingerprint": asked} if asked else {})
        save_json(made, fresh / "environment.json")


def save_table(table: pl.DataFrame, name: str, folder: Path = RESULTS) -> None:
    """Write a table as CSV and as Parquet, sealed.

    Raises:
        UmbraBenchError: as :func:`together`.
    """
    with together(folder, name) as fresh:
        write_table(table, name, fresh)


def write_table(table: pl.DataFrame, name: str, folder: Path) -> None:
    """Write a table as CSV and as Parquet into a folder of :func:`together`, which seals it."""
    _write(folder / f"{name}.csv", table.write_csv)
    _write(folder / f"{name}.parquet", table.write_parquet)


def described(scenarios: list[Scenario]) -> dict[str, Any]:
    """What the scenarios of a study state, by name."""
    return {s.name: s.model_dump(mode="json", exclude_none=True) for s in scenarios}


def save_json(value: Any, path: Path) -> None:
    """Write JSON that diffs well."""
    text = json.dumps(value, indent=2, sort_keys=True, allow_nan=False) + "\n"
    _write(path, lambda temporary: Path(temporary).write_text(text, encoding="utf-8"))


def load_table(
    name: str, folder: Path = RESULTS, schema: Mapping[str, Any] | None = None
) -> pl.DataFrame:
    """Read a table of a study, or of the columns `schema`.

    Raises:
        UmbraBenchError: the table is missing, cannot be read or is not what its name says.
    """
    path = folder / f"{name}.parquet"
    content = read_sealed(path, required=True)  # a damaged one can end the interpreter
    try:
        table = pl.read_parquet(io.BytesIO(content))
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        reason = (str(error).splitlines() or ["it is damaged"])[0]
        raise UmbraBenchError(one_line(f"{path}: cannot be read as Parquet: {reason}")) from None
    check_table(table, name, path, schema)
    return table


def load_json(path: Path) -> Any:
    """Read JSON.

    Raises:
        UmbraBenchError: the file is missing, is not JSON or states a key twice.
    """
    content = read_sealed(path)
    try:
        return json.loads(content.decode("utf-8"), object_pairs_hook=_distinct_keys)
    except (ValueError, RecursionError) as error:
        raise UmbraBenchError(one_line(f"{path}: is not valid JSON: {error}")) from None


def _distinct_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    document = dict(pairs)
    if len(document) < len(pairs):
        twice = next(key for key, count in Counter(key for key, _ in pairs).items() if count > 1)
        raise ValueError(f"the key {short(twice)} is stated twice")
    return document


def load_scenarios(folder: Path = RESULTS) -> dict[str, Any]:
    """What the scenarios of a study state, by name; each is a scenario as its file would be.

    Raises:
        UmbraBenchError: `scenarios.json` is missing or describes what is no scenario.
    """
    path = folder / "scenarios.json"
    described = load_json(path)
    if not (isinstance(described, dict) and described):
        raise UmbraBenchError(f"{path}: expected a table of scenarios by name")
    for name, document in described.items():
        if not isinstance(document, dict):
            raise UmbraBenchError(one_line(f"{path}: {name}: expected a scenario"))
        try:
            parse_scenario(document, Path(f"{name}.toml"))
        except ScenarioError as error:
            reason = str(error).partition(": ")[2]
            raise UmbraBenchError(one_line(f"{path}: {name}: {reason}")) from None
    return described


def load_environment(folder: Path = RESULTS) -> dict[str, Any]:
    """What the numbers of a study depend on.

    Raises:
        UmbraBenchError: `environment.json` is missing or states something else.
    """
    path = folder / "environment.json"
    return check_document(load_json(path), Environment, path)


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


def fingerprint(
    scenarios: Sequence[Scenario], methods: Sequence[str], precisions: Sequence[str], quick: bool
) -> str | None:
    """What a study depends on, as a SHA-256: what was asked, this package's code, the environment.

    None where an engine of the user's own takes part, whose code is not known.
    """
    if any(":" in method for method in methods):
        return None
    package = Path(__file__).parent
    code = {
        path.relative_to(package).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(package.rglob("*.py"))
    }
    asked = [list(methods), sorted(precisions), quick, code, environment(list(scenarios))]
    return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()


def holds(folder: Path, asked: str | None) -> bool:
    """Whether a folder holds the study of this fingerprint, whole."""
    try:
        found = asked is not None and load_environment(folder).get("fingerprint") == asked
        for name in (*TABLES, *SERIES, "engines") if found else ():
            read_sealed(folder / f"{name}.parquet", required=True)
    except UmbraBenchError:
        return False
    return found


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

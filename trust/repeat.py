"""Run one study in many ways and compare every byte of its tables, figures and pages.

python trust/repeat.py
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import polars as pl

from umbra_bench.results import SERIES, TABLES, load_table

ROOT = Path(__file__).resolve().parent.parent
SCENARIOS = ("spring", "thruster")
METHODS = ("umbra", "rk4", "pymunk")


def study(
    folder: Path, scenarios: tuple[str, ...] = SCENARIOS, cores: int = 2, **more: str
) -> Path:
    """Run the study, on some of the cores and in some environment."""
    methods = [word for name in METHODS if _is_there(name) for word in ("--method", name)]
    words = ["study", *scenarios, *methods, "--quick"]
    command([*words, "--results", str(folder)], cores, **more)
    return folder


def command(words: list[str], cores: int = 2, **more: str) -> None:
    """Run a command, on some of the cores and in some environment."""
    own = os.sched_getaffinity(0)
    subprocess.run(
        [sys.executable, "-m", "umbra_bench.cli", *words],
        check=True,
        capture_output=True,
        cwd=ROOT,
        env={**os.environ, **more},
        preexec_fn=lambda: os.sched_setaffinity(0, sorted(own)[:cores]),
    )


SWEEP = """scenario = "spring"
methods = ["umbra", "pymunk"]
steps = 200
draws = 40
seed = 3
vary = [{ key = "forces[0].stiffness", random = { low = 1.0, high = 100.0 } }]
"""


def long_runs(folder: Path, cores: int = 2, **more: str) -> Path:
    """A long run of two methods and a sweep, with their figures."""
    folder.mkdir()
    (folder.parent / "sweep.toml").write_text(SWEEP, encoding="utf-8")
    drift = ["drift", "spring", "--method", "umbra", "--method", "rk4", "--steps", "1e5"]
    for words in (drift, ["sweep", str(folder.parent / "sweep.toml")]):
        command([*words, "--results", str(folder), "--output", str(folder)], cores, **more)
    return folder


def shuffled(folder: Path) -> Path:
    """The same in another order: the methods one by one, the steps in two goes, the sweep by workers."""
    folder.mkdir()
    places = ["--results", str(folder), "--output", str(folder)]
    for method, steps in (("rk4", "1e5"), ("umbra", "12345"), ("umbra", "1e5")):
        command(["drift", "spring", "--method", method, "--steps", steps, *places])
    command(["sweep", str(folder.parent / "sweep.toml"), "--workers", "2", *places])
    return folder


def tables_and_figures(folder: Path) -> dict[str, bytes]:
    """What long runs and sweeps end with, the kept states included."""
    return {name: content for name, content in files(folder).items() if ".lock" not in name}


def _is_there(method: str) -> bool:
    from umbra_bench.methods import METHODS as KNOWN

    return KNOWN[method].installed


def table(folder: Path, name: str, scenario: str | None = None) -> bytes:
    """A table as bytes, timings apart; of one scenario."""
    rows = load_table(name, folder)
    if scenario is not None:
        rows = rows.filter(pl.col("scenario") == scenario)
    return rows.drop("wall_time", strict=False).write_csv().encode()


def files(folder: Path) -> dict[str, bytes]:
    """Every file of a folder by its name, those with timings apart."""
    timed = ("study.csv", "study.parquet", "study.sha256")
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in timed
    }


def same(one: dict[str, bytes], other: dict[str, bytes], what: str) -> int:
    """Compare; how many files were the same.

    Raises:
        AssertionError: they are not all.
    """
    differing = [name for name in {*one, *other} if one.get(name) != other.get(name)]
    if differing:
        raise AssertionError(f"{what}: differ: {', '.join(sorted(differing))}")
    print(f"  {what}: {len(one)} the same", flush=True)
    return len(one)


def main() -> int:
    """Run, compare, tell."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        first = study(folder / "first")
        names = (*TABLES, *SERIES)
        whole = files(first) | {name: table(first, name) for name in names}
        compared = runs = 0
        ways = {
            "again": study(folder / "again"),
            "one core": study(folder / "core", cores=1),
            "one thread of XLA": study(
                folder / "thread", XLA_FLAGS="--xla_cpu_multi_thread_eigen=false"
            ),
            "without kept code": study(folder / "cold", JAX_ENABLE_COMPILATION_CACHE="false"),
        }
        for what, other in ways.items():
            compared += same(whole, files(other) | {n: table(other, n) for n in names}, what)
            runs += 1
        turned = study(folder / "turned", SCENARIOS[::-1])
        alone = study(folder / "alone", SCENARIOS[:1])
        for what, other, of in (
            ("another order", turned, SCENARIOS),
            ("alone", alone, SCENARIOS[:1]),
        ):
            parts = [
                {f"{name} of {s}": table(where, name, s) for name in names for s in of}
                for where in (first, other)
            ]
            compared += same(parts[0], parts[1], what)
            runs += 1
        pages = []
        for what in ("pages", "pages-again"):
            command(["report", "--results", str(first), "--output", str(folder / what)])
            pages.append(files(folder / what))
        compared += same(*pages, "figures and pages")
        long = tables_and_figures(long_runs(folder / "long"))
        others = {
            "long runs and a sweep again": long_runs(folder / "long-again"),
            "on one core and thread": long_runs(
                folder / "long-core", cores=1, XLA_FLAGS="--xla_cpu_multi_thread_eigen=false"
            ),
            "in another order, in two goes, by two workers": shuffled(folder / "long-order"),
        }
        for what, other in others.items():
            compared += same(long, tables_and_figures(other), what)
    print(
        f"runs compared: {runs + 1} studies, 2 reports, {len(others) + 1} sets of long runs and a sweep, "
        f"{compared} files and tables the same; "
        f"{time.monotonic() - began:.0f} s"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())

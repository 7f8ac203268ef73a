"""Search for files that break a reader: mutated ones by the thousand, guided by coverage.

A file that reaches lines of the readers which none before it reached, in another order, or that is
refused in words not seen before, becomes a seed of its own. Each batch runs in a child with limits of
memory and time; a file that hangs, takes all memory or kills the interpreter is a failure like any other.

    python trust/search.py                 10,000 files
    python trust/search.py --files 100000 --seed 7 --keep failures/
"""

from __future__ import annotations

import argparse
import functools
import random
import re
import resource
import selectors
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
MEMORY = 12 * 2**30
"""The most addresses that a child may reserve, bytes; libraries take some gigabytes unasked."""
SECONDS_A_FILE = 30.0
SECONDS_OF_SILENCE = 120.0
LARGEST_SEED = 50_000
"""Bytes; larger files are tried once and not built upon."""
READERS = (
    "scenario",
    "results",
    "soundness",
    "gate",
    "errors",
    "record",
    "closed_form",
    "comparison",
    "drift",
    "drift_figures",
    "sweep/plan",
    "sweep/work",
)


class Coverage:
    """Which lines of the readers ran, one after the other."""

    def __init__(self) -> None:
        self.known: set[Any] = set()
        self._now: set[Any] = set()
        self._files = tuple(f"umbra_bench/{name}.py" for name in READERS)
        self._watched: dict[Any, bool] = {}

    def _calls(self, frame: FrameType, event: str, _: Any) -> Any:
        code = frame.f_code
        watched = self._watched.get(code)
        if watched is None:
            watched = self._watched[code] = code.co_filename.endswith(self._files)
        if not watched:
            return None
        before = 0
        now = self._now

        def lines(frame: FrameType, event: str, _: Any) -> Any:
            nonlocal before
            if event == "line":
                now.add((code, before, frame.f_lineno))
                before = frame.f_lineno
            return lines

        return lines

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Watch what runs within."""
        self._now.clear()
        sys.settrace(self._calls)
        try:
            yield
        finally:
            sys.settrace(None)

    def is_new(self, words: str) -> bool:
        """Whether what was just watched, or the words that it ended with, are new."""
        plain = re.sub(r"'[^']*'|\d[\d.e+-]*|= .*?:", "", words)[:160]
        reached = self._now | {plain}
        new = not reached <= self.known
        self.known |= reached
        return new


class Hangs(BaseException):
    """A file took longer than any may."""


def _alarm(*_: Any) -> None:
    raise Hangs


def work(files: int, seed: int, folder: Path, keep: Path, only: str, after: str) -> None:
    """Search the kinds of files in turn; the file at hand is in `folder`/here before it is read."""
    import inputs

    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, hard))
    signal.signal(signal.SIGPROF, _alarm)
    study = folder / "study"
    makers = {
        "scenarios": inputs.scenarios,
        "baselines": inputs.baselines,
        "claims.json": inputs.claims,
    }
    makers |= {name: functools.partial(inputs.results, study, name) for name in inputs.RESULTS}
    makers |= {"engines.parquet": functools.partial(inputs.engines, study)}
    makers |= {"sweeps": inputs.sweeps, "sweeps/*.json": inputs.stamps}
    makers |= {"drift/*.npz": functools.partial(inputs.long_runs, study)}
    names = [only] if only else [*SHARES][[*SHARES].index(after) + 1 if after else 0 :]
    for name in names:
        print("begin", name, flush=True)
        kind = makers[name]()
        here = inputs.unsealed_copy(study, folder / "here")
        count = files if only else round(files * SHARES[name])
        tally, reached = _search(kind, here / kind.file, count, f"{seed} {name}", keep)
        counts = [str(tally[v]) for v in ("accepted", "refused", "failed")]
        print("done", name, *counts, reached, flush=True)


def _search(kind: Any, path: Path, count: int, seed: str, keep: Path) -> tuple[Counter[str], int]:
    import inputs

    chance = random.Random(seed)
    corpus = [*kind.seeds]
    coverage = Coverage()
    tally: Counter[str] = Counter()
    for number in range(count):
        found = corpus[len(kind.seeds) :]
        parent = chance.choice(found if found and chance.random() < 0.5 else kind.seeds)
        content = kind.seeds[number : number + 1] or [
            kind.mutate(chance, parent, chance.choice(corpus))
        ]
        path.write_bytes(content[0])
        signal.setitimer(signal.ITIMER_PROF, SECONDS_A_FILE)
        try:
            with coverage.watching():
                words = inputs.examined(kind, path, chance)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 -- whatever it is, it is what is searched for
            words = f"FAILED {type(error).__name__}: {error}"[:300]
            keep.mkdir(parents=True, exist_ok=True)
            saved = keep / f"{number}-{kind.file}"
            saved.write_bytes(content[0])
            saved.with_name(f"{saved.name}.txt").write_text(
                traceback.format_exc(), encoding="utf-8"
            )
            print("failure", kind.name, number, words.replace("\n", " "), flush=True)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
        verdict = "failed" if words.startswith("FAILED") else words.partition(" ")[0]
        tally[verdict if verdict in ("failed", "accepted") else "refused"] += 1
        if coverage.is_new(words) and len(content[0]) < LARGEST_SEED:
            corpus.append(content[0])
        if number % 5 == 0:
            print("alive", flush=True)
    return tally, len(coverage.known)


SHARES = {
    "scenarios": 0.35,
    "sweeps": 0.15,
    "baselines": 0.14,
    "claims.json": 0.05,
    "scenarios.json": 0.05,
    "environment.json": 0.03,
    "study.parquet": 0.05,
    "orders.parquet": 0.03,
    "references.parquet": 0.03,
    "skips.parquet": 0.01,
    "motion.parquet": 0.02,
    "energy.parquet": 0.02,
    "drift.parquet": 0.02,
    "drift_series.parquet": 0.02,
    "drift/*.npz": 0.015,
    "sweeps/*.json": 0.005,
    "engines.parquet": 0.01,
}
"""Which part of the files is of which kind."""


def make_study(folder: Path) -> None:
    """A small good study, with a table of engines."""
    import polars as pl

    from umbra_bench.drift import run_drift
    from umbra_bench.results import save_study, save_table
    from umbra_bench.scenario import load_scenario
    from umbra_bench.schemas import ENGINES_SCHEMA
    from umbra_bench.study import run_study

    scenarios = [
        load_scenario(ROOT / "scenarios" / f"{name}.toml") for name in ("spring", "orbit_eccentric")
    ]
    save_study(run_study(scenarios, ["umbra", "velocity-verlet"], quick=True), folder)
    row = {
        "method": "umbra",
        "version": "",
        "precision": "either",
        "integrator": "x",
        "velocity": "y",
    }
    numbers = {"position_order": 1.0, "energy_error_100": 0.1, "energy_error_60": 0.2}
    run_drift(scenarios[0], ["umbra"], ["float64"], 2000, 0.01, folder)
    run_drift(scenarios[0], ["rk4"], ["float32"], 300, 9.0, folder)  # diverges
    save_table(pl.DataFrame([{**row, **numbers}], ENGINES_SCHEMA), "engines", folder)


def watched(command: list[str], folder: Path, keep: Path) -> tuple[list[int], list[str]]:
    """Run the search in children and watch them; counts (accepted, refused, failed), and failures."""
    total, failures, after = [0, 0, 0], [], ""
    while True:
        why, name = "died", after
        with subprocess.Popen(
            [*command, after], stdout=subprocess.PIPE, text=True, cwd=ROOT
        ) as child:
            assert child.stdout is not None
            ears = selectors.DefaultSelector()
            ears.register(child.stdout, selectors.EVENT_READ)
            while True:
                if not ears.select(SECONDS_OF_SILENCE):
                    why = f"was silent for {SECONDS_OF_SILENCE:g} s"
                    child.kill()
                    break
                line = child.stdout.readline()
                if not line:
                    break
                word, _, rest = line.strip().partition(" ")
                if word == "failure":
                    failures.append(rest)
                if word == "begin":
                    name = rest
                if word == "done":
                    name, *counts = rest.split()
                    total = [a + int(b) for a, b in zip(total, counts[:3], strict=True)]
                    accepted, refused, failed, reached = counts
                    print(
                        f"  {name:20} {accepted:>6} accepted {refused:>6} refused {failed:>4} failed, "
                        f"{reached} paths and messages reached",
                        flush=True,
                    )
        if child.returncode == 0:
            return total, failures
        total[2] += 1
        failures.append(f"{name}: the search {why}, code {child.returncode}")
        keep.mkdir(parents=True, exist_ok=True)
        for path in (folder / "here").glob(
            f"*{Path(name).suffix or '.*'}"
        ):  # the file at hand is among them
            shutil.copy(path, keep / f"killed-{path.name}")
        if name == [*SHARES][-1] or command[-1]:
            return total, failures
        after = name


def main() -> int:
    """Search, tell what was tried, and end with 1 if anything failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", choices=["", *SHARES])
    parser.add_argument("--keep", type=Path, default=ROOT / "build" / "failures")
    parser.add_argument("--work", nargs=3, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.work:
        folder, only, after = asked.work
        work(asked.files, asked.seed, Path(folder), asked.keep, only, after)
        return 0
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        make_study(Path(name) / "study")
        command = [sys.executable, __file__, "--files", str(asked.files), "--seed", str(asked.seed)]
        command += ["--keep", str(asked.keep), "--work", name, asked.only]
        total, failures = watched(command, Path(name), asked.keep)
    for failure in failures[:40]:
        print("FAILED", failure)
    print(
        f"files tried: {sum(total)}: {total[0]} accepted and sound, {total[1]} refused in one line, "
        f"{total[2]} failed; {time.monotonic() - began:.0f} s"
    )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())

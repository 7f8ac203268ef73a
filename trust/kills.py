"""Kill what writes results, fill its disk, take its rights, start it twice: what is there stays whole.

Each writer replaces one good set of files by another, over and over, until it is killed (SIGKILL) at a
random moment. Then everything is read as a report or a gate reads it: it must be the one or the other.
A sweep and a long run are killed while they compute and write, go on, and are killed again until they
end: their tables must be, byte for byte, those of a run that nobody killed.

    python trust/kills.py              fifty kills of each writer
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from umbra_bench.errors import UmbraBenchError
from umbra_bench.gate import Measurement, load_baseline, save_baseline
from umbra_bench.report import load_scenario_tables
from umbra_bench.results import SERIES, TABLES, load_environment, load_json, load_table, save_study
from umbra_bench.scenario import parse_scenario
from umbra_bench.study import Study

ROOT = Path(__file__).resolve().parent.parent
RESUMED = Path(__file__).with_name("resumed.py")
NOBODY = 65534
METHODS = ("umbra", "velocity-verlet")
"""The method that tells each of the two studies."""

MAKE = """
import sys, pathlib, umbra_bench as ub
from umbra_bench.results import save_study
for method in sys.argv[2:]:
    study = ub.run_study([ub.load_scenario("spring")], [method], ["float64"], quick=True)
    save_study(study, pathlib.Path(sys.argv[1]) / method)
"""
"""Makes the two studies in another process: the threads of it would not outlive a fork."""


def study_of(folder: Path) -> Study:
    """A study as it stands on disk."""
    names = dict(zip(TABLES, ("runs", "orders", "references", "skips"), strict=True))
    names |= {name: name for name in SERIES}
    tables = {field: load_table(name, folder) for name, field in names.items()}
    documents = load_json(folder / "scenarios.json")
    scenarios = [parse_scenario(d, Path(f"{name}.toml")) for name, d in documents.items()]
    return Study(scenarios, **tables)


def write_studies(good: Path, target: Path) -> None:
    """Replace one study by another for ever."""
    studies = [study_of(good / method) for method in METHODS]
    print("ready", flush=True)
    while True:
        for study in studies:
            save_study(study, target)


def read_study(target: Path) -> str:
    """Which study is there, if every file is of the same."""
    (tables,) = load_scenario_tables(target)
    load_environment(target)
    found = {
        name
        for table in (tables.runs, tables.orders, tables.energy)
        for name in table["method"].unique()
    } | (set(tables.motion["method"]) - {"reference"})
    if len(found) != 1:
        raise AssertionError(f"files of two studies: {found}")
    return found.pop()


def measurement_of(baseline: dict[str, Any], cells: int) -> Measurement:
    """A baseline as the measurement of some of its cells."""
    kept = dict(list(baseline["cells"].items())[:cells])
    parts = {"truths": baseline["truths"], "orders": baseline["orders"], "cells": kept}
    return Measurement(hashes=baseline["scenarios"], **parts)


def write_baselines(_: Path, target: Path) -> None:
    """Replace one baseline by another for ever."""
    baseline = load_baseline(ROOT / "results" / "baseline.json")
    measured = [measurement_of(baseline, cells) for cells in (20, 40)]
    print("ready", flush=True)
    while True:
        for measurement in measured:
            save_baseline(measurement, target / "baseline.json")


def read_baseline(target: Path) -> str:
    """How many cells the baseline has: of the one or of the other."""
    count = len(load_baseline(target / "baseline.json")["cells"])
    if count not in (20, 40):
        raise AssertionError(f"{count} cells")
    return str(count)


WRITERS: dict[str, tuple[Callable[[Path, Path], None], Callable[[Path], str]]] = {
    "study": (write_studies, read_study),
    "gate --update": (write_baselines, read_baseline),
}
"""What writes, and what reads it: a command that writes results has a line here."""


def child(writer: Callable[[Path, Path], None], good: Path, target: Path) -> tuple[int, Any]:
    """Fork a writer; its process, and where it says that it is ready.

    This process itself reads and writes no table: the threads of those who do would not outlive a fork.
    """
    reading, writing = os.pipe()
    process = os.fork()
    if process == 0:
        os.dup2(writing, 1)
        try:
            writer(good, target)
        except UmbraBenchError as error:
            print(f"refused: {error}", flush=True)
        except Exception as error:  # noqa: BLE001 -- told by the parent
            print(f"failed: {error!r}", flush=True)
        finally:
            os._exit(0)
    os.close(writing)
    return process, os.fdopen(reading)


def read(writer: str, target: Path) -> str:
    """What a reader finds.

    Raises:
        AssertionError: no sound whole.
    """

    def tell(_: Path, target: Path) -> None:
        print(f"found {WRITERS[writer][1](target)}", flush=True)

    process, said = child(tell, target, target)
    line = said.read().strip()
    os.waitpid(process, 0)
    if not line.startswith("found "):
        raise AssertionError(f"{writer}: what is left cannot be read: {line}")
    return str(line.removeprefix("found "))


def kill(writer: str, count: int, good: Path, target: Path, chance: random.Random) -> int:
    """Kill a writer at random moments; how often what was left was whole."""
    write, _ = WRITERS[writer]
    seen = set()
    for number in range(count):
        process, said = child(write, good, target)
        said.readline()
        time.sleep(0.02 + chance.random() * 0.3 if number else 0.5)
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        seen.add(read(writer, target))
    left = [path.name for path in target.iterdir() if path.name.startswith(".")]
    print(
        f"  {writer}: killed {count} times, {count} times whole; seen: {sorted(seen)}; left: {len(left)}"
    )
    return count


def kill_command(count: int, folder: Path, chance: random.Random) -> int:
    """Kill the command itself, as a user does: mostly while it computes."""
    target = folder / "command"
    words = [sys.executable, "-m", "umbra_bench.cli", "study", "spring", "--quick"]
    words += ["--precision", "float64", "--results", str(target), "--method"]
    began = time.monotonic()
    subprocess.run([*words, METHODS[0]], check=True, capture_output=True, cwd=ROOT)
    whole = time.monotonic() - began
    for _ in range(count):
        with subprocess.Popen(
            [*words, METHODS[1]], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=ROOT
        ) as process:
            time.sleep(whole * (0.3 + 0.7 * chance.random()))
            process.kill()
        read("study", target)
    print(f"  umbra-bench study: killed {count} times, {count} times whole")
    return count


def in_force(folder: Path) -> dict[str, bytes]:
    """The files as a reader finds them: what a killed writer decided counts before what is in place."""
    paths = [*folder.glob("[!.]*"), *folder.glob(".*.ready/*")]
    return {path.name: path.read_bytes() for path in paths if path.is_file()}


def refused(writer: str, good: Path, target: Path, limit: Callable[[], None]) -> str:
    """What a writer says that comes up against a limit; what was there is whole."""
    write, _ = WRITERS[writer]
    before = read(writer, target)
    files = in_force(target)

    def limited(good: Path, target: Path) -> None:
        limit()
        write(good, target)

    process, said = child(limited, good, target)
    lines = said.read().splitlines()
    os.waitpid(process, 0)
    if len(lines) != 2 or not lines[1].startswith("refused: ") or str(target) not in lines[1]:
        raise AssertionError(f"{writer}: expected one line, got {lines}")
    if read(writer, target) != before or in_force(target) != files:
        raise AssertionError(f"{writer}: the old files are no longer whole")
    return lines[1].replace(str(target), "FOLDER")


def full_disk() -> None:
    """No file may grow beyond two kilobytes."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (2048, 2048))


def no_rights() -> None:
    """Nothing may be written: the rights of nobody."""
    os.setgid(NOBODY)
    os.setuid(NOBODY)


def two_at_once(good: Path, target: Path) -> None:
    """Two writers in one folder; both go on, and what is there is of one of them."""
    children = [child(write_studies, good, target) for _ in range(2)]
    for _, said in children:
        said.readline()
    time.sleep(2.0)
    for process, _ in children:
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
    print(f"  two studies at once: whole, of {read('study', target)}")


def kill_resumed(kills: int, seed: int) -> int:
    """Kill what goes on where it was, in an interpreter of its own, which has JAX and forks."""
    words = [sys.executable, str(RESUMED), "--kills", str(kills), "--seed", str(seed)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    print(done.stdout, end="", flush=True)
    if done.returncode:
        raise AssertionError(f"what goes on where it was: {done.stdout}{done.stderr}")
    return int(done.stdout.split()[-1])


def main() -> int:
    """Kill, fill, forbid and double; tell what was survived."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--commands", type=int, default=5)
    parser.add_argument("--resumed", type=int, default=50, help="kills of what goes on")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    chance = random.Random(asked.seed)
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        good, target = folder / "good", folder / "target"
        make = [sys.executable, "-c", MAKE, str(good), *METHODS]
        subprocess.run(make, check=True, capture_output=True, cwd=ROOT)
        shutil.copytree(good / METHODS[0], target)
        survived = sum(kill(writer, asked.kills, good, target, chance) for writer in WRITERS)
        for writer in WRITERS:
            for limit in (full_disk, no_rights):
                if limit is no_rights and os.getuid() != 0:
                    continue
                print(f"  {writer}, {limit.__name__}: {refused(writer, good, target, limit)}")
        two_at_once(good, target)
        survived += kill_command(asked.commands, folder, chance)
    survived += kill_resumed(asked.resumed, asked.seed) if asked.resumed else 0
    print(f"kills survived: {survived} of {survived}; {time.monotonic() - began:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())

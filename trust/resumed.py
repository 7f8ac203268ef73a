"""Kill sweeps and long runs while they compute and write; each goes on, and ends as if never killed.

This process imports what they need and computes nothing: the threads of JAX and Polars would not outlive
a fork. Each child is a command of its own, which finds its compiled code kept from the first.

    python trust/resumed.py            fifty kills of each
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from umbra_bench import drift
from umbra_bench.errors import UmbraBenchError
from umbra_bench.jax_settings import keep_compiled_code
from umbra_bench.results import load_table
from umbra_bench.scenario import load_scenario
from umbra_bench.schemas import DRIFT_SCHEMA
from umbra_bench.sweep import plan, work

NOBODY = 65534
LONGEST = {"sweep": 1.5, "drift": 0.5}
"""The latest moment of a kill after the work began, s."""
SWEEP = """
scenario = "spring"
methods = ["umbra", "velocity-verlet"]
steps = 1000
draws = 6000
[[vary]]
key = "forces[0].stiffness"
random = { low = 1.0, high = 100.0 }
"""
STEPS = 300_000

Command = Callable[[Path], None]


def sweep(folder: Path) -> None:
    """A small sweep of many parts."""
    planned = plan.load_plan(folder.parent / "sweep.toml")
    say("working")
    work.run_sweep(planned, folder)


def long_run(folder: Path, method: str = "umbra") -> None:
    """A small long run, which keeps where it stands after every slice."""
    drift.KEEP_SECONDS, drift.SLICE_SECONDS = 0.0, 0.01
    take_up = drift._LongRun.take_up

    def told(run: Any, restart: bool) -> None:
        take_up(run, restart)
        say("working")

    drift._LongRun.take_up = told  # type: ignore[method-assign]
    drift.run_drift(load_scenario("spring"), [method], ["float64"], STEPS, None, folder)


def done_of_sweep(folder: Path) -> int:
    """The parts that are there, or all of them; each is as it was written."""
    parts = list(folder.glob("sweeps/sweep/*.parquet"))
    sound = work._sound_parts(folder / "sweeps" / "sweep")
    if len(sound) != len(parts):
        raise AssertionError(f"{len(parts)} parts, of which {len(sound)} are whole")
    return sys.maxsize if (folder / "sweeps" / "sweep.parquet").is_file() else len(parts)


def done_of_long_run(folder: Path) -> int:
    """The steps that are kept."""
    kept = list(folder.glob("drift/*.npz"))
    return int(np.load(kept[0], allow_pickle=False)["steps"]) if kept else 0


COMMANDS: dict[str, tuple[Command, Callable[[Path], int], tuple[str, ...]]] = {
    "sweep": (sweep, done_of_sweep, ("sweeps/sweep.parquet", "sweeps/sweep.sha256")),
    "drift": (
        long_run,
        done_of_long_run,
        ("drift.csv", "drift.parquet", "drift_series.csv", "drift_series.parquet", "drift.sha256"),
    ),
}
"""What runs, how far it is, and the tables that it ends with."""


def say(word: str) -> None:
    """Tell the parent."""
    print(word, flush=True)


def child(command: Command, folder: Path, limit: Callable[[], None] = lambda: None) -> Any:
    """Fork a command; its process, and what it says."""
    reading, writing = os.pipe()
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # JAX, of any fork
        process = os.fork()
    if process == 0:
        os.dup2(writing, 1)
        try:
            limit()
            plan.TASK_STEPS = 500_000
            command(folder)
            say("ended")
        except UmbraBenchError as error:
            say(f"refused: {error}")
        except BaseException as error:  # noqa: BLE001 -- told by the parent
            say(f"failed: {error!r}")
        finally:
            os._exit(0)
    os.close(writing)
    return process, os.fdopen(reading)


def last_words(process: int, said: Any) -> str:
    """What a command that was let be ends with."""
    with said:
        words = said.read().splitlines()
    os.waitpid(process, 0)
    return words[-1] if words else "nothing"


def tables(folder: Path, names: tuple[str, ...]) -> dict[str, bytes]:
    """The bytes of what a command ends with."""
    return {name: (folder / name).read_bytes() for name in names}


def equal(what: str, found: object, expected: object) -> None:
    """Compare.

    Raises:
        AssertionError: they differ.
    """
    if found != expected:
        raise AssertionError(f"{what}: expected {expected!r:.300}, found {found!r:.300}")


def kill(name: str, kills: int, folder: Path, chance: random.Random) -> int:
    """Kill a command until `kills` kills met it at work, and let it end between them; the kills."""
    command, done_of, names = COMMANDS[name]
    whole = folder / "whole"
    equal(name, last_words(*child(command, whole)), "ended")
    expected = tables(whole, names)
    killed = ends = early = 0
    target, done = folder / "0", 0
    while killed < kills:
        process, said = child(command, target)
        word = said.readline().strip()
        equal(name, word, "working")
        time.sleep(LONGEST[name] * chance.random())
        os.kill(process, signal.SIGKILL)
        _, status = os.waitpid(process, 0)
        said.close()
        before, done = done, done_of(target)
        if done < before:
            raise AssertionError(f"{name}: {before} were done, and {done} are left")
        killed += os.WIFSIGNALED(status)
        early += os.WIFSIGNALED(status) and done == before
        if os.WIFSIGNALED(status) and killed < kills:
            continue
        equal(name, last_words(*child(command, target)), "ended")
        equal(f"{name} after kills", tables(target, names) == expected, True)
        left = [p.name for p in target.rglob(".*") if not p.name.endswith(".lock")]
        equal(f"{name}: half-written files", left, [])
        ends += 1
        target, done = folder / str(ends), 0
    print(
        f"  {name}: killed {killed} times at work, {early} of them before anything new was kept; "
        f"went on and ended {ends} times with the bytes of a run never killed"
    )
    return killed


def full_disk() -> None:
    """No file may grow beyond two kilobytes."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (2048, 2048))


def no_rights() -> None:
    """Nothing may be written: the rights of nobody."""
    os.setgid(NOBODY)
    os.setuid(NOBODY)


def limits(name: str, folder: Path) -> None:
    """Against a limit: one line, nothing that is there changes, and the command goes on after."""
    command, done_of, names = COMMANDS[name]
    process, said = child(command, folder)
    said.readline()
    while not done_of(folder):
        time.sleep(0.01)
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    for limit in (full_disk, no_rights):
        if limit is no_rights and os.getuid() != 0:
            continue
        before = {path: path.read_bytes() for path in visible(folder)}
        word = last_words(*child(command, folder, limit))
        if not (word.startswith(f"refused: {folder}") and "cannot be written" in word):
            raise AssertionError(f"{name}, {limit.__name__}: expected one line, got {word!r}")
        equal(f"{name}, {limit.__name__}", {p: p.read_bytes() for p in visible(folder)}, before)
        print(f"  {name}, {limit.__name__}: {word.replace(str(folder), 'FOLDER')}")
    equal(name, last_words(*child(command, folder)), "ended")
    equal(name, tables(folder, names), tables(folder.parent / "whole", names))


def visible(folder: Path) -> list[Path]:
    """The files of a folder that are in their places."""
    return [p for p in folder.rglob("*") if p.is_file() and not p.name.startswith(".")]


def two_at_once(name: str, folder: Path) -> None:
    """The same command twice at once: each ends right or says so, and what is there is right."""
    command, _, names = COMMANDS[name]
    words = [last_words(*one) for one in [child(command, folder) for _ in range(2)]]
    ended = words.count("ended")
    told = [word for word in words if "another command is writing there" in word]
    equal(f"{name} twice at once: {words}", ended + len(told), 2)
    equal(f"{name} twice at once", tables(folder, names), tables(folder.parent / "whole", names))
    print(f"  {name}, two at once: {ended} ended right, {len(told)} said so")


def methods_of(folder: Path) -> None:
    """Tell which long runs have a row."""
    say(" ".join(sorted(load_table("drift", folder, DRIFT_SCHEMA)["method"])))
    os._exit(0)


def two_long_runs(folder: Path) -> None:
    """Two long runs at once in one folder, of two methods: neither loses the other's row."""
    pair = ("umbra", "velocity-verlet")
    both = [child(partial(long_run, method=method), folder) for method in pair]
    equal("two methods at once", [last_words(*one) for one in both], ["ended", "ended"])
    equal("two methods at once", last_words(*child(methods_of, folder)), " ".join(pair))
    print("  drift, two methods at once: both rows are there")


def main() -> int:
    """Kill, fill, forbid and double; tell what was survived."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    chance = random.Random(asked.seed)
    killed = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        os.environ["XDG_CACHE_HOME"] = str(folder / "code")
        keep_compiled_code()
        for command in COMMANDS:
            own = folder / command
            own.mkdir()
            (own / "sweep.toml").write_text(SWEEP, encoding="utf-8")
            killed += kill(command, asked.kills, own, chance)
            limits(command, own / "limits")
            two_at_once(command, own / "twice")
        two_long_runs(folder / "drift" / "pair")
    print(f"kills survived by what goes on: {killed}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

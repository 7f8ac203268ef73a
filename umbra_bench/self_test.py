"""Does the gate catch what it exists for? Faults are put into the real code, one at a time.

A fault is a small change of a source file, named with the place where it shipped. It is compiled, and
the running functions take over its code, so that whatever imported them runs the fault. The catalogue
is `tests/faults.py` of a checkout.
"""

from __future__ import annotations

import importlib
import importlib.util
import types
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import click
import jax

from umbra_bench import forces, system
from umbra_bench.errors import UmbraBenchError
from umbra_bench.gate import (
    BASELINE,
    Judgement,
    Line,
    exit_code,
    judge,
    load_baseline,
    measure_lines,
    measure_truth,
)
from umbra_bench.gate_output import number, worst_first
from umbra_bench.reference import Reference, certified_reference
from umbra_bench.scenario import load_scenario

CATALOGUE = Path(__file__).resolve().parent.parent / "tests" / "faults.py"


class Change(NamedTuple):
    """A small change of the source.

    Attributes:
        name: what is wrong, in a few words.
        source: where such a fault shipped, or "own".
        module: the module that is changed, below `umbra_bench`.
        old, new: the text that is replaced, which must occur once, and what it becomes.
        lines: the lines of the gate that are run, "scenario/method/precision".
        moves_truth: whether the reference feels it too (a force law, a body).
    """

    name: str
    source: str
    module: str
    old: str
    new: str
    lines: tuple[str, ...]
    moves_truth: bool = False


@contextmanager
def changed(change: Change) -> Iterator[None]:
    """Run the package with a change in force.

    Raises:
        UmbraBenchError: the text to be replaced does not occur exactly once.
    """
    module = importlib.import_module(f"umbra_bench.{change.module}")
    source = Path(str(module.__file__)).read_text(encoding="utf-8")
    if source.count(change.old) != 1:
        raise UmbraBenchError(
            f"fault {change.name!r}: {change.old!r} occurs {source.count(change.old)} times in "
            f"{change.module}; expected once"
        )
    twin = types.ModuleType(module.__name__)
    twin.__dict__.update(__file__=module.__file__, __package__=module.__package__)
    code = compile(source.replace(change.old, change.new), str(module.__file__), "exec")
    exec(code, twin.__dict__)  # noqa: S102 -- our own source, with a change of our own
    undo = list(_take_over(module.__dict__, twin.__dict__))
    _forget_compiled_code()
    try:
        yield
    finally:
        for restore in reversed(undo):
            restore()
        _forget_compiled_code()


def _take_over(ours: dict[str, Any], theirs: dict[str, Any]) -> Iterator[Any]:
    """Give our functions the code of their twins, and our constants their values."""
    for (path, mine), (_, other) in zip(
        sorted(_functions(ours).items()), sorted(_functions(theirs).items()), strict=True
    ):
        del path
        if mine.__code__ != other.__code__:
            before = mine.__code__
            mine.__code__ = other.__code__
            yield lambda mine=mine, before=before: setattr(mine, "__code__", before)
        for cell, twin in zip(mine.__closure__ or (), other.__closure__ or (), strict=True):
            kept, value = cell.cell_contents, twin.cell_contents
            if isinstance(kept, (list, tuple, float)) and kept != value:
                cell.cell_contents = value
                yield lambda cell=cell, kept=kept: setattr(cell, "cell_contents", kept)
    for name, kept in list(ours.items()):
        if isinstance(kept, (int, float)) and theirs[name] != kept:
            ours[name] = theirs[name]
            yield lambda name=name, kept=kept: ours.__setitem__(name, kept)


def _functions(namespace: dict[str, Any]) -> dict[str, Any]:
    """The functions that a module defines: its own, of its classes, and in its tables of functions."""
    found: dict[str, Any] = {}

    def visit(path: str, value: Any) -> None:
        if isinstance(value, (staticmethod, classmethod)):
            value = value.__func__
        if isinstance(value, property):
            value = value.fget
        value = getattr(value, "__wrapped__", value)
        if isinstance(value, types.FunctionType) and value.__module__ == namespace["__name__"]:
            found[path] = value
        elif isinstance(value, type) and value.__module__ == namespace["__name__"]:
            for name, member in vars(value).items():
                visit(f"{path}.{name}", member)
        elif isinstance(value, dict):
            for name, member in value.items():
                visit(f"{path}[{name}]", member)
        elif isinstance(value, tuple):
            for i, member in enumerate(value):
                visit(f"{path}[{i}]", member)

    for name, value in namespace.items():
        if not name.startswith("__"):
            visit(name, value)
    return found


def _forget_compiled_code() -> None:
    jax.clear_caches()  # type: ignore[no-untyped-call]
    system._compiled_force.cache_clear()
    forces._incidence.cache_clear()


def load_catalogue() -> tuple[Sequence[Change], Sequence[Change]]:
    """The faults and the harmless changes of a checkout.

    Raises:
        UmbraBenchError: there is no catalogue, as in an installation without the tests.
    """
    if not CATALOGUE.is_file():
        raise UmbraBenchError(f"{CATALOGUE.name}: not found; the self-test runs in a checkout only")
    specification = importlib.util.spec_from_file_location("umbra_bench_faults", CATALOGUE)
    assert specification is not None
    assert specification.loader is not None
    catalogue = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(catalogue)
    return catalogue.FAULTS, catalogue.HARMLESS


class Examiner:
    """Runs the gate over changes; the references that no change touches are solved once."""

    def __init__(self, baseline: Path = BASELINE) -> None:
        self._baseline = load_baseline(baseline)
        self._references: dict[str, Reference] = {}

    def examine(self, change: Change) -> list[Judgement]:
        """What the gate says of a change, of the lines that it names."""
        lines = [Line(*line.split("/")) for line in change.lines]
        scenarios = {line.scenario for line in lines}
        if not change.moves_truth:
            for name in scenarios - set(self._references):
                self._references[name] = certified_reference(load_scenario(name))
            with changed(change):
                return judge(measure_lines(lines, references=self._references), self._baseline)
        with changed(change):
            moved = {name: measure_truth(name) for name in scenarios}
            found = [j for truth, _ in moved.values() for j in judge(truth, self._baseline)]
            if exit_code(found) == 1:  # the truth itself tells: no method need be run
                return found
            references = {name: reference for name, (_, reference) in moved.items()}
            return judge(measure_lines(lines, references=references), self._baseline)


def print_self_test() -> int:
    """Print fault, source, the cell that caught it and by what factor; 1 if any went unnoticed."""
    faults, harmless = load_catalogue()
    examiner = Examiner()
    width = max(len(change.name) for change in (*faults, *harmless))
    missed = 0
    for change in faults:
        judgements = examiner.examine(change)
        caught = exit_code(judgements) == 1
        missed += not caught
        text = "MISSED"
        if caught:
            worst = worst_first(judgements)[0]
            text = f"{worst.cell} {worst.metric}, factor {number(worst.factor)}"
        click.echo(f"{change.name:{width}}  {text}  [{change.source}]")
    for change in harmless:
        alarm = exit_code(examiner.examine(change)) != 0
        missed += alarm
        click.echo(f"{change.name:{width}}  {'FALSE ALARM' if alarm else 'passes'}  [harmless]")
    click.echo(
        f"{len(faults)} faults and {len(harmless)} harmless changes, {missed} judged wrongly"
    )
    return 1 if missed else 0

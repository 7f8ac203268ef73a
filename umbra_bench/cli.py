"""The command line: it reads arguments, calls one function and prints.

Exit codes: 0 done and good; 1 judged and bad; 2 could not be judged or done, with one line on
standard error. Numerical libraries are imported by the commands that need them.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click

from umbra_bench.errors import UmbraBenchError
from umbra_bench.methods import METHODS, PRECISIONS, entry_points

_PRECISION = click.Choice(PRECISIONS)
_COUNT = click.IntRange(1, 2**62)
_FOLDER = click.Path(path_type=Path, file_okay=False)


class _Steps(click.ParamType[int]):
    """A whole number, which may be written as 1e9."""

    name = "number"

    def convert(self, value: Any, param: Any, context: Any) -> int:
        try:
            number = float(value)
        except ValueError:
            number = 0.0
        if not (1.0 <= number <= 2.0**53 and number.is_integer()):
            self.fail(f"{value!r}: expected a whole number from 1 to {2**53}, such as 1e9")
        return int(number)


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="umbra-bench")
def cli() -> None:
    """How far is a real-time physics engine from the truth, and at which step size?"""


def main() -> None:
    """Run the command line; every failure that the user can mend is one line and exit code 2."""
    try:
        with cli.make_context("umbra-bench", sys.argv[1:]) as context:
            code = cli.invoke(context)
        sys.stdout.flush()
    except click.exceptions.Exit as end:  # --help, --version
        code = end.exit_code
    except click.exceptions.NoArgsIsHelpError as help_text:
        click.echo(help_text.format_message())
        code = 2
    except click.ClickException as error:
        code = _complain(error.format_message())
    except UmbraBenchError as error:
        code = _complain(str(error))
    except (click.Abort, KeyboardInterrupt):
        code = _complain("interrupted")
    except BrokenPipeError:  # the reader of our output had enough
        code = 0
        _drop_output()
    except OSError as error:
        code = _complain(f"standard output cannot be written: {error.strerror}")
        _drop_output()
    sys.exit(code or 0)


def _drop_output() -> None:
    """Let the interpreter's last flush go nowhere, where standard output takes nothing more."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(message: str) -> int:
    click.echo(f"umbra-bench: {' '.join(message.split())}", err=True)
    return 2


@cli.command()
@click.argument("scenario")
@click.option("--method", required=True, help="See `umbra-bench list methods`.")
@click.option("--dt", type=float, required=True, help="Step, s.")
@click.option("--steps", type=_COUNT, help="Default: as many as fit in the duration.")
@click.option("--precision", type=_PRECISION, default="float64", show_default=True)
@click.option("--every", type=_COUNT, default=1, help="Write every M-th state.")
@click.option("--output", default="-", help="A file, or - for standard output.")
def simulate(
    scenario: str,
    method: str,
    dt: float,
    steps: int | None,
    precision: str,
    every: int,
    output: str,
) -> None:
    """Run one method over SCENARIO (a name in scenarios/ or a file) and write its states as CSV."""
    _prepare()
    from umbra_bench.scenario import load_scenario
    from umbra_bench.trajectory_csv import write_trajectory

    write_trajectory(load_scenario(scenario), method, dt, steps, precision, every, output)


@cli.command()
@click.argument("scenarios", nargs=-1, metavar="[SCENARIO ...]")
@click.option("--method", "methods", multiple=True, help="May be repeated. Default: all.")
@click.option("--precision", "precisions", multiple=True, type=_PRECISION, help="Default: both.")
@click.option("--quick", is_flag=True, help="Only the longest steps of each sweep.")
@click.option(
    "--if-changed", is_flag=True, help="Measure nothing if RESULTS are of this very study."
)
@click.option("--results", type=_FOLDER, default="results", show_default=True)
def study(
    scenarios: tuple[str, ...],
    methods: tuple[str, ...],
    precisions: tuple[str, ...],
    quick: bool,
    if_changed: bool,
    results: Path,
) -> None:
    """Sweep methods over scenarios and step sizes; write the tables into results/."""
    from umbra_bench.methods import methods_of_study
    from umbra_bench.results import fingerprint, holds, save_study, save_table
    from umbra_bench.scenario import list_scenarios, load_scenario

    loaded = [load_scenario(name) for name in scenarios or list_scenarios()]
    asked = fingerprint(loaded, methods_of_study(methods), precisions or PRECISIONS, quick)
    if if_changed and holds(results, asked):
        click.echo(f"{results}/ holds this study: nothing that it depends on has changed")
        return
    _prepare()
    from umbra_bench.engine_table import examine_engines
    from umbra_bench.study import run_study

    with _progress("Study") as listener:
        found = run_study(
            loaded,
            methods,
            precisions or PRECISIONS,
            quick=quick,
            processes=None,
            listener=listener,
        )
    with _progress("Engines") as listener:
        engines = examine_engines(methods_of_study(methods), processes=None, listener=listener)
    save_table(engines, "engines", results)
    save_study(found, results, asked)  # last: a command that was killed before has not done it all
    click.echo(f"{found.runs.height} runs in {results}/study.csv, orders in {results}/orders.csv")


@cli.command()
@click.option("--results", type=_FOLDER, default="results", show_default=True)
@click.option("--output", type=_FOLDER, default="reports", show_default=True)
@click.option("--summary", is_flag=True, help="Print an overview and draw nothing.")
@click.option("--against", type=_FOLDER, help="Another run's results: what changed since?")
@click.option("--png", is_flag=True, help="Write every figure as PNG, too.")
def report(results: Path, output: Path, summary: bool, against: Path | None, png: bool) -> None:
    """Draw the report from the tables in results/; simulates nothing."""
    from umbra_bench.report import load_scenario_tables, write_report

    if summary:
        from umbra_bench.overview import print_overview

        print_overview(load_scenario_tables(results))
        return
    with _progress("Report") as listener:
        page = write_report(results, output, listener, against, ("svg", "png") if png else ("svg",))
    click.echo(f"{page}")


@cli.command()
@click.argument("scenario")
@click.option("--method", "methods", multiple=True, help="May be repeated. Default: all.")
@click.option("--steps", type=_Steps(), default="1e7", show_default=True)
@click.option("--dt", type=float, help="Step, s. Default: the scenario's default step.")
@click.option("--precision", "precisions", multiple=True, type=_PRECISION, help="Default: both.")
@click.option("--restart", is_flag=True, help="Forget what an earlier run left.")
@click.option("--results", type=_FOLDER, default="results", show_default=True)
@click.option("--output", type=_FOLDER, default="reports", show_default=True)
def drift(
    scenario: str,
    methods: tuple[str, ...],
    steps: int,
    dt: float | None,
    precisions: tuple[str, ...],
    restart: bool,
    results: Path,
    output: Path,
) -> None:
    """Follow the energy error of SCENARIO over very many steps and tell the law of its growth.

    Interrupted at any moment, the same command goes on where it was; more --steps go on from the end.
    """
    _prepare()
    from umbra_bench import drift as long_runs
    from umbra_bench.drift_figures import draw_drift
    from umbra_bench.scenario import load_scenario

    with _progress("Drift") as listener:
        long_runs.run_drift(
            load_scenario(scenario),
            methods,
            precisions or PRECISIONS,
            steps,
            dt,
            results,
            restart=restart,
            listener=listener,
        )
    long_runs.print_drift(results)
    for path in draw_drift(results, output):
        click.echo(f"{path}.svg")


@cli.command()
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--workers", type=click.IntRange(1, 4096), help="Processes here, through Dask.")
@click.option("--scheduler", help="The address of a Dask scheduler, such as tcp://host:8786.")
@click.option("--restart", is_flag=True, help="Forget what an earlier run of this sweep left.")
@click.option("--results", type=_FOLDER, default="results", show_default=True)
@click.option("--output", type=_FOLDER, default="reports", show_default=True)
def sweep(
    file: Path,
    workers: int | None,
    scheduler: str | None,
    restart: bool,
    results: Path,
    output: Path,
) -> None:
    """Run the scenario of a sweep FILE with many values of its numbers; draw what comes of it.

    An interrupted sweep goes on where it was: the same command again.
    """
    if workers and scheduler:
        raise click.UsageError(
            "--workers starts a cluster, --scheduler names one: give one of them"
        )
    _prepare()
    from umbra_bench.sweep import figures, plan, work

    planned = plan.load_plan(file)
    with _progress("Sweep") as listener:
        table = work.run_sweep(
            planned,
            results,
            workers=workers,
            scheduler=scheduler,
            restart=restart,
            listener=listener,
        )
    click.echo(f"{table}: {planned.runs} runs")
    for path in figures.draw_sweep(planned, table, output / "sweeps"):
        click.echo(f"{path}.svg")


@cli.command()
@click.argument("cell")
@click.option("--results", type=_FOLDER, default="results", show_default=True)
@click.option(
    "--baseline",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Default: baseline.json beside the results.",
)
def explain(cell: str, results: Path, baseline: Path | None) -> None:
    """Tell how a number of the results came about, and the command that makes it again.

    CELL is SCENARIO/METHOD/PRECISION/DT/METRIC or SCENARIO/METHOD/PRECISION/QUANTITY/order, or
    drift/SCENARIO/METHOD/PRECISION/DT for a long run. A sweep's command stands in sweeps/NAME.json.
    """
    from umbra_bench import explain as history

    for line in history.explain(cell, results, baseline):
        click.echo(line)


@cli.command()
@click.argument("method")
@click.argument("scenarios", nargs=-1, metavar="[SCENARIO ...]")
def identify(method: str, scenarios: tuple[str, ...]) -> None:
    """Tell which textbook integrator METHOD is, from its trajectories."""
    _prepare()
    from umbra_bench.engine_table import examine, print_examination
    from umbra_bench.scenario import load_scenario

    print_examination(examine(method, [load_scenario(name) for name in scenarios]))


@cli.command()
@click.option("--only", multiple=True, metavar="NAME", help="One statement or proof. Repeatable.")
@click.option(
    "--method", default="umbra", show_default=True, help="The method that stands for UMBRA's."
)
@click.option("--results", type=_FOLDER, default="results", show_default=True)
@click.option("--output", type=_FOLDER, default="reports", show_default=True)
def claims(only: tuple[str, ...], method: str, results: Path, output: Path) -> None:
    """Measure the devlog's statements; write results/claims.json and reports/claims.md.

    With --only, or with another method than UMBRA's, the answer is printed and nothing is written.
    """
    _prepare()
    from umbra_bench.claims import measuring, page, record

    if only:
        page.print_claims(measuring.measure_named(only, method).document)
        return
    with _progress("Claims") as listener:
        found = measuring.measure_all(method, processes=None, listener=listener)
    page.print_claims(found.document)
    if method != "umbra":
        return
    record.save_claims(found, results)
    click.echo(f"{page.write_page(results, output)}")


@cli.command()
@click.option("--update", is_flag=True, help="Rewrite the baseline and tell what changed.")
@click.option(
    "--baseline",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Default: results/baseline.json, this project's own.",
)
@click.option("--results", type=_FOLDER, default="results", show_default=True)
@click.option("--self-test", is_flag=True, help="Break the integrators on purpose, one at a time.")
@click.option("--method", "methods", multiple=True, help="Judge this engine of yours alone.")
def gate(
    update: bool, baseline: Path | None, results: Path, self_test: bool, methods: tuple[str, ...]
) -> int:
    """Judge the integrators against a committed baseline: exit 0 good, 1 worse, 2 not judged."""
    _prepare()
    from umbra_bench import gate as judge
    from umbra_bench import gate_output

    if self_test:
        from umbra_bench.self_test import print_self_test

        return print_self_test()
    if methods and baseline is None:
        raise click.UsageError("--method needs a --baseline FILE of its own")
    baseline = baseline or judge.BASELINE
    known = None if update and not baseline.is_file() else judge.load_baseline(baseline)
    lines = judge.lines_of(methods) if methods else judge.planned_lines(judge.budgeted_scenarios())
    with _progress("Gate") as listener:
        measured = judge.measure_lines(lines, listener, processes=None)
    for line, reason in measured.refused.items():
        click.echo(f"not run: {line}: {reason}", err=True)
    if not measured.cells:
        raise UmbraBenchError("gate: nothing could be run, so there is nothing to judge or to keep")
    judgements = judge.judge(measured, known, whole=True) if known is not None else []
    if known is not None:
        gate_output.print_table(judgements)
    if update:
        judge.save_baseline(measured, baseline)
        click.echo(f"{baseline}: written, {len(measured.cells)} cells")
        return 0
    gate_output.write_outputs(judgements, results)
    return judge.exit_code(judgements)


@cli.command(name="list")
@click.argument("what", type=click.Choice(["scenarios", "methods", "forces"]))
@click.option("--json", "as_json", is_flag=True, help="For programs.")
def list_(what: str, as_json: bool) -> None:
    """List what can be named."""
    rows = {"scenarios": _scenario_rows, "methods": _method_rows, "forces": _force_rows}[what]()
    if as_json:
        click.echo(json.dumps(rows, indent=2))
        return
    width = max(len(row["name"]) for row in rows)
    for row in rows:
        click.echo(f"{row['name']:{width}}  {row['title']}")


def _scenario_rows() -> list[dict[str, Any]]:
    from umbra_bench.scenario import list_scenarios, load_scenario

    return [
        {
            "name": scenario.name,
            "title": scenario.title,
            "family": scenario.family,
            "description": scenario.description,
            "duration": scenario.duration,
            "steps": list(scenario.steps),
            "closed_form": scenario.closed_form,
        }
        for scenario in map(load_scenario, list_scenarios())
    ]


def _method_rows() -> list[dict[str, Any]]:
    return [
        {"name": m.name, "title": m.title, "kind": m.kind, "precision": m.precision}
        for m in [*METHODS.values(), *entry_points()]
    ]


def _force_rows() -> list[dict[str, Any]]:
    from umbra_bench.scenario import FORCE_KINDS

    return [
        {
            "name": kind,
            "title": " ".join((table.__doc__ or "").split()),
            "keys": {
                key: field.description for key, field in table.model_fields.items() if key != "kind"
            },
        }
        for kind, table in FORCE_KINDS.items()
    ]


def _prepare() -> None:
    from umbra_bench.jax_settings import keep_compiled_code

    keep_compiled_code()


@contextlib.contextmanager
def _progress(title: str) -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar on a terminal, plain lines elsewhere; both on standard error."""
    if not sys.stderr.isatty():

        def plain(what: str, done: int, total: int) -> None:
            click.echo(f"[{done}/{total}] {what}", err=True)

        yield plain
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None)

        def drawn(what: str, done: int, total: int) -> None:
            bar.update(task, completed=done, total=total, description=f"{title}: {what}")

        yield drawn


if __name__ == "__main__":
    main()

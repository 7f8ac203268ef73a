"""What was measured as a page, and as a table on the terminal; nothing is measured here."""

from __future__ import annotations

import inspect
import os
import textwrap
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from umbra_bench import plots
from umbra_bench.claims.figures import FIGURES
from umbra_bench.claims.record import CURVES_SCHEMA, load_claims
from umbra_bench.claims.statement import STATEMENTS, VERDICTS
from umbra_bench.results import load_table, replacing
from umbra_bench.umbra import repaired
from umbra_bench.wording import number, render

_COLOURS = {"holds": "green", "holds with a condition": "yellow", "fails": "red", "waits": "dim"}


def write_page(results: Path, output: Path) -> Path:
    """Draw the figures and write `claims.md`; return its path.

    Raises:
        UmbraBenchError: results that are missing, or a folder that cannot be written.
    """
    document = load_claims(results)
    curves = load_table("claims_curves", results, CURVES_SCHEMA)
    for name, draw in FIGURES.items():
        plots.save(draw(curves), output / "figures" / f"claims-{name}")
    page = output / "claims.md"
    text = render_page(document)
    with replacing(page) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return page


def render_page(document: dict[str, Any]) -> str:
    """The page in Markdown."""
    statements = document["statements"]
    return render(
        "claims.md.j2",
        subject=document["subject"],
        statements=statements,
        summary=summary(statements),
        by_verdict={v: [s for s in statements if s["verdict"] == v] for v in VERDICTS},
        proofs=document["proofs"],
        worst=_largest_mismatch(document["proofs"]["backward-error"]),
        damped=[row for row in document["proofs"]["stability"] if row["series"].endswith("damped")],
        steps=_best_steps(document["proofs"]["precision"]),
        repair_source=textwrap.dedent(inspect.getsource(repaired.repaired_step)),
        priming_source=textwrap.dedent(inspect.getsource(repaired.primed)),
        environment=document["environment"],
        criterion_text=criterion_text,
    )


def summary(statements: Iterable[dict[str, Any]]) -> str:
    """How many statements have which verdict, in words."""
    count = Counter(statement["verdict"] for statement in statements)
    words = {
        "holds": ("holds", "hold"),
        "holds with a condition": ("holds with a condition", "hold with a condition"),
        "fails": ("fails", "fail"),
        "waits": ("could not be measured", "could not be measured"),
    }
    parts = [f"{count[v]} {words[v][count[v] > 1]}" for v in VERDICTS if count[v]]
    return ", ".join(parts[:-1]) + f" and {parts[-1]}" if len(parts) > 1 else parts[0]


def criterion_text(criterion: dict[str, Any]) -> str:
    """A figure and the threshold that decides."""
    sign = {"<=": "≤", ">=": "≥"}[criterion["relation"]]
    unit = f" {criterion['unit']}" if criterion["unit"] else ""
    value = "not a number" if criterion["value"] is None else _exactly(criterion["value"]) + unit
    return f"{criterion['what']}: **{value}** ({sign} {_exactly(criterion['threshold'])}{unit})"


def _exactly(value: float) -> str:
    """Four figures, without hiding that a number is not quite one."""
    return f"{value:.4g}" if not 0.99 < abs(value) < 1.01 else f"{value:.10g}"


def _largest_mismatch(rows: list[dict[str, Any]]) -> dict[str, float]:
    """The largest distance of prediction and measurement over the methods, by quantity."""
    names = ("energy_mismatch", "shift_mismatch", "growth_mismatch")
    return {name: max(row[name] for row in rows) for name in names}


def _best_steps(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The range of the steps of least error, of the scenarios where a turn was seen."""
    turned = [row["best_step"] for row in rows if row["turned"]]
    return {
        "count": len(turned),
        "of": len(rows),
        "least": number(min(turned)) if turned else "–",
        "largest": number(max(turned)) if turned else "–",
    }


def print_claims(document: dict[str, Any]) -> None:
    """Print the statements as a table; of a few, the figures and proofs as well."""
    console = Console(width=None if os.isatty(1) else 160, highlight=False)
    statements = document["statements"]
    if statements:
        table = Table(box=None, pad_edge=False, header_style="bold")
        for name in ("verdict", "name"):
            table.add_column(name, no_wrap=True)
        table.add_column("statement")
        table.add_column("why")
        for s in statements:
            verdict = f"[{_COLOURS[s['verdict']]}]{s['verdict']}[/]"
            whatever = document["subject"] != "umbra" and not s["examines"]
            why = f"Whatever the method: {s['why']}" if whatever else s["why"]
            table.add_row(verdict, s["name"], escape(s["statement"]), escape(why))
        console.print(table)
    if len(statements) <= 3:
        for s in statements:
            for criterion in s["criteria"]:
                mark = "met" if criterion["met"] else "not met"
                console.print(
                    f"  {criterion_text(criterion).replace('**', '')}: {mark}", markup=False
                )
    if len(statements) < len(STATEMENTS):
        for name, rows in document["proofs"].items():
            _print_rows(console, name, rows)
    if len(statements) > 1:
        console.print(f"{len(statements)} statements: {summary(statements)}", markup=False)


def _print_rows(console: Console, name: str, rows: list[dict[str, Any]]) -> None:
    table = Table(box=None, pad_edge=False, header_style="bold", title=name, title_justify="left")
    for column in rows[0]:
        table.add_column(column.replace("_", " "))
    for row in rows:
        cells = (number(v, 3) if isinstance(v, float) else str(v) for v in row.values())
        table.add_row(*cells)
    console.print(table)

"""What the gate tells: a table for people, and the forms that CI systems read."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from umbra_bench.gate import Judgement, exit_code
from umbra_bench.results import replacing, save_json

_COLOURS = {"fail": "red", "unjudged": "magenta", "better": "green", "pass": "dim"}
_ORDER = ("fail", "unjudged", "better", "pass")


def number(value: float | None) -> str:
    """A number of the table: four figures, or a dash."""
    return "-" if value is None else f"{value:.4g}"


def summary(judgements: Sequence[Judgement]) -> str:
    """The verdict in one line."""
    counts = {v: sum(j.verdict == v for j in judgements) for v in _ORDER}
    words = {0: "PASS", 1: "FAIL", 2: "NOT JUDGED"}[exit_code(judgements)]
    line = f"gate: {words}: {len(judgements)} numbers judged, {counts['fail']} worse"
    if counts["unjudged"]:
        line += f", {counts['unjudged']} could not be judged"
    if counts["better"]:
        line += f", {counts['better']} better (run `umbra-bench gate --update` to keep them)"
    return line


def worst_first(judgements: Iterable[Judgement]) -> list[Judgement]:
    """What did not simply pass, the most serious and the largest factor first."""
    told = [j for j in judgements if j.verdict != "pass"]
    return sorted(told, key=lambda j: (_ORDER.index(j.verdict), -(j.factor or 0.0), j.cell))


def print_table(judgements: Sequence[Judgement], limit: int = 40) -> None:
    """Print one aligned table of what changed, and the verdict."""
    told = worst_first(judgements)
    # Wide enough that a log file never breaks a row.
    console = Console(width=None if os.isatty(1) else 160, highlight=False)
    if told:
        table = Table(box=None, pad_edge=False, header_style="bold")
        for title in ("cell", "metric"):
            table.add_column(title, no_wrap=True)
        for title in ("baseline", "now", "factor"):
            table.add_column(title, justify="right", no_wrap=True)
        table.add_column("verdict", no_wrap=True)
        table.add_column("why")
        for j in told[:limit]:
            row = (
                escape(j.cell),
                escape(j.metric),
                number(j.baseline),
                number(j.now),
                number(j.factor),
            )
            table.add_row(*row, f"[{_COLOURS[j.verdict]}]{j.verdict}[/]", escape(j.note))
        console.print(table)
        if len(told) > limit:
            console.print(f"... and {len(told) - limit} more: see results/gate.json")
    console.print(summary(judgements), markup=False)


def write_outputs(judgements: Sequence[Judgement], folder: Path) -> None:
    """Write gate.json and gate.xml (JUnit); on GitHub, annotations and the job's summary too."""
    save_json(_as_json(judgements), folder / "gate.json")
    with replacing(folder / "gate.xml") as temporary:
        ET.ElementTree(_as_junit(judgements)).write(temporary, "utf-8", xml_declaration=True)
    if os.environ.get("GITHUB_ACTIONS"):
        _tell_github(judgements)


def _as_json(judgements: Sequence[Judgement]) -> dict[str, Any]:
    return {
        "exit_code": exit_code(judgements),
        "summary": summary(judgements),
        "judgements": [
            {
                name: value if _representable(value) else str(value)
                for name, value in {**j._asdict(), "factor": j.factor}.items()
            }
            for j in judgements
        ],
    }


def _representable(value: Any) -> bool:
    """JSON has no infinity and no NaN."""
    return not (isinstance(value, float) and not -1e308 < value < 1e308)


def _as_junit(judgements: Sequence[Judgement]) -> ET.Element:
    """One test suite a line of the gate, one test case a number."""
    suites: dict[str, list[Judgement]] = defaultdict(list)
    for j in judgements:
        suites[_line_of(j.cell)].append(j)
    root = ET.Element("testsuites", name="umbra-bench gate")
    for name, members in suites.items():
        failures = sum(j.verdict == "fail" for j in members)
        errors = sum(j.verdict == "unjudged" for j in members)
        suite = ET.SubElement(
            root,
            "testsuite",
            name=name,
            tests=str(len(members)),
            failures=str(failures),
            errors=str(errors),
        )
        for j in members:
            case = ET.SubElement(suite, "testcase", classname=j.cell, name=j.metric)
            if j.verdict in ("fail", "unjudged"):
                kind = "failure" if j.verdict == "fail" else "error"
                ET.SubElement(case, kind, message=sentence(j))
    return root


def _line_of(cell: str) -> str:
    """A cell without its step, where it has one: a method's name may hold slashes."""
    head, _, last = cell.rpartition("/")
    try:
        float(last)
    except ValueError:
        return cell
    return head


def sentence(j: Judgement) -> str:
    """A judgement in one line: where, what, both numbers, the factor and why."""
    factor = "" if j.factor is None else f", factor {number(j.factor)}"
    return f"{j.cell} {j.metric}: baseline {number(j.baseline)}, now {number(j.now)}{factor} ({j.note})"


def _tell_github(judgements: Sequence[Judgement]) -> None:
    told = worst_first(judgements)
    levels = {"fail": "error", "unjudged": "error", "better": "notice"}
    console = Console(width=10_000, highlight=False)
    for j in told[:10]:
        message = sentence(j).replace("%", "%25")
        console.print(f"::{levels[j.verdict]} title=umbra-bench gate::{message}", markup=False)
    path = os.environ.get("GITHUB_STEP_SUMMARY")
    if path:
        lines = ["## umbra-bench gate", "", summary(judgements), ""]
        if told:
            lines += ["| cell | metric | baseline | now | factor | verdict | why |"]
            lines += ["| --- | --- | ---: | ---: | ---: | --- | --- |"]
            lines += [
                "| "
                + " | ".join(
                    text.replace("|", "\\|")
                    for text in (
                        *(j.cell, j.metric, number(j.baseline), number(j.now)),
                        *(number(j.factor), j.verdict, j.note),
                    )
                )
                + " |"
                for j in told[:100]
            ]
        with Path(path).open("a", encoding="utf-8") as file:
            file.write("\n".join(lines) + "\n")

"""The report: it shows what the tables hold, and nothing but the tables is needed for it."""

from __future__ import annotations

import base64
import dataclasses
import json
import math
import re
import shutil
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import matplotlib as mpl
import numpy as np
import polars as pl
import pytest
from markdown_it import MarkdownIt
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from test_results import MARKUP, METHODS_RUN, small_study, spared, spring

from umbra_bench import cli, findings, plots, report
from umbra_bench.errors import UmbraBenchError
from umbra_bench.html_report import explorer_data
from umbra_bench.methods import METHODS
from umbra_bench.plots import LOOKS
from umbra_bench.report import FIGURES, load_scenario_tables, write_report
from umbra_bench.results import save_study
from umbra_bench.scenario_tables import ScenarioTables
from umbra_bench.study import Study, run_study
from umbra_bench.wording import markdown_text

Table = list[list[str]]

BLOWN_UP = 1e6
"""Errors of these small motions beyond this are of methods that blew up, and cut on purpose."""


class InThisProcess:
    """The part of ProcessPoolExecutor that the report uses, without its processes."""

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def __enter__(self) -> InThisProcess:
        return self

    def __exit__(self, *_: object) -> None: ...

    def map(self, function: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterator[Any]:
        return map(function, jobs)


@pytest.fixture(autouse=True)
def _in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw here, where warnings are errors and what is patched is patched."""
    monkeypatch.setattr("umbra_bench.parallel.ProcessPoolExecutor", InThisProcess)


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small study on disk. Nobody changes it."""
    path = tmp_path_factory.mktemp("results")
    save_study(small_study(), path)
    return path


@pytest.fixture(scope="session")
def tables(folder: Path) -> dict[str, ScenarioTables]:
    """What the small study found, by scenario."""
    return {t.scenario["name"]: t for t in load_scenario_tables(folder)}


@pytest.fixture(scope="session")
def page(folder: Path, tables: dict[str, ScenarioTables]) -> str:
    """The page of the small study."""
    return report.render_page(list(tables.values()), folder)


@pytest.fixture(scope="session")
def figures(tables: dict[str, ScenarioTables]) -> dict[tuple[str, str], Figure]:
    """Every figure of the small study, by scenario and kind."""
    return {(name, kind): FIGURES[kind][1](tables[name]) for name in tables for kind in FIGURES}


# Reading pages and figures ------------------------------------------------------------------------

MARKDOWN = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])


def shown(inline: Any) -> str:
    """What a reader sees of a line: text and code, without the marks around them."""
    return "".join(
        child.content
        if child.type in ("text", "code_inline")
        else " " * (child.type == "softbreak")
        for child in inline.children
    )


def tables_on(page: str) -> list[Table]:
    """The tables of a page as a reader sees them."""
    found: list[Table] = []
    for token, inline in zip(tokens := MARKDOWN.parse(page), [*tokens[1:], None], strict=True):
        match token.type:
            case "table_open":
                found.append([])
            case "tr_open":
                found[-1].append([])
            case "th_open" | "td_open":
                found[-1][-1].append(shown(inline))
    return found


def table_with(page: str, *columns: str) -> Table:
    """The rows of the one table whose header begins with some columns."""
    (found,) = (t for t in tables_on(page) if t[0][: len(columns)] == list(columns))
    return found


def links_on(page: str) -> list[str]:
    """Where the pictures and links of a page point to."""
    inlines = [token for token in MARKDOWN.parse(page) if token.type == "inline"]
    children = [child for inline in inlines for child in inline.children or []]
    images = [str(child.attrs["src"]) for child in children if child.type == "image"]
    return images + [str(c.attrs["href"]) for c in children if c.type == "link_open"]


def numbers_in(text: str) -> list[float]:
    """The numbers of a text, in order."""
    return [
        float(n) for n in re.findall(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]\d+)?(?![\w])", text)
    ]


def rounded(shown_number: float, value: float) -> bool:
    """Whether a number is a value of the tables, rounded to two or three figures."""
    return shown_number in (float(f"{value:.1e}"), float(f"{value:.2e}"))


def method_of(title: str) -> str:
    return next(method.name for method in METHODS.values() if method.title == title)


def row_of(table: pl.DataFrame, **line: Any) -> dict[str, Any] | None:
    rows = table.filter(*(pl.col(key) == value for key, value in line.items())).to_dicts()
    assert len(rows) <= 1
    return rows[0] if rows else None


def curves(axes: Axes) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The curves of methods in a panel, by method; guides and floors are of other colours."""
    by_colour = {to_hex(LOOKS[name].colour): name for name in METHODS_RUN}
    found: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for line in axes.get_lines():
        name = by_colour.get(to_hex(line.get_color()))
        if name:
            assert name not in found
            found[name] = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
    return found


def panels(figure: Figure) -> dict[str, Axes]:
    """The panels of a figure by precision."""
    return {axes.get_title("left").partition(",")[0]: axes for axes in figure.axes}


def renamed(name: str, **more: Any) -> Study:
    """A study of one method on one scenario of another name."""
    scenario = spring(name, 4.0, 0.64, halvings=1, **more)
    return run_study([scenario], ["umbra"], ["float64"])


# The whole ----------------------------------------------------------------------------------------


def test_a_report_is_a_page_and_its_figures(tmp_path: Path) -> None:
    small, kept = small_study(), pl.col("scenario") != "spared"
    two = [scenario for scenario in small.scenarios if scenario.name != "spared"]
    some = dataclasses.replace(small, scenarios=two, references=small.references.filter(kept))
    save_study(some, tmp_path / "results")
    told: list[tuple[str, int, int]] = []
    output = tmp_path / "new" / "reports"
    written = write_report(tmp_path / "results", output, lambda *what: told.append(what))
    assert written == output / "index.html"
    assert [(done, total) for _, done, total in told] == [(n, 9) for n in range(1, 10)]
    names = {f"{s}-{kind}" for s in ("soft", "stiff") for kind in FIGURES} | {"orders"}
    files = {path.relative_to(output).as_posix() for path in output.rglob("*") if path.is_file()}
    pages = {"index.html", "index.md"}
    assert files == pages | {f"figures/{n}.svg" for n in names}
    for name in names:
        svg = ElementTree.parse(output / "figures" / f"{name}.svg").getroot()
        assert svg.tag.endswith("}svg")
    links = links_on((output / "index.md").read_text(encoding="utf-8"))
    assert set(links) == files - pages


def test_files_are_in_the_style_of_the_report_and_the_same_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the style says of files: dots per inch, text that stays text in an SVG, a fixed salt."""
    save_study(renamed("plain"), tmp_path / "results")
    monkeypatch.setattr(report, "FIGURES", {"error": FIGURES["error"]})
    first, second = (
        write_report(tmp_path / "results", tmp_path / name, formats=("svg", "png")).parent
        for name in ("first", "second")
    )
    style = mpl.rc_params_from_file(resources.files("umbra_bench") / "report.mplstyle")
    png = (first / "figures" / "plain-error.png").read_bytes()
    (plain,) = load_scenario_tables(tmp_path / "results")
    width = plots.draw_error(plain).get_figwidth() * style["savefig.dpi"]
    assert int.from_bytes(png[16:20], "big") == pytest.approx(width, abs=1)
    svg = (first / "figures" / "plain-error.svg").read_text(encoding="utf-8")
    assert "largest position error (m)</text>" in svg
    for path in (path.relative_to(first) for path in first.rglob("*.*")):
        assert (first / path).read_bytes() == (second / path).read_bytes(), path.name


def test_the_command_draws_in_processes_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.undo()
    save_study(renamed("plain"), tmp_path / "tables")
    monkeypatch.chdir(tmp_path)
    words = ["umbra-bench", "report", "--results", "tables", "--output", "pages"]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as ending:
        cli.main()
    stdout, stderr = capfd.readouterr()
    assert ending.value.code == 0
    assert stdout == "pages/index.html\n"
    assert [line.partition("]")[0] for line in stderr.splitlines()] == [
        f"[{n}/5" for n in (1, 2, 3, 4, 5)
    ]
    assert len(list((tmp_path / "pages" / "figures").iterdir())) == len(FIGURES) + 1


def test_a_report_never_simulates(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Everything that moves is forbidden, and no scenario file is near."""

    def forbidden(*_: object, **__: object) -> None:
        raise AssertionError("a report simulates")

    moving = {"simulate", "open_run", "run_study", "run_on_grid", "certified_reference"}
    moving |= {"solve_reference", "solve_dop853", "_advance", "load_scenario", "measure"}
    patched = set()
    for module in [m for name, m in sys.modules.items() if name.startswith("umbra_bench.")]:
        for name in moving & set(vars(module)):
            if callable(vars(module)[name]):
                monkeypatch.setattr(module, name, forbidden)
                patched.add(name)
    assert patched >= {"simulate", "run_study", "certified_reference", "_advance"}
    monkeypatch.setattr(report, "FIGURES", {"energy-time": FIGURES["energy-time"]})
    monkeypatch.chdir(tmp_path)
    assert write_report(folder, Path("reports")).is_file()


# The page -----------------------------------------------------------------------------------------


def test_the_orders_on_the_page_are_those_of_the_table(
    page: str, tables: dict[str, ScenarioTables], folder: Path
) -> None:
    orders = pl.read_csv(folder / "orders.csv")
    header, *rows = (r for t in tables_on(page) if t[0][1:] == list(tables) for r in t)
    assert header[1:] == ["soft", "stiff", "spared"]
    assert [method_of(row[0]) for row in rows] == [m for m in METHODS if m in METHODS_RUN]
    seen = 0
    for title, *cells in rows:
        for scenario, cell in zip(header[1:], cells, strict=True):
            line = {"scenario": scenario, "method": method_of(title), "precision": "float64"}
            row = row_of(orders, **line, quantity="position")
            if row is None:
                assert (scenario, line["method"]) == ("spared", "pymunk-spring")
                assert cell == "–"
            elif math.isnan(row["order"]):
                assert numbers_in(cell) == []
                assert cell != "–"
            else:
                order, *error = numbers_in(cell)
                assert order == round(row["order"], 2)
                assert error == ([round(row["standard_error"], 2)] if "±" in cell else [])
                assert "±" in cell or row["standard_error"] < 0.005
                seen += 1
    assert seen >= 3


def test_the_drifts_on_the_page_are_those_of_the_table(
    page: str, tables: dict[str, ScenarioTables], folder: Path
) -> None:
    runs = pl.read_csv(folder / "study.csv")
    header, *rows = table_with(page, "method", "precision")
    assert header[2:] == list(tables)
    seen, blown = 0, 0
    for title, precision, *cells in rows:
        for scenario, cell in zip(header[2:], cells, strict=True):
            line = {"method": method_of(title), "precision": precision}
            row = row_of(runs, scenario=scenario, dt=tables[scenario].default_step, **line)
            if row is None:
                assert cell == "–"
            elif row["diverged_at"] is not None:
                assert cell.startswith("diverged at ")
                assert numbers_in(cell) == [float(f"{row['diverged_at']:g}")]
                blown += 1
            else:
                assert float(cell) == float(f"{row['energy_drift_rate']:.1e}")
                seen += 1
    assert (seen, blown) == (3 * 2 * 2 + 2 * 3 - 1 - 1, 1)


def test_the_certificates_on_the_page_are_those_of_the_table(page: str, folder: Path) -> None:
    references = pl.read_csv(folder / "references.csv")
    header, *rows = table_with(page, "scenario", "compared with")
    assert [row[0] for row in rows] == references["scenario"].to_list()
    columns = {
        "position bound (m)": "position_bound",
        "velocity bound (m/s)": "velocity_bound",
        "energy bound": "energy_bound",
        "another tolerance": "tolerance_difference",
    }
    for row, reference in zip(rows, references.to_dicts(), strict=True):
        assert row[1] == reference["independent"]
        for column, key in columns.items():
            assert rounded(float(row[header.index(column)]), reference[key])


def test_the_page_tells_what_was_not_run_and_on_what(page: str, folder: Path) -> None:
    _, skip = table_with(page, "scenario", "method", "reason")
    assert skip[:2] == ["spared", "pymunk-spring"]
    assert "gravity" in skip[2]
    environment = json.loads((folder / "environment.json").read_text(encoding="utf-8"))
    for name, version in environment["packages"].items():
        assert f"{name} {version}" in page
    _, *hashes = table_with(page, "scenario", "SHA-256 of what it states")
    assert dict(hashes) == environment["scenarios"]


def test_a_title_that_looks_like_markup_shows_as_text(page: str) -> None:
    tokens = MARKDOWN.parse(page)
    kinds = {token.type for token in tokens}
    kinds |= {child.type for token in tokens for child in token.children or []}
    assert "html_block" not in kinds
    assert "html_inline" not in kinds
    lines = [shown(token) for token in tokens if token.type == "inline"]
    assert lines.count(MARKUP) == 1, "the heading"
    assert sum(MARKUP in line for line in lines) >= 2, "and the description"
    assert not [link for link in links_on(page) if "example.org" in link]
    pictures = [c for token in tokens for c in token.children or [] if c.type == "image"]
    assert sum(MARKUP in shown(picture) for picture in pictures) == len(FIGURES)


@pytest.mark.parametrize(
    "text",
    [
        "<script>alert(1)</script>",
        "<!-- gone -->",
        "a | b",
        "**x** __x__ *x* _x_",
        "`y` ``z``",
        "[z](http://example.org) ![z](z.png) [z]: z",
        "&lt; &#60; & < >",
        "\\| \\ \\\\",
        "# heading",
        "1. first",
        "- item",
        "+ item",
        "> quoted",
        "~~gone~~",
        "{{ 7 * 7 }} {% raw %}",
        "***",
        "---",
        "===",
        "Übung 2 · π ≈ 3,14",
    ],
)
def test_text_shows_as_it_was_written(text: str) -> None:
    escaped = markdown_text(text)
    for page in (f"`name`: {escaped}\nafter", f"# {escaped}", f"| a |\n| --- |\n| {escaped} |"):
        lines = [shown(token) for token in MARKDOWN.parse(page) if token.type == "inline"]
        assert lines[-1].removeprefix("name: ").removesuffix(" after") == text


def test_text_with_line_breaks_stays_on_its_line() -> None:
    assert markdown_text("one\n\n# two\r\n\tthree") == "one \\# two three"


def test_text_with_dollars_is_no_formula() -> None:
    """GitHub sets $...$ as mathematics."""
    assert re.findall(r"(?<!\\)\$", markdown_text("from $5_a to $6_b")) == []


@pytest.mark.parametrize("kind", ["error", "energy-time", "energy"])
@pytest.mark.parametrize("scenario", ["soft", "stiff", "spared"])
def test_the_numbers_of_a_caption_are_those_of_the_tables(
    tables: dict[str, ScenarioTables], kind: str, scenario: str
) -> None:
    of = tables[scenario]
    umbra, verlet = (
        row_of(of.runs, method=method, precision="float64", dt=of.default_step)
        for method in ("umbra", "velocity-verlet")
    )
    assert umbra is not None
    assert verlet is not None
    column = {
        "error": "position_error_max",
        "energy-time": "energy_error_max",
        "energy": "energy_error_max",
    }[kind]
    caption, _, outliers = findings.caption(kind, of).partition(" Apart from all")
    assert not outliers, "no engine of the small study is odd"
    stated = re.sub(r"float\d\d", "", caption)
    orders = []
    if kind == "error":
        stated, _, rest = stated.partition("At dt")
        for method in ("umbra", "velocity-verlet"):
            row = row_of(of.orders, method=method, precision="float64", quantity="position")
            assert row is not None
            if not math.isnan(row["order"]):
                orders.append(round(row["order"], 2))
                if row["standard_error"] >= 0.005:
                    orders.append(round(row["standard_error"], 2))
        assert numbers_in(stated) == orders
        stated = rest
    step, first, second, *more = numbers_in(stated)
    assert step == of.default_step
    assert rounded(first, umbra[column])
    assert rounded(second, verlet[column])
    if kind == "energy":
        assert rounded(more.pop(), of.reference["energy_scale"])
    assert more == []
    if kind == "energy-time":
        words = {"exact": "nothing but rounding", "bounded": "bounded", "gains": "it gains"}
        words |= {"loses": "it loses", "diverged": "it diverges"}
        fates = [words[findings.energy_fate(run, of)] for run in (umbra, verlet)]
        assert re.findall(r"\((.*?)\)", caption) == fates


@pytest.mark.parametrize("factor", [1e-6, 1e6])
@pytest.mark.parametrize("kind", ["error", "energy"])
def test_a_caption_names_an_engine_that_is_apart_from_all_others(
    tables: dict[str, ScenarioTables], kind: str, factor: float
) -> None:
    soft = tables["soft"]
    column = {"error": "position_error_max", "energy": "energy_error_max"}[kind]
    step = soft.runs["dt"].max()
    odd = (pl.col("method") == "pymunk") & (pl.col("dt") == step)
    spoilt = soft.runs.with_columns(
        pl.when(odd).then(factor * pl.col(column)).otherwise(pl.col(column)).alias(column)
    )
    caption = findings.caption(kind, dataclasses.replace(soft, runs=spoilt))
    title, error, dt = re.findall(
        r"or more: (.*) \(([^ ]+)(?: m)? at dt = ([^ ]+) s\)\.$", caption
    )[0]
    assert (method_of(title), float(dt)) == ("pymunk", step)
    assert rounded(float(error), spoilt.filter(odd)[column].item())


def test_a_caption_follows_its_table(tables: dict[str, ScenarioTables]) -> None:
    """A number of the tables that changes changes the caption: none is written anywhere else."""
    soft = tables["soft"]
    umbra = pl.col("method") == "umbra"
    columns = ("position_error_max", "energy_error_max", "energy_error_max")
    for kind, column in zip(("error", "energy-time", "energy"), columns, strict=True):
        runs = soft.runs.with_columns(
            pl.when(umbra).then(3 * pl.col(column)).otherwise(pl.col(column)).alias(column)
        )
        spoilt = dataclasses.replace(soft, runs=runs)
        before, after = (numbers_in(findings.caption(kind, of)) for of in (soft, spoilt))
        assert len(before) == len(after)
        assert sum(a != b for a, b in zip(before, after, strict=True)) == 1, kind


def test_the_figure_of_all_orders_and_its_caption_are_those_of_the_table(
    tables: dict[str, ScenarioTables], folder: Path
) -> None:
    orders = pl.read_csv(folder / "orders.csv").filter(
        (pl.col("quantity") == "position")
        & (pl.col("precision") == "float64")
        & pl.col("order").is_finite()
    )
    whole, rest = plots.draw_orders(list(tables.values())).axes
    labels = [text.get_text() for text in whole.get_yticklabels()]
    caption = findings.orders_caption(list(tables.values()))
    methods = [name for name in METHODS if name in METHODS_RUN]
    for method, label, marks, bars in zip(
        methods, labels, whole.containers, rest.containers, strict=True
    ):
        found = orders.filter(pl.col("method") == method)
        title = METHODS[method].title
        assert label.startswith(f"{title}  {found.height} of ")
        np.testing.assert_array_equal(marks[0].get_xdata(), found["order"])
        widths = [segment[1, 0] - segment[0, 0] for segment in bars[2][0].get_segments()]
        np.testing.assert_allclose(widths, 2 * found["standard_error"], rtol=0, atol=1e-12)
        stated = f"{title} {found['order'].median() or 0.0:.2f} ({found.height} scenarios)"
        assert (stated in caption) == (found.height > 0)
    assert orders.height >= 3


def test_the_caption_of_the_motion_names_who_leaves_it(tables: dict[str, ScenarioTables]) -> None:
    for of in tables.values():
        caption = findings.caption("motion", of)
        for method in of.methods:
            row = row_of(of.runs, method=method, precision="float64", dt=of.default_step)
            assert row is not None
            far = row["position_error_max"] >= 0.1 * of.reference["length_scale"]
            assert (METHODS[method].title in caption) == far, method
    assert METHODS["pymunk"].title in findings.caption("motion", tables["stiff"])


def test_the_findings_are_of_what_the_results_hold(
    page: str, tables: dict[str, ScenarioTables], folder: Path
) -> None:
    paragraph = findings.paragraph(list(tables.values()))
    assert paragraph in page
    orders = pl.read_csv(folder / "orders.csv").filter(
        (pl.col("method") == "umbra")
        & (pl.col("precision") == "float64")
        & (pl.col("quantity") == "position")
        & pl.col("order").is_finite()
    )["order"]
    assert len(orders) >= 1
    assert f"order {orders.median():.2f}" in paragraph
    assert f"from {orders.min():.2f} to {orders.max():.2f}" in paragraph


def test_runs_of_umbra_without_an_order_are_still_runs_of_umbra() -> None:
    """Two steps show no order: the findings may be silent, but must not say that nothing was run."""
    with_umbra = report.tables_of(renamed("brief"))
    assert "no runs" not in findings.paragraph(with_umbra)


# The figures --------------------------------------------------------------------------------------


def test_every_axis_has_a_label_with_its_unit(figures: dict[tuple[str, str], Figure]) -> None:
    for figure in figures.values():
        first = figure.axes[0]
        labels = [axes.get_xlabel() for axes in figure.axes] + [first.get_ylabel()]
        for label in labels:
            assert re.search(r"\((m|s|m/s|rad|rad/s|J)\)$| / energy scale$", label), label
        for axes in figure.axes[1:]:
            assert axes.get_ylabel() or axes.get_shared_y_axes().joined(axes, first)


@pytest.mark.parametrize("family", ["spring", "orbit", "free_fall", "rotation"])
def test_every_family_has_a_picture_of_its_motion(
    tables: dict[str, ScenarioTables], family: str
) -> None:
    soft = tables["soft"]
    of = dataclasses.replace(soft, scenario=soft.scenario | {"family": family})
    (axes,) = plots.draw_motion(of).axes
    for label in (axes.get_xlabel(), axes.get_ylabel()):
        assert re.search(r"\((m|s|m/s|rad)\)$", label)
    assert set(curves(axes)) == set(METHODS_RUN)


@pytest.mark.parametrize(
    ("kind", "column"), [("error", "position_error_max"), ("energy", "energy_error_max")]
)
def test_errors_are_drawn_where_the_table_has_them(
    figures: dict[tuple[str, str], Figure],
    tables: dict[str, ScenarioTables],
    kind: str,
    column: str,
) -> None:
    cut = 0
    for name, of in tables.items():
        drawn = panels(figures[name, kind])
        assert set(drawn) == {"float64", "float32"}
        for precision, axes in drawn.items():
            assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
            found = curves(axes)
            for method in of.methods:
                rows = of.runs.filter(
                    (pl.col("method") == method) & (pl.col("precision") == precision)
                ).sort("dt")
                within = rows.filter((pl.col(column) > 0) & (pl.col(column) < BLOWN_UP))
                cut += rows.height - within.height
                x, y = found.pop(method, (np.empty(0), np.empty(0)))
                np.testing.assert_array_equal(x, within["dt"])
                np.testing.assert_array_equal(y, within[column])
            assert found == {}
    assert cut > 0, "a method blew up, and is cut on purpose"


def test_energy_over_time_is_drawn_as_the_table_has_it(
    figures: dict[tuple[str, str], Figure], tables: dict[str, ScenarioTables]
) -> None:
    for name, of in tables.items():
        for precision, axes in panels(figures[name, "energy-time"]).items():
            assert axes.get_yscale() == "log"
            for method, (t, size) in curves(axes).items():
                series = of.energy.filter(
                    (pl.col("method") == method) & (pl.col("precision") == precision)
                )
                lowest, highest = (abs(series[c].to_numpy()) for c in ("lowest", "highest"))
                largest = dict(zip(series["t"], np.fmax(lowest, highest), strict=True))
                within = [e for e in largest.values() if 0 < e < BLOWN_UP]
                kept = np.isfinite(size)
                assert [largest[when] for when in t[kept]] == size[kept].tolist()
                assert size[kept].max() == max(within), "no crest is lost"
            assert curves(axes)


def test_the_explorer_misses_no_crest(tables: dict[str, ScenarioTables]) -> None:
    for of, data in zip(
        tables.values(), explorer_data(list(tables.values()))["scenarios"], strict=True
    ):
        for line in data["lines"]:
            shown = np.frombuffer(base64.b64decode(line["over_time"]["error"]), "<f4")
            run = row_of(
                of.runs, method=line["method"], precision=line["precision"], dt=of.default_step
            )
            assert run is not None
            if 0.0 < run["energy_error_max"] < BLOWN_UP:
                assert np.nanmax(shown) == pytest.approx(run["energy_error_max"], rel=1e-6)


def test_all_curves_are_within_the_limits(figures: dict[tuple[str, str], Figure]) -> None:
    for (scenario, kind), figure in figures.items():
        if kind == "motion":
            continue
        for axes in figure.axes:
            (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
            assert (left, low) < (right, high)
            for method, (x, y) in curves(axes).items():
                kept = np.isfinite(y)
                where = f"{scenario}, {kind}, {method}"
                assert kept.any(), where
                assert left <= x[kept].min() <= x[kept].max() <= right, where
                assert low < y[kept].min() <= y[kept].max() < high, where


def test_the_motion_shows_all_of_the_reference(
    figures: dict[tuple[str, str], Figure], tables: dict[str, ScenarioTables]
) -> None:
    """A method that flies off is cut on purpose; the truth never is."""
    for name, of in tables.items():
        (axes,) = figures[name, "motion"].axes
        truth = of.motion.filter(pl.col("method") == "reference").sort("t")
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        assert left < truth["x"].min() <= truth["x"].max() < right
        assert low < truth["vx"].min() <= truth["vx"].max() < high
        widest = max(axes.get_lines(), key=lambda line: line.get_linewidth())
        np.testing.assert_array_equal(widest.get_xdata(), truth["x"])
        np.testing.assert_array_equal(widest.get_ydata(), truth["vx"])
        umbra = of.motion.filter((pl.col("method") == "umbra") & (pl.col("precision") == "float64"))
        np.testing.assert_array_equal(curves(axes)["umbra"][0], umbra["x"])


def test_the_legend_names_every_method_with_its_order(
    figures: dict[tuple[str, str], Figure], tables: dict[str, ScenarioTables]
) -> None:
    for (name, kind), figure in figures.items():
        of = tables[name]
        labels = [text.get_text() for text in figure.legends[0].get_texts()]
        titles = [METHODS[method].title for method in of.methods]
        if kind in ("motion", "energy-time"):
            assert [label for label in labels if label != "Reference"] == titles
            continue
        quantity = "position" if kind == "error" else "energy"
        for label, title in zip(labels, titles, strict=True):
            assert label.startswith(f"{title} (")
            line = {"method": method_of(title), "precision": "float64", "quantity": quantity}
            row = row_of(of.orders, **line)
            assert row is not None
            stated = label.removeprefix(f"{title} ")
            if math.isnan(row["order"]):
                assert numbers_in(stated) == []
            else:
                order, *error = numbers_in(stated)
                assert order == round(row["order"], 3)
                assert error == ([round(row["standard_error"], 3)] if "±" in stated else [])
                assert "±" in stated or row["standard_error"] < 0.0005


def test_a_look_is_of_one_method() -> None:
    looks = [(look.colour, str(look.line), look.marker) for look in LOOKS.values()]
    assert len(set(looks)) == len(looks)
    assert len({look.colour for look in LOOKS.values()}) == len(LOOKS)
    studied = {name for name, m in METHODS.items() if m.kind != "reference"}
    studied -= {name for name, m in METHODS.items() if not getattr(m, "studied", True)}
    assert studied <= set(LOOKS), "every method that a study runs unasked has its look"


# Results of unusual form --------------------------------------------------------------------------


def draw_all(study: Study) -> None:
    for of in report.tables_of(study):
        for _, draw in FIGURES.values():
            draw(of)


@pytest.mark.parametrize(
    ("methods", "precisions"),
    [(["umbra"], ["float32"]), (["pymunk"], ["float64"]), (["velocity-verlet"], ["float64"])],
    ids=["float32-alone", "engine-alone", "blown-up-alone"],
)
def test_a_study_of_little_has_figures_too(methods: list[str], precisions: list[str]) -> None:
    stiff = spring("stiff", 1e4, 1.28, halvings=0, closed_form="normal_modes")
    study = run_study([spared(), stiff], methods, precisions)
    draw_all(study)
    assert findings.paragraph(report.tables_of(study))


@pytest.mark.parametrize("size", [1e-9, 1.5e11], ids=["nanometres", "earth-orbit"])
def test_a_motion_of_any_size_is_drawn(size: float) -> None:
    """Units are SI throughout, so planets and pollen are both scenarios: what is large is relative."""
    body = {"name": "b", "mass": 1.0, "position": [size, 0.0], "velocity": [0.1 * size, 0.0]}
    pull = {"kind": "spring", "body": "b", "anchor": [0.0, 0.0], "stiffness": 4.0}
    study = renamed("sized", bodies=[body], forces=[pull], gravity=[0.0, -0.1 * size])
    assert study.runs["diverged_at"].null_count() == study.runs.height
    (of,) = report.tables_of(study)
    (axes,) = plots.draw_motion(of).axes
    truth = max(axes.get_lines(), key=lambda line: line.get_linewidth())
    assert np.isfinite(truth.get_xdata()).all()
    assert axes.get_xlim()[0] < size < axes.get_xlim()[1]
    for draw in (plots.draw_error, plots.draw_energy, plots.draw_energy_over_time):
        assert "umbra" in curves(panels(draw(of))["float64"]), draw.__name__


@pytest.mark.parametrize("name", ["v1.2", "odd name", "odd (1)", "a_b*c*", "50%"])
def test_the_pictures_of_a_scenario_of_any_name_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(report, "FIGURES", {"motion": FIGURES["motion"]})
    save_study(renamed(name), tmp_path / "results")
    page = write_report(tmp_path / "results", tmp_path / "reports").with_suffix(".md")
    links = links_on(page.read_text(encoding="utf-8"))
    assert len(set(links)) == 2, "of its motion, and of all orders"
    for link in links:
        assert (page.parent / unquote(link)).is_file(), link


def test_a_scenario_of_an_odd_name_shows_it(tmp_path: Path) -> None:
    save_study(renamed("a`b`<i>"), tmp_path)
    page = report.render_page(load_scenario_tables(tmp_path), tmp_path)
    tokens = [child for token in MARKDOWN.parse(page) for child in token.children or []]
    assert "html_inline" not in {token.type for token in tokens}


@pytest.mark.parametrize("name", ["$\\bad{$", "from $5 to $6", '<b> & "c"', "a_b^c"])
def test_a_body_of_any_name_is_drawn_as_it_is_called(tmp_path: Path, name: str) -> None:
    body = {"name": name, "mass": 1.0, "position": [1.0, 0.0]}
    pull = {"kind": "spring", "body": name, "anchor": [0.0, 0.0], "stiffness": 4.0}
    (of,) = report.tables_of(renamed("odd", bodies=[body], forces=[pull]))
    with mpl.rc_context({"svg.fonttype": "none"}):
        plots.draw_motion(of).savefig(tmp_path / "motion.svg")
    svg = ElementTree.parse(tmp_path / "motion.svg").getroot()
    assert any(text.startswith(f"{name}, float64") for text in svg.itertext())


def test_a_study_of_which_nothing_could_run_has_a_page(tmp_path: Path) -> None:
    study = run_study([spared()], ["pymunk-spring"], ["float64"])
    assert study.runs.is_empty()
    save_study(study, tmp_path)
    found = load_scenario_tables(tmp_path)
    assert "pymunk" in report.render_page(found, tmp_path)
    draw_all(study)


def test_results_of_two_studies_are_not_mixed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A study that dies between two of its files leaves the one before; a file of another is told."""
    results, other = tmp_path / "results", tmp_path / "other"
    save_study(renamed("first"), results)
    save_study(renamed("second"), other)

    def dies(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as dying:
        dying.setattr("umbra_bench.results.save_json", dies)
        with pytest.raises(KeyboardInterrupt):
            save_study(renamed("second"), results)
    (tables,) = load_scenario_tables(results)
    assert tables.scenario["name"] == "first"
    shutil.copy(other / "study.parquet", results)
    with pytest.raises(UmbraBenchError) as caught:
        write_report(results, tmp_path / "reports")
    assert str(caught.value).startswith(f"{results}/study.parquet: is not what was written")
    assert len(str(caught.value).splitlines()) == 1


def refused(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *words: object
) -> str:
    """The one line of a report that could not be drawn."""
    monkeypatch.setattr(sys, "argv", ["umbra-bench", "report", *map(str, words)])
    with pytest.raises(SystemExit) as ending:
        cli.main()
    stdout, stderr = capfd.readouterr()
    assert (ending.value.code, stdout) == (2, "")
    (line,) = stderr.splitlines()
    assert line.startswith("umbra-bench: ")
    return line


def test_a_report_without_results_is_refused_and_leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    line = refused(capfd, monkeypatch)
    assert "results/study.parquet: missing" in line
    assert "umbra-bench study" in line
    assert list(tmp_path.iterdir()) == []
    old = tmp_path / "reports" / "figures" / "old.svg"
    old.parent.mkdir(parents=True)
    old.write_text("old", encoding="utf-8")
    refused(capfd, monkeypatch)
    assert old.read_text(encoding="utf-8") == "old"


@pytest.mark.parametrize(
    "name",
    [
        *(f"{table}.parquet" for table in ("study", "orders", "references", "skips")),
        *("motion.parquet", "energy.parquet", "scenarios.json", "environment.json"),
    ],
)
@pytest.mark.parametrize("content", [None, "{"], ids=["missing", "cut"])
def test_results_that_are_incomplete_are_refused(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    name: str,
    content: str | None,
) -> None:
    results = tmp_path / "results"
    results.mkdir()
    for path in folder.iterdir():
        if path.name != name:
            (results / path.name).write_bytes(path.read_bytes())
    if content is not None:
        (results / name).write_text(content, encoding="utf-8")
    monkeypatch.setattr(report, "FIGURES", {})
    line = refused(capfd, monkeypatch, "--results", results, "--output", tmp_path / "reports")
    assert name in line


def test_a_folder_that_cannot_be_written_is_refused(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    output = tmp_path / "file" / "reports"
    line = refused(capfd, monkeypatch, "--results", folder, "--output", output)
    assert "cannot be written" in line
    assert (tmp_path / "file").read_text(encoding="utf-8") == "in the way"

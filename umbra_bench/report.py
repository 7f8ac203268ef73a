"""Results to pages: figures, tables and findings, drawn from the tables on disk alone."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote

import polars as pl
from matplotlib.figure import Figure

from umbra_bench import findings, plots
from umbra_bench.claims.record import CURVES_SCHEMA, load_claims
from umbra_bench.comparison import Difference, beside, differences
from umbra_bench.drift_figures import LongRuns, draw_long_runs, load_long_runs
from umbra_bench.errors import UmbraBenchError
from umbra_bench.html_report import render_html
from umbra_bench.parallel import map_in_processes
from umbra_bench.results import (
    described,
    load_environment,
    load_scenarios,
    load_table,
    replacing,
)
from umbra_bench.scenario_tables import ScenarioTables
from umbra_bench.schemas import ENGINE_STEPS, ENGINES_SCHEMA
from umbra_bench.wording import render

if TYPE_CHECKING:
    from umbra_bench.study import Study

FIGURES: dict[str, tuple[str, Callable[[ScenarioTables], Any]]] = {
    "error": ("Error against step size", plots.draw_error),
    "energy-time": ("Energy error over time", plots.draw_energy_over_time),
    "energy": ("Largest energy error against step size", plots.draw_energy),
    "motion": ("The motion", plots.draw_motion),
}

Listener = Callable[[str, int, int], None]


def write_report(
    results: Path,
    output: Path,
    listener: Listener = lambda what, done, total: None,
    against: Path | None = None,
    formats: Sequence[str] = ("svg",),
) -> Path:
    """Draw all figures and write both pages; return the path of `index.html`.

    `against`: the folder of another run's results, drawn beneath and compared.
    `formats`: of the figures; the pages show the SVG.

    Raises:
        UmbraBenchError: results that are missing or cannot be read; a folder that cannot be written.
    """
    tables = load_scenario_tables(results)
    if against is not None:
        tables = beside(tables, load_scenario_tables(against))
    changed = Changed(str(against), differences(tables)) if against is not None else None
    claims = _claims(results)
    long_runs = load_long_runs(results)
    markdown = functools.partial(render_page, tables, results, changed)
    page = functools.partial(
        render_html,
        tables,
        claims=claims,
        engines=_engines(results),
        skips=load_table("skips", results).to_dicts(),
        environment=load_environment(results),
        changed=changed,
        curves=load_table("claims_curves", results, CURVES_SCHEMA) if claims else None,
        long_runs=long_runs,
    )
    place = Place(output / "figures", tuple(formats))
    figures = [functools.partial(_draw_orders, [_without_series(t) for t in tables], place)]
    figures += [functools.partial(_draw_long_runs, runs, place) for runs in long_runs]
    figures += [functools.partial(_draw, t, name, place) for t in tables for name in FIGURES]
    pieces: list[Callable[[], Any]] = [page, markdown, *figures]
    work = map_in_processes(_call, pieces)
    html, text_page = next(work), next(work)  # the longest first: the figures are drawn beside them
    for done, path in enumerate(work, start=1):
        listener(path.name, done, len(figures))
    for name, text in (("index.md", text_page), ("index.html", html)):
        with replacing(output / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return output / "index.html"


def load_scenario_tables(results: Path) -> list[ScenarioTables]:
    """The tables of a study on disk, one bundle a scenario."""
    return _bundles(
        load_table("study", results),
        load_table("orders", results),
        load_table("references", results),
        load_table("motion", results),
        load_table("energy", results),
        load_scenarios(results),
    )


def tables_of(study: Study) -> list[ScenarioTables]:
    """The tables of a study in memory, one bundle a scenario."""
    return _bundles(
        study.runs,
        study.orders,
        study.references,
        study.motion,
        study.energy,
        described(study.scenarios),
    )


def _bundles(
    runs: pl.DataFrame,
    orders: pl.DataFrame,
    references: pl.DataFrame,
    motion: pl.DataFrame,
    energy: pl.DataFrame,
    scenarios: dict[str, Any],
) -> list[ScenarioTables]:
    for name in sorted({*scenarios} - {*references["scenario"]}):
        raise UmbraBenchError(
            f"references.parquet: holds no reference of scenario {name!r} of the tables beside it; "
            "run `umbra-bench study` again"
        )
    for name in references["scenario"]:
        if name not in scenarios:
            raise UmbraBenchError(
                f"scenarios.json: does not describe scenario {name!r} of the tables beside it; "
                "run `umbra-bench study` again"
            )
        if motion.filter(pl.col("scenario") == name).is_empty():
            raise UmbraBenchError(
                f"motion.parquet: holds no motion on scenario {name!r} of the tables beside it; "
                "run `umbra-bench study` again"
            )
    return [
        ScenarioTables(
            scenario=scenarios[reference["scenario"]],
            reference=reference,
            **_parts(reference["scenario"], runs, orders, motion, energy),
        )
        for reference in references.to_dicts()
    ]


def _parts(name: str, *tables: pl.DataFrame) -> dict[str, Any]:
    """The rows of one scenario, of each of the tables."""
    names = ("runs", "orders", "motion", "energy")
    return {
        key: table.filter(pl.col("scenario") == name)
        for key, table in zip(names, tables, strict=True)
    }


class Changed(NamedTuple):
    """What differs from another run, and where that run lies."""

    against: str
    differences: list[Difference]


def render_page(tables: list[ScenarioTables], results: Path, changed: Changed | None = None) -> str:
    """The page in Markdown."""
    return render(
        "index.md.j2",
        findings=findings.paragraph(tables, _claims(results)),
        scenarios=[
            {
                "tables": t,
                "figures": [
                    {
                        "file": quote(f"figures/{t.scenario['name']}-{name}"),
                        "title": title,
                        "caption": findings.caption(name, t),
                    }
                    for name, (title, _) in FIGURES.items()
                ],
            }
            for t in tables
        ],
        orders=findings.order_table(tables),
        orders_caption=findings.orders_caption(tables),
        drifts=findings.drift_table(tables),
        long_runs=[
            {
                "runs": runs,
                "caption": findings.long_runs_caption(runs.laws.to_dicts()),
                "file": quote(f"figures/{runs.scenario}-drift"),
            }
            for runs in load_long_runs(results)
        ],
        engines=_engines(results),
        engine_steps=ENGINE_STEPS,
        changed=changed,
        references=[t.reference for t in tables],
        skips=load_table("skips", results).to_dicts(),
        environment=load_environment(results),
    )


def _engines(results: Path) -> list[dict[str, Any]]:
    """The engines side by side, where a study compared any."""
    if not (results / "engines.parquet").is_file():
        return []
    return load_table("engines", results, ENGINES_SCHEMA).to_dicts()


def _claims(results: Path) -> dict[str, Any] | None:
    """What `umbra-bench claims` found, where it was run."""
    return load_claims(results) if (results / "claims.json").is_file() else None


def _call(piece: Callable[[], Any]) -> Any:
    return piece()


class Place(NamedTuple):
    """Where figures are written, and as what."""

    folder: Path
    formats: tuple[str, ...]

    def save(self, figure: Figure, name: str) -> Path:
        return plots.save(figure, self.folder / name, self.formats)


def _draw(tables: ScenarioTables, name: str, place: Place) -> Path:
    return place.save(FIGURES[name][1](tables), f"{tables.scenario['name']}-{name}")


def _draw_orders(tables: list[ScenarioTables], place: Place) -> Path:
    return place.save(plots.draw_orders(tables), "orders")


def _draw_long_runs(runs: LongRuns, place: Place) -> Path:
    return place.save(draw_long_runs(runs), f"{runs.scenario}-drift")


def _without_series(tables: ScenarioTables) -> ScenarioTables:
    """What the figure of orders needs: less to hand to another process."""
    none = tables.motion.clear()
    return dataclasses.replace(tables, motion=none, energy=none, before=None)

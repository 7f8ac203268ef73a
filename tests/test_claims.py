"""Claims: a verdict follows from figures, and another integrator gets other verdicts."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from umbra_bench import compiled
from umbra_bench.claims.lab import Lab
from umbra_bench.claims.measuring import ORDERED, measure_named, measure_one, names
from umbra_bench.claims.page import criterion_text, summary, write_page
from umbra_bench.claims.proofs import PROOFS
from umbra_bench.claims.record import CURVES_SCHEMA, FORMAT, Found, load_claims, save_claims
from umbra_bench.claims.statement import STATEMENTS, Evidence, at_least, at_most
from umbra_bench.errors import UmbraBenchError
from umbra_bench.findings import claims_sentence
from umbra_bench.methods import Method

# Verdicts ------------------------------------------------------------------------------------------


def evidence(required: float, limit: float) -> Evidence:
    return Evidence(
        required=(at_most("error", required, 1.0),),
        limits=(at_least("reach", limit, 2.0),),
        holds="good",
        condition="up to a point",
        fails="bad",
    )


@pytest.mark.parametrize(
    ("required", "limit", "verdict", "why"),
    [
        (1.0, 2.0, "holds", "good"),
        (1.0, 1.9, "holds with a condition", "up to a point"),
        (1.1, 2.0, "fails", "bad"),
        (1.1, 1.9, "fails", "bad"),
        (math.nan, 2.0, "fails", "bad"),
        (0.0, math.nan, "holds with a condition", "up to a point"),
        (math.inf, 2.0, "fails", "bad"),
    ],
)
def test_a_verdict_follows_from_the_figures(
    required: float, limit: float, verdict: str, why: str
) -> None:
    found = evidence(required, limit)
    assert (found.verdict, found.why) == (verdict, why)


def test_every_statement_is_named_once_and_can_be_asked_for_alone() -> None:
    assert len(ORDERED) == len(STATEMENTS) >= 35
    assert len(set(names())) == len(names()) == len(STATEMENTS) + len(PROOFS)


# Another integrator gets other verdicts ---------------------------------------------------------------

CHANGED_BY_THE_REPAIR = {
    "umbra-second-order": ("fails", "holds"),
    "umbra-better-energy": ("fails", "holds"),
    "umbra-smoother": ("fails", "holds"),
    "stored-acceleration-pays": ("fails", "holds"),
    "umbra-order-of-phases": ("fails", "holds"),
    "ten-a-second": ("holds with a condition", "holds"),
    "default-step-is-sensible": ("holds with a condition", "holds"),
}


def verdict(name: str, lab: Lab) -> str:
    return str(measure_one(STATEMENTS[name], lab)["verdict"])


def test_the_repaired_pipeline_in_place_of_the_published_one_changes_the_verdicts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    published = Lab()
    before = {name: verdict(name, published) for name in CHANGED_BY_THE_REPAIR}
    monkeypatch.setitem(
        compiled.COMPILED_METHODS, "umbra", compiled.COMPILED_METHODS["umbra-repaired"]
    )
    altered = Lab()
    after = {name: verdict(name, altered) for name in CHANGED_BY_THE_REPAIR}
    assert {name: (before[name], after[name]) for name in before} == CHANGED_BY_THE_REPAIR


@pytest.mark.parametrize("name", ["umbra-second-order", "umbra-no-spiral"])
def test_explicit_euler_in_its_place_fails(name: str) -> None:
    assert verdict(name, Lab("explicit-euler")) == "fails"


def test_a_spoilt_inertia_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    assert verdict("disk-inertia", Lab()) == "holds"
    monkeypatch.setattr("umbra_bench.umbra.bodies.disk_inertia", lambda m, r: 0.4 * m * r * r)
    assert verdict("disk-inertia", Lab()) == "fails"


def test_a_method_that_does_not_exist_is_refused() -> None:
    with pytest.raises(UmbraBenchError, match="'umbro': allowed are"):
        Lab("umbro")


LIMITED = {
    "inverse-mass-zero-is-immovable",
    "kinematic-and-sleeping",
    "damping-frame-rate-independent",
    "wrapping-prevents-drift",
    "forces-cleared-each-frame",
    "default-step-is-sensible",
}


@pytest.mark.parametrize("name", [s.name for s in ORDERED if s.chapter in ("mass", "frames")])
def test_the_statements_about_bodies_and_frames(name: str) -> None:
    assert verdict(name, Lab()) == ("holds with a condition" if name in LIMITED else "holds")


def test_wrapping_is_examined_in_what_does_not_wrap() -> None:
    assert verdict("wrapping-prevents-drift", Lab("semi-implicit-euler")) == "fails"


def test_a_tie_is_not_better() -> None:
    assert verdict("umbra-better-energy", Lab("semi-implicit-euler")) == "fails"


def test_a_statement_tells_whether_it_depends_on_the_method() -> None:
    lab = Lab("velocity-verlet")
    assert measure_one(STATEMENTS["ten-a-second"], lab)["examines"]
    assert not measure_one(STATEMENTS["forces-cleared-each-frame"], lab)["examines"]


# On disk and on the page ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    """Real rows of cheap statements, and one row of each proof's form."""
    wanted = [
        "umbra-second-order",
        "gravity-flag",
        "inverse-mass-zero-is-immovable",
        "engines-use-it",
    ]
    with pytest.MonkeyPatch.context() as patch:  # a machine without the engines of the devlog
        patch.setattr(Method, "installed", property(lambda method: method.package is None))
        found = measure_named(wanted).document
    numbers = {"energy_mismatch": 0.001, "shift_mismatch": 0.002, "growth_mismatch": 0.003}
    orders = {
        f"{q}_order_{s}": 1.0
        for q in ("position", "velocity")
        for s in ("spring", "orbit_eccentric")
    }
    row = {
        "method": "umbra",
        "scenario": "spring",
        "series": "umbra, damped",
        "change": "as published",
        "formula": "ω² dt",
        "dt": 0.01,
        "turned": True,
        "energy_law": "linear",
        "position_law": "linear",
        **numbers,
        **orders,
    }
    floats = (
        "as_read half_a_kick_later determinant whole_determinant ulps of_error position_ulps "
        "velocity_ulps shift predicted_shift growth predicted_growth stable_up_to "
        "distance_from_theory best_step least_error shortest_step energy_exponent "
        "position_exponent energy position time energy_error_spring force_evaluations "
        "numbers_per_body step_ratio"
    )
    row |= dict.fromkeys(floats.split(), 0.5)
    environment = {"processor": "a|b", "cores": 2, "platform": "x", "python": "3", "packages": {}}
    return {**found, "proofs": {name: [row] for name in PROOFS}, "environment": environment}


def test_the_document_is_plain_json(document: dict[str, Any]) -> None:
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    immovable = next(s for s in document["statements"] if "immovable" in s["name"])
    assert [c["value"] for c in immovable["criteria"]] == [0.0, None]  # not a number is none


def test_a_statement_whose_engines_are_missing_waits(document: dict[str, Any]) -> None:
    row = next(s for s in document["statements"] if s["name"] == "engines-use-it")
    assert row["verdict"] == "waits"
    assert "`make engines`" in row["why"]


def test_the_page_holds_every_row_and_every_figure(
    document: dict[str, Any], tmp_path: Path
) -> None:
    points = [
        {"proof": name, "series": "umbra", "x": x, "measured": x * x, "predicted": x}
        for name in PROOFS
        for x in (0.1, 0.2, 0.4)
    ]
    save_claims(Found(document, pl.DataFrame(points, CURVES_SCHEMA)), tmp_path)
    page = write_page(tmp_path, tmp_path / "reports").read_text(encoding="utf-8")
    for row in document["statements"]:
        assert f"`{row['name']}`" in page
        for criterion in row["criteria"]:
            assert criterion_text(criterion) in page
    for line in page.splitlines():
        if "](figures/" in line:
            figure = line.partition("](")[2].rstrip(")")
            assert (tmp_path / "reports" / figure).stat().st_size > 1000
    assert "def repaired_step" in page


def test_the_first_paragraph_of_the_report_names_what_fails(document: dict[str, Any]) -> None:
    text = "".join(claims_sentence(document))
    assert "Of 3 statements" in text
    assert "UMBRA's integrator is of second order" in text
    assert "immovable" not in text
    assert list(claims_sentence(None)) == []


def test_the_summary_counts() -> None:
    rows = [{"verdict": v} for v in ("holds", "holds", "fails", "waits")]
    assert summary(rows) == "2 hold, 1 fails and 1 could not be measured"
    assert summary(rows[:1]) == "1 holds"


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "run `umbra-bench claims`"), ("{}", "not written by this"), ("{", "not valid JSON")],
)
def test_claims_that_cannot_be_read(tmp_path: Path, content: str | None, message: str) -> None:
    if content is not None:
        (tmp_path / "claims.json").write_text(content, encoding="utf-8")
    with pytest.raises(UmbraBenchError, match=message):
        load_claims(tmp_path)


def test_a_misspelt_name_is_refused_with_the_nearest() -> None:
    with pytest.raises(UmbraBenchError, match="did you mean 'gravity-flag'"):
        measure_named(["gravity-flug"])


def test_the_format_is_told(document: dict[str, Any]) -> None:
    assert document["format"] == FORMAT

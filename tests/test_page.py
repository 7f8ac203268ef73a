"""The page in a real browser: it is driven as a reader would, and it fetches nothing."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from umbra_bench.claims.record import CURVES_SCHEMA, FORMAT, Found, save_claims
from umbra_bench.report import write_report
from umbra_bench.results import environment, save_study
from umbra_bench.scenario import load_scenario
from umbra_bench.study import run_study

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
DESK = {"width": 1280, "height": 900}
METHODS = ("semi-implicit-euler", "velocity-verlet", "umbra", "pymunk")
MARKUP = '<img src=x onerror="alert(1)"> </script> & `_*|'

STATEMENTS = [
    {
        "name": "spoilt",
        "place": MARKUP,
        "statement": MARKUP,
        "why": MARKUP,
        "verdict": "fails",
        "examines": True,
        "criteria": [],
    }
]

pytestmark = pytest.mark.xdist_group("page")  # made once: its making takes longer than a test
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a small study, one of whose scenarios has markup in its words."""
    folder = tmp_path_factory.mktemp("page")
    spring = load_scenario("spring").with_sweep(0.04, 3)
    orbit = load_scenario("orbit_circular").with_sweep(0.04, 3)
    orbit = orbit.model_copy(update={"title": MARKUP, "description": MARKUP})
    save_study(run_study([spring, orbit], METHODS), folder)
    curves = [
        {"proof": "stability", "series": "umbra, damped", "x": x, "measured": 1.0, "predicted": 1.0}
        for x in (0.5, 1.0)
    ]
    document = {
        "format": FORMAT,
        "subject": "umbra",
        "statements": STATEMENTS,
        "proofs": {},
        "environment": environment([]),
    }
    save_claims(Found(document, pl.DataFrame(curves, CURVES_SCHEMA)), folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("umbra_bench.report.FIGURES", {})
        return write_report(folder, folder / "reports")


def test_it_is_one_file_that_fetches_nothing(page_file: Path) -> None:
    text = page_file.read_text(encoding="utf-8")
    assert page_file.stat().st_size < 8e6
    ours = text.replace(
        text[text.index('<script id="plotly"') : text.index('<script id="data"')], ""
    )
    assert re.findall(r"(?:src|href)=\"(?!#|data:)[^\"]*\"", ours) == []
    assert "default-src 'none'" in ours


def test_markup_is_shown_as_text(page_file: Path) -> None:
    text = page_file.read_text(encoding="utf-8")
    assert "<img src=x" not in text
    assert "&lt;img src=x" in text


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    pytest.importorskip("playwright", reason="playwright is not installed")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def tab(browser: Any, page_file: Path) -> Iterator[Any]:
    """The page in a tab; complaints on the console and requests to the network fail the last test."""
    tab = browser.new_page(viewport=DESK)
    told: list[str] = []
    asked: list[str] = []
    tab.on(
        "console", lambda message: told.append(message.text) if message.type == "error" else None
    )
    tab.on("pageerror", lambda error: told.append(str(error)))
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto(page_file.as_uri())
    tab.wait_for_selector("#error-plot .main-svg")
    yield tab
    tab.close()
    assert told == []
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []


@pytest.fixture
def opened(tab: Any) -> Any:
    """The tab as a reader first finds it: to load the library anew for every test takes a minute."""
    tab.set_viewport_size(DESK)
    tab.emulate_media(color_scheme="light")
    tab.evaluate("location.hash = 'scenario=spring&precision=float64&quantity=position'")
    until(tab, lambda: sorted(visible(tab)) == sorted(METHODS))
    return tab


def until(tab: Any, condition: Callable[[], bool]) -> None:
    """Wait for a condition: the page forbids what the browser driver's own waiting would evaluate."""
    for _ in range(50):
        if condition():
            return
        tab.wait_for_timeout(100)
    raise AssertionError("it did not happen within 5 s")


def visible(tab: Any, plot: str = "error-plot") -> list[str]:
    """The methods that a plot shows."""
    shown: list[str] = tab.evaluate(
        f"document.getElementById('{plot}').data"
        ".filter(t => t.meta && t.visible !== 'legendonly').map(t => t.meta)"
    )
    return shown


@needs_browser
def test_choosing_scenarios_methods_and_precision(opened: Any) -> None:
    assert sorted(visible(opened)) == sorted(METHODS)
    opened.select_option("#scenario", "orbit_circular")
    assert MARKUP in opened.inner_text("#description")
    opened.uncheck("#methods input[value=umbra]")
    assert "umbra" not in visible(opened)
    assert "umbra" not in visible(opened, "energy-plot")
    opened.select_option("#precision", "float32")
    opened.select_option("#quantity", "energy")
    opened.select_option("#step", "0.02")
    rows = opened.locator("#values tbody tr").all_inner_texts()
    assert len(rows) == len(METHODS) - 1
    assert any("float64" in row for row in rows), "an engine keeps its own precision"
    assert "order of energy" in opened.inner_text("#values thead")
    assert "quantity=energy" in opened.url
    assert "hide=umbra" in opened.url


@needs_browser
def test_a_shared_address_shows_the_same_view(opened: Any, page_file: Path) -> None:
    opened.goto("about:blank")
    address = (
        "#scenario=orbit_circular&precision=float32&quantity=velocity&step=0.01&hide=pymunk,umbra"
    )
    opened.goto(page_file.as_uri() + address)
    opened.wait_for_selector("#error-plot .main-svg")
    assert opened.input_value("#scenario") == "orbit_circular"
    assert opened.input_value("#quantity") == "velocity"
    assert sorted(visible(opened)) == ["semi-implicit-euler", "velocity-verlet"]


@needs_browser
def test_an_address_of_nonsense_is_harmless(opened: Any, page_file: Path) -> None:
    opened.goto("about:blank")
    opened.goto(
        page_file.as_uri() + "#scenario=<b>&step=x&time=-7&hide=<i>,nothing&precision=float16"
    )
    opened.wait_for_selector("#error-plot .main-svg")
    assert opened.input_value("#precision") == "float64"
    assert sorted(visible(opened)) == sorted(METHODS)


@needs_browser
def test_hovering_reads_values(opened: Any) -> None:
    opened.locator("#error-plot").scroll_into_view_if_needed()
    point = opened.locator("#error-plot .scatterlayer .point").nth(1)
    box = point.bounding_box()
    opened.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    opened.wait_for_selector("#error-plot .hoverlayer .hovertext")
    assert "dt =" in opened.text_content("#error-plot .hoverlayer")


@needs_browser
def test_a_click_in_the_legend_hides_a_method_everywhere(opened: Any) -> None:
    opened.locator("#error-plot .legendtoggle").first.click()
    until(opened, lambda: not opened.locator("#methods input").first.is_checked())
    assert len(visible(opened)) == len(visible(opened, "motion-plot")) == len(METHODS) - 1


@needs_browser
def test_the_motion_plays(opened: Any) -> None:
    before = opened.inner_text("#clock")
    opened.focus("#play")
    opened.keyboard.press("Enter")
    until(opened, lambda: opened.inner_text("#clock") != before)
    opened.keyboard.press("Enter")
    assert opened.get_attribute("#play", "aria-pressed") == "false"


@needs_browser
def test_the_overview_leads_to_the_explorer(opened: Any) -> None:
    opened.click("#overview thead a >> text=orbit_circular")
    until(opened, lambda: opened.input_value("#scenario") == "orbit_circular")


@needs_browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
def test_it_is_accessible_and_fits(opened: Any, scheme: str, width: int) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    opened.emulate_media(color_scheme=scheme)
    opened.set_viewport_size({"width": width, "height": 900})
    found = axe.run(opened).response["violations"]
    serious = [v for v in found if v["impact"] in ("serious", "critical")]
    assert [(v["id"], [n["html"][:120] for n in v["nodes"]][:3]) for v in serious] == []
    assert opened.evaluate("document.documentElement.scrollWidth") <= width


@needs_browser
def test_the_stability_map_is_drawn(opened: Any) -> None:
    opened.locator("#stability-plot").scroll_into_view_if_needed()
    opened.wait_for_selector("#stability-plot .scatterlayer .trace", state="attached")
    assert "UMBRA, as published, damped" in opened.text_content("#stability-plot .legend")


@needs_browser
def test_it_prints(opened: Any, tmp_path: Path) -> None:
    opened.pdf(path=str(tmp_path / "page.pdf"))
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")

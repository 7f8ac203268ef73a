"""How numbers, methods and foreign text are written on the pages."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import jinja2

from umbra_bench.methods import METHODS


def number(value: float | None, digits: int = 2) -> str:
    """A number for people: plain where that is short, else a power of ten."""
    if value is None:
        return "–"
    if math.isnan(value):
        return "not a number"
    if math.isinf(value):
        return "infinite"
    if value == 0.0 or 1e-2 <= abs(value) < 1e4:
        return f"{value:.{digits + 1}g}"
    return f"{value:.{digits - 1}e}"


def order_text(order: float, standard_error: float, decimals: int = 2) -> str:
    """An observed order with its standard error, which is left out where it rounds to nothing."""
    error = f"{standard_error:.{decimals}f}"
    return f"{order:.{decimals}f}" + (f" ± {error}" if float(error) else "")


def method_title(method: str) -> str:
    """The method's name for people."""
    return METHODS[method].title if method in METHODS else method


def markdown_text(text: str) -> str:
    """Text that shows as it was written, whatever markup it holds."""
    for character in "\\`*_{}[]<>()#+-.!|&~$":
        text = text.replace(character, f"\\{character}")
    return " ".join(text.split())


def render(template: str, **values: Any) -> str:
    """Fill one of the Markdown templates."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        autoescape=False,  # noqa: S701  # Markdown: the filter `text` escapes what an author wrote
    )
    environment.filters.update(text=markdown_text, number=number, title_of=method_title)
    return environment.get_template(template).render(**values)

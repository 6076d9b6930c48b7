"""Setting a page as one HTML file that opens without a server and without a network."""

from __future__ import annotations

import shlex
from functools import cache
from pathlib import Path
from typing import Final

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from craftsim.experiments.bundle import TRAJECTORY
from craftsim.storage.folders import output_directory
from craftsim.storage.writing import write_whole
from craftsim.validation.html import plots
from craftsim.validation.html.film_links import Films
from craftsim.validation.html.page import Page, count, interval, percent
from craftsim.validation.html.recorded import Drawn

FILE_NAME: Final = "report.html"

MAX_CASES: Final = 24
"""Disagreements that a page, or a group of them, shows with their films; the others are listed."""


def write_html(out: Path, page: Page) -> Path:
    """Write a page as ``report.html`` into the directory ``out`` and return its path.

    The file appears whole or not at all. It loads nothing: styles, drawings and films are within it; films that
    exceed the page's budget are linked by paths relative to it. Equal pages with equal films give equal files. All
    text is escaped, and a content security policy keeps the page from running or fetching anything.

    Args:
        out: directory, made when missing; bundles of the page's cases are looked for in it.
        page: what to set.

    Raises:
        InputError: the directory cannot be written to.
    """
    path = output_directory(out) / FILE_NAME
    template = _environment().get_template(page.template)
    return write_whole(
        path, template.render(page.content, page=page, films=Films(out), drawn=Drawn(out), contents=[])
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("craftsim.validation.html", "template"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        extensions=["jinja2.ext.do"],
    )
    environment.filters.update(
        breakable=_breakable,
        css_percent=lambda share: f"{100 * share:.2f}%",
        figure=lambda value: f"{value:,.0f}" if value >= 100 else f"{value:.3f}",
        percent=percent,
        shell=shlex.quote,
        thousands="{:,}".format,
    )
    environment.globals.update(
        count=count, interval=interval, max_cases=MAX_CASES, plots=plots, trajectory_file=TRAJECTORY
    )
    return environment


def _breakable(text: str) -> Markup:
    """Return escaped text that may be broken after slashes."""
    return escape(text).replace("/", "/" + Markup("<wbr>"))

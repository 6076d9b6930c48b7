"""The directive ``public``: documents names of ``craftsim`` from their docstrings.

A page lists public names, one a line; each becomes an entry of the API reference. A name that is not public, and a
public name that no page lists, is a warning: the reference is always the whole of ``craftsim.__all__``.
"""

from __future__ import annotations

import dataclasses
import inspect
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.ext.napoleon import Config, GoogleDocstring
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

import craftsim

PUBLIC = frozenset(craftsim.__all__) - {"__version__"}

logger = logging.getLogger(__name__)


class Public(SphinxDirective):
    """Emit one autodoc directive for each name of the content."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return the documentation of the listed names."""
        lines = []
        for name in filter(None, (line.strip() for line in self.content)):
            if name in PUBLIC:
                _listed(self.env).add(name)
                lines += _autodoc(name)
            else:
                logger.warning("craftsim.%s is not public", name, location=self.get_location())
        # The page is Markdown; autodoc writes reStructuredText.
        return self.parse_text_to_nodes("\n".join(["```{eval-rst}", *lines, "```"]))


def _autodoc(name: str) -> list[str]:
    thing = getattr(craftsim, name)
    if not inspect.isclass(thing):
        return [f".. auto{'function' if callable(thing) else 'data'}:: craftsim.{name}", ""]
    members = ["   :members:"] if _has_parameters(thing) else ["   :members:", "   :undoc-members:"]
    if any(dataclasses.is_dataclass(base) for base in thing.__mro__[1:]):
        members.append("   :inherited-members: object")
    return [f".. autoclass:: craftsim.{name}", *members, ""]


def _has_parameters(kind: type) -> bool:
    """Whether a class holds the parameters of a machine, which the page on parameters lists."""
    return dataclasses.is_dataclass(kind) and any(
        "origin" in field.metadata for field in dataclasses.fields(kind)
    )


def _listed(env: BuildEnvironment) -> set[str]:
    names: set[str] = env.__dict__.setdefault("craftsim_public_names", set())
    return names


def _check_complete(app: Sphinx, env: BuildEnvironment) -> None:
    for name in sorted(PUBLIC - _listed(env)):
        logger.warning("craftsim.%s is public, but no page lists it", name)


def _convert(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Turn a docstring into reStructuredText, where it has sections; those of fields are prose already."""
    if what not in ("attribute", "data", "property"):
        lines[:] = GoogleDocstring(lines, Config(), None, what, name, thing, options).lines()


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive, the docstrings' conversion and the check that the reference is complete."""
    app.add_directive("public", Public)
    app.connect("autodoc-process-docstring", _convert)
    app.connect("env-check-consistency", _check_complete)
    return {"parallel_read_safe": False}

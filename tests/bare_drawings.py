"""Pages of commands whose drawings nobody looks at: made from their data, but not rendered.

Rendering one takes a quarter of a second. tests/validation/test_report_pages.py holds what rendered ones are.
"""

from markupsafe import Markup
from matplotlib.figure import Figure

from craftsim.reports import html

RENDERED = html._environment().filters["svg"]


def _bare(drawing):
    drawing.draw(Figure(figsize=(drawing.width_in, drawing.height_in), layout="constrained"))
    return Markup('<svg role="img"></svg>')


def bare(is_bare):
    """Leave out from now on what matplotlib would do with drawings, or render them."""
    html._environment().filters["svg"] = _bare if is_bare else RENDERED

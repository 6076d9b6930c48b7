"""Pages of commands whose drawings nobody looks at: made from their data, but not rendered.

Rendering one takes a quarter of a second. tests/validation/test_report_pages.py holds what rendered ones are.
"""

import pytest
from markupsafe import Markup
from matplotlib.figure import Figure

from craftsim.reports import html


def _bare(drawing):
    drawing.draw(Figure(figsize=(drawing.width_in, drawing.height_in), layout="constrained"))
    return Markup('<svg role="img"></svg>')


@pytest.fixture(scope="module", autouse=True)
def bare_drawings():
    """Leave out what matplotlib would do with them; a module that looks at drawings has a fixture of this name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(html._environment().filters, "svg", _bare)
        yield

"""A report in all its forms: as files in a folder, and on the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from craftsim.reports.report import Report

if TYPE_CHECKING:
    from craftsim.reports.terminal import Terminal


def publish(report: Report, out: Path | None, console: Terminal | None = None) -> int:
    """Write ``report.json`` and ``report.html`` into a folder, if given; print; return the exit status."""
    from craftsim.reports import terminal
    from craftsim.reports.html import write_html
    from craftsim.reports.json_file import write_json

    files = dict(report.files)
    if out is not None:
        if report.document is not None:
            write_json(out, report.document)
        files["Report"] = out / "report.json"
        files["Page"] = write_html(out, report)
    terminal.print_report(console or terminal.Terminal(), report, out, files)
    return report.exit_code

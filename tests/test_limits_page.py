"""docs/limits.md says what craftsim/storage/limits.py holds."""

from pathlib import Path

from craftsim.storage import limits
from craftsim.storage.limits import KIB, MIB, Limits, Range, size_text

PAGE = (Path(__file__).parents[1] / "docs" / "limits.md").read_text(encoding="utf-8")


def _row(file: Limits) -> str:
    unpacked = file.content_bytes != file.file_bytes
    cells = [size_text(file.file_bytes), size_text(file.content_bytes) if unpacked else ""]
    cells.append(size_text(file.line_bytes) if file.line_bytes else "")
    return f"| {file.what} | " + " | ".join(cells).replace("|  |", "| |").rstrip() + " |"


def test_every_file_has_its_row():
    missing = [row for row in map(_row, limits.ALL) if row not in PAGE]
    assert missing == []


def test_every_other_number_is_on_the_page():
    numbers = {
        name: str(value) if isinstance(value, Range) else f"{value:,.0f}"
        for name, value in vars(limits).items()
        if name.isupper() and isinstance(value, int | float | Range) and value not in (KIB, MIB)
    }
    numbers["PICKLE_BYTES"] = size_text(limits.PICKLE_BYTES)
    assert {name: number for name, number in numbers.items() if number not in PAGE} == {}

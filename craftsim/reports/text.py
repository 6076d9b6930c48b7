"""Escaping of control characters in untrusted text."""

from __future__ import annotations

import re
from typing import Final

_STEERING: Final = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)
"""Control characters except tab and newline, characters that change the writing direction, and surrogates."""


def escape(text: object) -> str:
    """Return a text with escapes such as ``\\x1b`` for control characters.

    Example:
        >>> escape("red: \\x1b[31m")
        'red: \\\\x1b[31m'
    """
    return _STEERING.sub(lambda match: match[0].encode("unicode_escape").decode(), str(text))

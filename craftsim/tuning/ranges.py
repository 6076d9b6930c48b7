"""Ranges of options of identification.

Help and tab completion import this, so it imports nothing heavy.
"""

from typing import Final

from craftsim.storage.limits import Range

EXCITE_S: Final = Range(10, 3600)
"""Duration of an identification drive."""
EXCITE_M: Final = Range(0.6, 20)
"""Length and width of the area of an identification drive."""

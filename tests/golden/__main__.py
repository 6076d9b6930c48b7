"""``python -m golden``, with ``tests`` on the path."""

import sys

from .golden import main

sys.exit(main())

"""``python -m craftsim``: the command line where the script ``craftsim`` is not at hand."""

import sys

from craftsim.cli import main

if __name__ == "__main__":
    sys.exit(main())

"""``python -m craftsim``: the command line where the script ``craftsim`` is not at hand."""

import sys

from craftsim.workers.modules import leave_out_working_folder

if __name__ == "__main__":
    leave_out_working_folder()

from craftsim.cli import main

if __name__ == "__main__":
    sys.exit(main())

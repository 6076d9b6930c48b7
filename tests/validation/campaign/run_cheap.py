"""A campaign of slow cheap items in a process of its own, to be killed: run_cheap.py OUT [--resume]."""

import sys
from pathlib import Path

import cheap_work

from craftsim.cli import main
from craftsim.validation.campaign import Header, run_campaign


def cheap(resume: bool = False) -> int:
    """Run the campaign as a command would."""
    items = cheap_work.items(40, **{f"i{i}": "slow" for i in range(40)})
    run_campaign(items, cheap_work.work, OUT, Header("cheap", 0, {}), workers=2, batch=3, resume=resume)
    return 0


if __name__ == "__main__":
    import craftsim.cli

    OUT = Path(sys.argv[1])
    sys.modules["craftsim.commands.cheap"] = sys.modules["__main__"]
    craftsim.cli.COMMANDS["cheap"] = "Test."
    sys.exit(main(["cheap", *sys.argv[2:]]))

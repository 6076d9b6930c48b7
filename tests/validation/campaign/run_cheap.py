"""Cheap slow work in a process of its own, to be killed: run_cheap.py OUT cheap|after [--resume]."""

import sys
from pathlib import Path

import cheap_work

from craftsim.cli import main
from craftsim.validation.campaign import Header, do_all, run_campaign

ITEMS = cheap_work.items(40, **{f"i{i}": "slow" for i in range(40)})


def cheap(resume: bool = False) -> int:
    """Run the campaign as a command would."""
    run_campaign(ITEMS, cheap_work.work, OUT, Header("cheap", 0, {}), workers=2, batch=3, resume=resume)
    return 0


def after(resume: bool = False) -> int:
    """Do what a finished campaign still needs; each item leaves a file."""
    items = [cheap_work.left_in(OUT, item) for item in ITEMS]
    do_all(items, cheap_work.leave, OUT, "leaving files", workers=2)
    return 0


if __name__ == "__main__":
    import craftsim.cli

    OUT, NAME = Path(sys.argv[1]), sys.argv[2]
    sys.modules[f"craftsim.commands.{NAME}"] = sys.modules["__main__"]
    craftsim.cli.COMMANDS[NAME] = "Test."
    sys.exit(main([NAME, *sys.argv[3:]]))

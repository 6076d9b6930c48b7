"""The command line on a report's page asks for the same again."""

import shlex

import pytest

from craftsim.cli.app import ASKED, bind, command_again

EVERYTHING = {
    "validate": "'a world.yaml' strip --plan a.plan --actions b.txt --policy play random --order ticks --cars 3 "
    "--blocks 4 --max-steps 20 --timeout 12.5 --video all --skills mine:SKILLS --noise n.yaml --assume mild "
    "--gains g.yaml --machines p.yaml --drive reduced --rules published --randomize strong --seed 7 --trials 3 "
    "--baseline old --record trajectory --minimize",
    "audit": "--actions MOVE LIFT --situations '*room=tight' --only legal --quick --rules physical --video",
    "train": "strip --set width=3 'settings=a file.yaml'",
}
ELSEWHERE = ["--resume", "--workers", "2", "--engine=ray", "--out", "some where"]
"""Options that decide no results."""


@pytest.mark.parametrize("command", EVERYTHING)
@pytest.mark.parametrize("before", [True, False])
def test_a_command_line_asks_for_the_same_again_whatever_was_asked(command, before):
    words = shlex.split(EVERYTHING[command])
    elsewhere = [*ELSEWHERE, "--seed", "3"] if before and "--seed" not in words else ELSEWHERE
    given = (
        [command, *elsewhere, *words] if words[0][:2] == "--" and before else [command, *words, *elsewhere]
    )
    ASKED.set(tuple(given))
    kept = [word for word in given if word not in ELSEWHERE]
    assert shlex.split(command_again()) == ["craftsim", *kept]
    if command == "validate":
        assert bind(kept)[1].arguments == bind([command, *words])[1].arguments

"""Options that commands share: the same names, the same meaning, and defaults that differ for a stated reason alone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from craftsim.discrete.actions import verbs
from craftsim.discrete.rules import RuleSet
from craftsim.mjcf.parameters import Drive
from craftsim.storage.limits import SEED, TRIAL_COUNT, WORKERS

if TYPE_CHECKING:
    from craftsim.checking.setup import Setup
    from craftsim.experiments.experiment import Progress, RunOptions

    Verb = str
else:
    Verb = Literal[verbs()]

Dir = Annotated[Path, tyro.conf.arg(metavar="DIR")]
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")]
Preset = Annotated[
    str, tyro.conf.arg(metavar="{none,mild,strong,lab_floor,workshop_floor}|FILE", help_behavior_hint="")
]
Engine = Literal["local", "ray"]


@dataclass(frozen=True)
class PhysicsOptions:
    """What decides a world in physics besides its start."""

    rules: RuleSet = "physical"
    """The rule set that predicts: CraftEnv's own, or the one that physics supports."""
    randomize: Preset = "mild"
    """What is drawn of physics, floor, machines, motors and sensors; sets the limits of the errors, too."""
    noise: File = None
    """YAML file of the sensors' and motors' noise; figures that it leaves out are those of --randomize."""
    assume: Annotated[
        str | None, tyro.conf.arg(metavar="{none,mild,strong,...}|FILE", help_behavior_hint="")
    ] = None
    """What the cars take that noise to be before they find out, whatever it is; with none they take each measured pose
    as it is. A figure that a file leaves out is that which they assume without this option."""
    gains: Annotated[str | None, tyro.conf.arg(metavar="{robust,fast}|FILE", help_behavior_hint="")] = None
    """Gains of the skills: a preset, or a YAML file; robust unless given, as is what a file leaves out."""
    parameters: File = None
    """YAML file of machine parameters: masses, friction, torques, speeds, lengths."""
    drive: Drive = "rollers"
    """How cars touch the ground: by forty free rollers, or reduced to one body, which is several times as fast."""
    skills: Annotated[str | None, tyro.conf.arg(metavar="MODULE:NAME", help_behavior_hint="")] = None
    """Skills of your own in place of built-in ones: a mapping from actions, or from cars to such mappings."""
    seed: Annotated[int, SEED] = 0
    """Decides all that is drawn."""

    def setup(self) -> Setup:
        """Return the configuration of the physics; raise InputError for a file that says what it should not."""
        from craftsim.checking.setup import setup_of

        return setup_of(
            *(self.randomize, self.rules, self.gains, self.parameters, self.noise, self.assume, self.drive),
            skills=self.skills,
        )


@dataclass(frozen=True)
class CampaignOptions(PhysicsOptions):
    """How many trials are run, where, and what becomes of them."""

    trials: Annotated[int, TRIAL_COUNT] = 10
    """How many of each."""
    workers: Annotated[int, WORKERS] = 1
    """Processes to share the work; results do not depend on it."""
    engine: Engine = "local"
    """Processes of this machine, or an existing Ray cluster to which the output folder is shared."""
    against: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder of an earlier run under other settings, to compare trial by trial."""
    resume: bool = False
    """Go on with what an interrupted run has left in the output folder."""

    def run(self, progress: Progress) -> RunOptions:
        """Return how an experiment is run, and what shows how far it is."""
        from craftsim.experiments.experiment import RunOptions

        return RunOptions(self.workers, self.engine, self.resume, self.against, progress)

"""Running skills of many cars in lock-step on one Site."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from craftsim.discrete.actions import Action
from craftsim.models.sensing import measure
from craftsim.models.site import Site
from craftsim.skills.driving import Terrain
from craftsim.skills.gains import Gains, load_gains
from craftsim.skills.library import make_skill
from craftsim.skills.outcome import Outcome
from craftsim.skills.skill import Command

Observer = Callable[[Site], None]


class Executor:
    """Performs actions on a Site: all given cars start together and run until each skill has ended."""

    def __init__(self, site: Site, gains: Gains | None = None, observer: Observer | None = None) -> None:
        """Run on a Site with these gains; ``observer`` is called after every control period."""
        self.site = site
        self.gains = gains or load_gains()
        self.observer = observer

    def run(
        self, actions: Mapping[int, Action], terrain: Mapping[int, Terrain] | None = None
    ) -> dict[int, Outcome]:
        """Perform one action for each given car, and return the outcomes by car; other cars are left at rest.

        ``terrain`` gives the ground of the moves that are not on the flat, by car.
        """
        site, period = self.site, self.site.config.control_period_s
        skills = {
            car: make_skill(action, self.gains, period, (terrain or {}).get(car))
            for car, action in actions.items()
        }
        for car, skill in skills.items():
            skill.start(measure(site, car))
        outcomes: dict[int, Outcome] = {}
        while len(outcomes) < len(skills):
            for car, skill in skills.items():
                if car in outcomes:
                    continue
                now = measure(site, car)
                self._apply(car, skill.step(now), now.slope)
                if skill.outcome is not None:
                    outcomes[car] = skill.outcome
            site.advance()
            if self.observer is not None:
                self.observer(site)
        return outcomes

    def _apply(self, car: int, command: Command, slope: int | None) -> None:
        self.site.drive(car, command.wheels)
        self.site.move_board(car, command.board)
        if slope is not None:
            self.site.turn_hinge(slope, command.hinge)

"""The drawings of a tuning's page."""

from __future__ import annotations

import math

from markupsafe import Markup

from craftsim.tuning.gains.objectives import OBJECTIVES
from craftsim.tuning.gains.tune import Tuned
from craftsim.tuning.gains.writing import convergence
from craftsim.validation.html.svg import ACCENT, BAD, GOOD, MUTED, SOFT, canvas

_WIDTH_IN = 6.6


def converging(tuned: Tuned) -> Markup:
    """Draw what each candidate cost, and the best so far, as factors of the start."""
    weights = tuned.goal.weights
    start = tuned.searched[0].score.log_cost(weights)
    each = [math.exp(one.score.log_cost(weights) - start) for one in tuned.searched]
    best = convergence(tuned)
    with canvas(_WIDTH_IN, 2.9, "convergence of the search") as drawing:
        axes = drawing.axes
        top = max(1.2, 2 - min(best))
        axes.plot(
            range(len(each)), [min(one, top) for one in each], ".", color=MUTED, ms=3, label="candidate"
        )
        axes.step(range(len(best)), best, where="post", color=ACCENT, lw=1.8, label="best so far")
        axes.axhline(1.0, color=SOFT, lw=0.8)
        axes.set_ylim(min(best) - 0.05, top + 0.02)
        axes.set_xlabel("candidates")
        axes.set_ylabel("product, start = 1")
        axes.legend(loc="upper right")
    return drawing.svg


def front(tuned: Tuned) -> Markup:
    """Draw the first two objectives of all candidates, and of the finalists on fresh seeds."""
    first, second = tuned.goal.objectives[:2]
    good = [one.score.values for one in tuned.searched if not one.score.failed]
    finals = [one.score.values for one in tuned.finalists]
    ordered = sorted((values[first], values[second]) for values in finals)
    with canvas(_WIDTH_IN, 3.4, f"front of {first} and {second}") as drawing:
        axes = drawing.axes
        axes.plot(
            [v[first] for v in good], [v[second] for v in good], ".", color=MUTED, ms=3, label="candidate"
        )
        axes.plot(*zip(*ordered, strict=True), "o-", color=ACCENT, ms=5, lw=1, label="front, fresh seeds")
        axes.plot(finals[0][first], finals[0][second], "D", color=GOOD, ms=8, label="chosen")
        axes.set_xlabel(OBJECTIVES[first])
        axes.set_ylabel(OBJECTIVES[second])
        axes.legend(loc="upper right")
    return drawing.svg


def sensitivity(tuned: Tuned) -> Markup:
    """Draw by how many per cent turning each gain down or up changes the product."""
    effects = [tuned.sensitivity[knob.name] for knob in tuned.knobs]
    with canvas(_WIDTH_IN, 0.75 + 0.27 * len(effects), "sensitivity of each gain") as drawing:
        axes = drawing.axes
        for y, effect in enumerate(effects):
            for value, offset, colour in ((effect.down, -0.16, SOFT), (effect.up, 0.16, ACCENT)):
                # A failure costs far more than all else that is drawn.
                axes.barh(
                    y + offset, min(100 * (value - 1), 20.0), height=0.3, color=colour if value < 1.2 else BAD
                )
        axes.set_yticks(range(len(effects)), [knob.name for knob in tuned.knobs])
        axes.invert_yaxis()
        axes.set_xlabel("change of the product in %: grey turned down, coloured turned up")
    return drawing.svg

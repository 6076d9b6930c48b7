"""Does my plan work in physics? Run it five times under mildly randomized physics and look at every action.

The same from a shell:  craftsim validate my_site.yaml --plan my_site.plan --randomize mild --trials 5
"""

from pathlib import Path

import craftsim

HERE = Path(__file__).parent

result = craftsim.validate(
    HERE / "my_site.yaml",
    plan=HERE / "my_site.plan",
    randomize="mild",
    trials=5,
    seed=1,
)
print(result)

actions = result.to_frame()  # one row for each action of each trial, as a pandas DataFrame
errors = actions.groupby("action")[["car_error_m", "heading_error_rad", "placed_error_m"]].max()
print("largest errors in mm and mrad:", (1e3 * errors).round(2), sep="\n")

assert result.agrees, "physics and rules disagree"

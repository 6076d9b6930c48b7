"""Tasks with other numbers of cars than the paper's."""

from craftsim.discrete.files.blueprint import parse_blueprint
from craftsim.tasks import Task
from craftsim.tasks.rewards import Reward

LAYOUT = """
area_length: {length}
area_width: 4
area_height: 3
block_num: 3
slope_num: 1
smartcar_num: {cars}
block: [{{id: 0, x: 0, y: 0, z: 1}}, {{id: 1, x: 1, y: 3, z: 1}}, {{id: 2, x: 2, y: 0, z: 1}}]
fold_slope: [{{id: 0, x: 2, y: 2, z: 1, yaw: 3}}]
smartcar:
{listed}
"""


def platform(cars: int) -> Task:
    """Return a small task for a number of cars from 1 to 8."""
    # Car 0 starts below a block and car 1 below the slope, so that both can lift at once.
    cells = [(0, 0), (2, 2), (3, 3), (4, 0), (4, 1), (4, 3), (5, 2), (5, 3)]
    listed = "\n".join(
        f"  - {{id: {car}, x: {x}, y: {y}, z: 1, yaw: 1}}"
        for car, (x, y) in enumerate(cells[:cars])
    )
    layout = LAYOUT.format(length=4 if cars < 4 else 6, cars=cars, listed=listed)
    return Task(
        "platform",
        (parse_blueprint(layout, "platform"),),
        Reward({"platform": 1.0}),
        "one_platform",
        max_steps=8,
    )

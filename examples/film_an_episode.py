"""Film an episode: the cars of a physics environment play the shipped plan of the strip into out/strip.mp4."""

from pathlib import Path

import craftsim
from craftsim.rendering.encode import VideoWriter

path = Path("out/strip.mp4")
path.parent.mkdir(parents=True, exist_ok=True)

env = craftsim.parallel_env(
    "strip", "physics", render_mode="rgb_array_list", render_size=(320, 240)
)
env.reset(seed=0)
plan = craftsim.read_plan("strip", n_cars=2)

with VideoWriter(path, fps=env.metadata["render_fps"]) as film:
    for tick in plan.ticks:
        actions = dict.fromkeys(env.agents, int(craftsim.Action.STOP))
        actions |= {f"car_{car}": int(action) for car, action in tick}
        *_, infos = env.step(actions)
        for picture in env.render():  # the pictures of the motion since the last call
            film.write(picture)
        if not env.agents:
            break
env.close()
print(f"{film.frames} pictures in {path}; built: {infos['car_0']['success']}")

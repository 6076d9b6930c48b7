"""The builders' protocol as a server of OpenEnv: 30 designs, texts to and fro, a file of results.

    CRAFTSIM_RESULTS=results.jsonl python -m server.app --port 8000

A reset takes ``design`` (0 to 29), ``backend`` ("physics" or "grid"), ``seed`` and ``builder``, the name under which a
finished episode is added to the file of results. A reset before an episode's end drops it. The reward is 1 for the turn
in which the design stands, and 0 before.
"""

import argparse
import os

import check_results
import uvicorn
from models import Answer, Building, Text
from openenv.core.env_server.http_server import create_app
from openenv.core.env_server.interfaces import Environment

import craftsim
from craftsim.envs.text_designs import design_world, score


class Builders(Environment):
    """One session: a design at a time."""

    SUPPORTS_CONCURRENT_SESSIONS = True

    def __init__(self):
        super().__init__()
        self._env = None
        self._building = Building()

    def reset(self, seed=None, episode_id=None, design=0, backend="physics", builder="", **options):
        """Begin the episode of a design. Raises ValueError for one that there is not."""
        if not 0 <= design < len(check_results.DESIGNS):
            raise ValueError(f"design is {design}; allowed: 0 to {len(check_results.DESIGNS) - 1}")
        self.close()
        difficulty, row = check_results.DESIGNS[design]
        self._env = design_world(row, backend)
        self._run = {"builder": builder, "design": design, "backend": backend, "seed": seed or 0}
        self._turns = []
        text, _ = self._env.reset(seed=self._run["seed"])
        self._building = Building(
            episode_id=episode_id,
            design=design,
            difficulty=difficulty,
            turns_left=self._env.core.task.max_steps + 2,
        )
        return Text(text=text, instructions=self._env.instructions)

    def step(self, action: Answer, timeout_s=None, **options):
        """Let the cars do what an answer says; one that cannot be read costs the turn."""
        exchange, text, _, is_over, info = self._env.turn(action.text)
        self._turns.append(exchange)
        building = self._building
        building.step_count += 1
        building.turns_left -= 1
        if is_over:
            building.score = score(self._env, self._turns, info["success"])
            self._add_result(building.score)
        return Text(text=text, reward=float(info["success"]), done=is_over)

    def _add_result(self, figures):
        path = os.environ.get("CRAFTSIM_RESULTS")
        if path and self._run["builder"]:
            answers = [turn.answer for turn in self._turns]
            version = {"craftsim": craftsim.__version__}
            check_results.add(path, self._run | figures | version | {"answers": answers})

    @property
    def state(self):
        """The episode as it is."""
        return self._building

    def close(self):
        """End the episode."""
        if self._env is not None:
            self._env.close()
        self._env = None


app = create_app(Builders, Answer, Text, env_name="craftsim_builders", max_concurrent_envs=8)


def main():
    """Serve on the loopback address unless another is given."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=8000)
    chosen = parser.parse_args()
    uvicorn.run(app, host=chosen.host, port=chosen.port)


if __name__ == "__main__":
    main()

"""A client for the server, with OpenEnv's own."""

from models import Answer, Building, Text
from openenv.core.client_types import StepResult
from openenv.core.env_client import EnvClient


class BuildersClient(EnvClient[Answer, Text, Building]):
    """Talks to one session of the server.

    with BuildersClient(base_url="http://localhost:8000").sync() as env:
        result = env.reset(design=0, builder="mine")
        while not result.done:
            result = env.step(Answer(text=ask(result.observation.text)))
        print(env.state().score)
    """

    def _step_payload(self, action):
        return {"text": action.text}

    def _parse_result(self, payload):
        seen = Text(**payload["observation"], reward=payload["reward"], done=payload["done"])
        return StepResult(observation=seen, reward=seen.reward, done=seen.done)

    def _parse_state(self, payload):
        return Building(**payload)

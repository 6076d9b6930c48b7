"""What is sent to the server of the builders' protocol, and what it returns."""

from openenv.core.env_server.types import Action, Observation, State
from pydantic import Field


class Answer(Action):
    """What the cars do next, in words."""

    text: str = Field(description="such as 'car_0: move right; car_1: stop'")


class Text(Observation):
    """The world in words."""

    text: str = Field(default="", description="what happened, the world, and the legal actions")
    instructions: str = Field(default="", description="what a builder must know, after a reset")


class Building(State):
    """The episode."""

    design: int = Field(default=0, description="number of the design, from 0 to 29")
    difficulty: str = Field(default="", description="one level, with a ramp, or two levels")
    turns_left: int = Field(default=0, description="turns until the episode ends")
    score: dict = Field(default_factory=dict, description="once it has ended, as in results.jsonl")

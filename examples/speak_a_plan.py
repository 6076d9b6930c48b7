"""Build in words: whoever reads the world answers what the cars do, as a language model would; here the planner."""

from craftsim.envs.answers import answer_text
from craftsim.envs.planner import PlannerPolicy
from craftsim.envs.text import TextConstruction
from craftsim.errors import InputError

env = TextConstruction("strip", backend="physics")
agents = [f"car_{car}" for car in range(env.core.n_cars)]
policy = PlannerPolicy(env)


def answer(instructions, text):
    """Return what to do; a language model would be handed both texts."""
    return answer_text(policy(dict.fromkeys(agents)))


text, info = env.reset(seed=0)
print(env.instructions, text, sep="\n\n", end="\n\n")
over = False
while not over:
    said = answer(env.instructions, text)
    print(said)
    try:
        text, reward, terminated, truncated, info = env.step(said)
    except InputError as error:  # nothing has happened; the message says what to answer instead
        text = str(error)
        continue
    over = terminated or truncated
    for feedback in info["feedback"]:
        if not feedback.done:
            print(feedback)
env.close()
print("built:", info["success"])

"""Build in words: whoever reads the world answers what the cars do, as a language model would; here the planner."""

from craftsim.envs.planner import PlannerPolicy
from craftsim.envs.text import TextConstruction, answer_text, converse

env = TextConstruction("strip", backend="physics")
agents = [f"car_{car}" for car in range(env.core.n_cars)]
policy = PlannerPolicy(env)


def answer(instructions, text):
    """Return what to do; a language model would be handed both texts."""
    return answer_text(policy(dict.fromkeys(agents)))


print(env.instructions)
talk = converse(env, answer, seed=0)
for turn in talk.turns:
    print(turn.answer, *(f"  {one}" for one in turn.feedback if not one.done), sep="\n")
print(
    f"built: {talk.success} in {len(talk.turns)} ticks, {talk.duration_s:.0f} s of simulated time"
)
print(f"unreadable {talk.unreadable}, forbidden {talk.forbidden}, failed {talk.failed}")
env.close()

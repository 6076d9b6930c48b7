"""A rollout of TorchRL around the PettingZoo form, with masked actions."""

from tensordict.nn import InteractionType, TensorDictModule
from torchrl.envs import PettingZooWrapper
from torchrl.envs.utils import MarlGroupMapType
from torchrl.modules import MaskedCategorical, MultiAgentMLP, ProbabilisticActor

from craftsim.envs import parallel_env

env = PettingZooWrapper(
    parallel_env("strip", "grid"),
    group_map=MarlGroupMapType.ALL_IN_ONE_GROUP,
    categorical_actions=True,
)
seen = ("agents", "observation", "observation")
n_cars, length = env.observation_spec[seen].shape
net = MultiAgentMLP(length, 15, n_cars, centralized=False, share_params=True, num_cells=[64])
actor = ProbabilisticActor(
    TensorDictModule(
        lambda observed: net(observed.float()), in_keys=[seen], out_keys=[("agents", "logits")]
    ),
    in_keys={"logits": ("agents", "logits"), "mask": ("agents", "action_mask")},
    out_keys=[("agents", "action")],
    distribution_class=MaskedCategorical,
    default_interaction_type=InteractionType.RANDOM,
    return_log_prob=True,
)
played = env.rollout(20, actor)  # what TorchRL's losses and collectors take
chosen = played["agents", "action"].unsqueeze(-1)
assert played["agents", "action_mask"].gather(-1, chosen).all()

"""The algorithms' losses, returns and first values against formulas, known answers, and another implementation."""

from dataclasses import replace
from itertools import product

import pytest
import torch
from torch import nn

from craftsim.learning.config import TrainConfig, protocol
from craftsim.learning.features import Features
from craftsim.learning.learner import learner_class
from craftsim.learning.networks import JointNet, OthersNet, QMixer
from craftsim.learning.policy_gradient import COMALearner, advantages, counterfactual
from craftsim.learning.q_learning import VDNLearner
from craftsim.learning.rollouts import Rollout, lambda_returns
from craftsim.learning.settings import COMASettings, QSettings
from craftsim.learning.shape import Shape
from craftsim.learning.trainer import Trainer

PAYOFF = torch.tensor([[8.0, -12.0, -12.0], [-12.0, 0.0, 0.0], [-12.0, 0.0, 0.0]])
"""Son et al., table 1a: the best joint action is the first of both."""

SHAPE = Shape((3, 3, 2), 2, 13 * 3, 64)


def _greedy(algo, seed):
    """Return the joint action that is best by the cars' values, all joint actions having been seen alike often."""
    torch.manual_seed(seed)
    learner = learner_class(algo)(SHAPE, 1, QSettings(learning_rate=0.01))
    learner.net.encoder.car.data.normal_()  # what tells the cars apart
    actions = torch.cartesian_prod(torch.arange(3), torch.arange(3))
    offers = torch.zeros(1, 9, 2, 15, dtype=torch.bool)
    offers[..., :3] = True
    seen = Features(torch.full((1, 9, 2, 3), learner.net.encoder.absent, dtype=torch.int32), offers)
    ends = torch.ones(1, 9, dtype=torch.bool)
    batch = Rollout(
        seen, seen, actions[None], PAYOFF[actions[:, 0], actions[:, 1]][None], ends, ends
    )
    for _ in range(300):
        learner.minimize(learner.loss(batch))
    return tuple(learner.net(seen)[0, 0].argmax(-1).tolist())


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("algo", "finds"), [("vdn", False), ("qmix", False), ("qtran", True)])
def test_only_qtran_finds_the_best_joint_action_where_it_does_not_pay_alone(algo, finds, seed):
    assert (_greedy(algo, seed) == (0, 0)) is finds


def test_the_joint_value_of_qtran_tells_which_car_does_what():
    """The car in the one place has to act, whichever it is: what cars see, added up, is the same in both cases."""
    torch.manual_seed(0)
    joint = JointNet(SHAPE)
    places = torch.tensor([[0, 1], [1, 0]], dtype=torch.int32).repeat_interleave(2, 0).unsqueeze(-1)
    seen = Features(places, torch.ones(4, 2, 15, dtype=torch.bool))
    actions = torch.tensor([[1, 0], [0, 1]]).repeat(2, 1)  # which car acts
    pays = torch.tensor([1.0, 0.0, 0.0, 1.0])
    optimizer = torch.optim.Adam(joint.parameters(), 1e-3)
    for _ in range(200):
        error = (joint(joint.state(seen), actions)[0] - pays).square().mean()
        optimizer.zero_grad()
        error.backward()
        optimizer.step()
    assert error < 0.01


def test_the_gradient_of_coma_is_that_of_its_formula():
    torch.manual_seed(1)
    n, n_actions, ticks = 2, 4, 5
    logits = torch.randn(n, n_actions, requires_grad=True)
    values, action = torch.randn(n, n_actions), torch.randint(n_actions, (ticks, n))
    every = (table.expand(ticks, n, n_actions) for table in (logits, values))
    gain, entropy = counterfactual(*every, action)
    gain.mean().backward()
    policy = logits.detach().softmax(-1)
    expected = torch.zeros(n, n_actions)
    for did in action:
        for car, own in enumerate(did):
            advantage = values[car, own] - policy[car] @ values[car]
            score = nn.functional.one_hot(own, n_actions) - policy[car]  # the gradient of log pi
            expected[car] += advantage * score / (ticks * n)
    assert torch.allclose(logits.grad, expected, atol=1e-6)
    assert torch.allclose(entropy[0], torch.distributions.Categorical(policy).entropy())


def _coma_of_tables(gamma, decay):
    """Return COMA whose critic gives 10 for each unit of the first place and 1 for each of the action's number.

    Its policy takes action 3 wherever there is something at place 9, else action 0.
    """
    learner = COMALearner(SHAPE, 3, COMASettings(gamma=gamma, td_lambda=decay))

    def policy(seen):
        logits = torch.full(seen.offers.shape, -torch.inf)
        takes_3 = seen.places[..., 0] == 9
        logits[..., 0][~takes_3] = 0.0
        logits[..., 3][takes_3] = 0.0
        return logits

    def critic(seen, actions):
        return 10.0 * seen.places[..., :1] + torch.arange(15.0)

    learner.net = policy
    learner.target = critic
    return learner


def _seen_at(places):
    """Return observations (T, B, 2) with these first places (T, B), the same for both cars."""
    column = torch.tensor(places, dtype=torch.int32)
    return Features(
        column[..., None, None].expand(*column.shape, 2, 3), torch.ones(*column.shape, 2, 15) > 0
    )


def test_coma_goes_on_after_a_cut_with_the_value_of_what_follows():
    """Computed by hand: the last tick of a rollout, a completed episode, and one that ran out of time."""
    gamma, decay = 0.5, 0.25
    now = _seen_at([[1, 1, 1], [2, 2, 2], [3, 3, 3]])
    after = _seen_at([[2, 7, 9], [3, 3, 3], [9, 4, 4]])
    actions = torch.tensor([[1, 1, 1], [2, 2, 2], [0, 0, 0]]).unsqueeze(-1).expand(3, 3, 2)
    rewards = torch.tensor([[1.0, 1, 1], [2.0, 2, 2], [4.0, 4, 4]])
    # World 0 is cut, world 1 is completed in the first tick, world 2 runs out of time in the first tick.
    done = torch.tensor([[False, True, True], [False, False, False], [False, False, False]])
    terminated = torch.tensor([[False, True, False], [False, False, False], [False, False, False]])
    rollout = Rollout(now, after, actions, rewards, terminated, done)
    returns = _coma_of_tables(gamma, decay).returns(rollout)
    # After the cut the policy takes 3 at place 9, valued 93, and 0 at place 4, valued 40.
    cut_at_9 = 4 + gamma * 93
    cut_at_4 = 4 + gamma * 40
    # Action 0 at place 3 is valued 30, action 2 at place 2 is valued 22.
    middle_of_0 = 2 + gamma * ((1 - decay) * 30 + decay * cut_at_9)
    middle_of_others = 2 + gamma * ((1 - decay) * 30 + decay * cut_at_4)
    first_of_0 = 1 + gamma * ((1 - decay) * 22 + decay * middle_of_0)
    expected = torch.tensor(
        [
            [first_of_0, 1.0, 1 + gamma * 93],
            [middle_of_0, middle_of_others, middle_of_others],
            [cut_at_9, cut_at_4, cut_at_4],
        ]
    )
    assert torch.allclose(returns, expected.unsqueeze(-1).expand(3, 3, 2))


def _rollout(ticks=12, worlds=7):
    generator = torch.Generator().manual_seed(3)
    done = torch.rand(ticks, worlds, generator=generator) < 0.3
    terminated = done & (torch.rand(ticks, worlds, generator=generator) < 0.5)
    rewards = torch.randn(ticks, worlds, generator=generator)
    now, after = torch.randn(2, ticks, worlds, 1, generator=generator)
    return Rollout(None, None, None, rewards, terminated, done), now, after


def test_advantages_of_cars_that_decide_one_by_one_are_those_of_their_own_decisions():
    """Each car's decisions are a trajectory of its own, with the rewards and the time between two of them."""
    generator, gamma, decay = torch.Generator().manual_seed(4), 0.9, 0.8
    rollout, _, _ = _rollout()
    now, after = torch.randn(2, 12, 7, 3, generator=generator)
    decides = torch.rand(12, 7, 3, generator=generator) < 0.5
    elapsed = torch.rand(12, 7, generator=generator) * 2
    found = advantages(replace(rollout, decides=decides, elapsed=elapsed), now, after, gamma, decay)
    for world, car in product(range(7), range(3)):
        ahead = 0.0
        for t in reversed(decides[:, world, car].nonzero()[:, 0].tolist()):
            earned, factor, value = 0.0, 1.0, None
            for u in range(t, 12):
                earned += factor * rollout.rewards[u, world].item()
                factor *= gamma ** elapsed[u, world].item()
                if rollout.done[u, world] or u == 11 or decides[u + 1, world, car]:
                    break
            over = bool(rollout.done[u, world])
            if over or u == 11:
                value, ahead = after[u, world, car].item() * (not rollout.terminated[u, world]), 0.0
            else:
                value = now[u + 1, world, car].item()
            ahead = earned + factor * value - now[t, world, car].item() + factor * decay * ahead
            assert found[t, world, car].item() == pytest.approx(ahead, abs=1e-4)


def test_where_all_decide_at_every_tick_both_forms_of_advantages_are_one():
    rollout, now, after = _rollout()
    after = torch.where(rollout.done.unsqueeze(-1), after, now.roll(-1, 0))
    every = replace(
        rollout, decides=torch.ones(12, 7, 1, dtype=torch.bool), elapsed=torch.ones(12, 7)
    )
    both = (advantages(one, now, after, 0.9, 0.8) for one in (rollout, every))
    assert torch.allclose(*both, atol=1e-5)


def _as_theirs(column):
    """Return (T, B) or (T, B, 1) as (B, T, 1)."""
    return column.reshape(*column.shape[:2], 1).transpose(0, 1).contiguous()


def test_advantages_and_returns_are_those_of_torchrl():
    functional = pytest.importorskip("torchrl.objectives.value.functional")
    rollout, now, after = _rollout()
    rest = [_as_theirs(column) for column in (rollout.rewards, rollout.done, rollout.terminated)]
    theirs, _ = functional.generalized_advantage_estimate(
        0.9, 0.8, _as_theirs(now), _as_theirs(after), *rest
    )
    assert torch.allclose(_as_theirs(advantages(rollout, now, after, 0.9, 0.8)), theirs, atol=1e-5)
    theirs = functional.td_lambda_return_estimate(0.9, 0.8, _as_theirs(after), *rest)
    assert torch.allclose(
        _as_theirs(lambda_returns(rollout, after[..., 0], 0.9, 0.8)), theirs, atol=1e-5
    )


def test_the_mixer_is_torchrl_s_with_the_same_weights():
    multiagent = pytest.importorskip("torchrl.modules.models.multiagent")
    torch.manual_seed(0)
    ours, theirs = QMixer(SHAPE), multiagent.QMixer((SHAPE.width,), 32, SHAPE.n_cars, "cpu")
    pairs = {"first_weight": "hyper_w_1", "first_bias": "hyper_b_1", "last_weight": "hyper_w_final"}
    for own, other in pairs.items():
        getattr(theirs, other).load_state_dict(getattr(ours, own).state_dict())
    theirs.V.load_state_dict(ours.last_bias.state_dict())
    chosen, state = torch.randn(20, SHAPE.n_cars), torch.randn(20, SHAPE.width)
    with torch.no_grad():
        assert torch.allclose(
            ours.mix(chosen, state), theirs(chosen.unsqueeze(-1), state)[..., 0], atol=1e-5
        )


def test_values_of_q_learning_are_those_of_its_formula():
    """Double Q-learning with the team's reward: one network chooses what another one values."""
    torch.manual_seed(2)
    learner = VDNLearner(SHAPE, 1, QSettings(gamma=0.9, td_lambda=0.0))
    nn.init.normal_(learner.target_net.head[1][2].weight)
    nn.init.normal_(learner.net.head[1][2].weight)
    places = torch.randint(learner.net.encoder.absent, (6, 2, 2, 3), dtype=torch.int32)
    offers = torch.rand(6, 2, 2, 15) < 0.5
    offers[..., 0] = True
    now, after = (Features(places[:, i], offers[:, i]) for i in range(2))
    actions, ends = torch.zeros(6, 2, dtype=torch.int64), torch.arange(6) < 2
    columns = (column[None] for column in (now, after, actions, torch.arange(6.0), ends, ends))
    batch = Rollout(*columns)
    expected = 0.0
    for i in range(6):
        follows = sum(
            learner.target_net(after)[i, car, learner.net(after)[i, car].argmax()]
            for car in range(2)
        )
        target = i + (0.0 if ends[i] else 0.9 * follows)
        expected += (target - learner.net(now)[i, :, 0].sum()) ** 2 / 6
    assert float(learner.loss(batch)) == pytest.approx(float(expected), rel=1e-5)


def _gates(cell, seen, before):
    """Return the next state of a GRU, by the formula of Cho et al. (2014) with torch's order of the gates."""
    of_seen = (cell.weight_ih @ seen + cell.bias_ih).chunk(3)
    of_before = (cell.weight_hh @ before + cell.bias_hh).chunk(3)
    reset = (of_seen[0] + of_before[0]).sigmoid()
    update = (of_seen[1] + of_before[1]).sigmoid()
    new = (of_seen[2] + reset * of_before[2]).tanh()
    return (1 - update) * new + update * before


def _values_of_fork(net, numbers, actions, car):
    """Return (T + 1, 15): a car's values at each tick, by CraftEnv's code, from (T + 1, 13 k) and actions (T,)."""
    table, last = net.encoder.table.weight, net.last.weight
    state, values = torch.zeros(net.width), []
    for t, row in enumerate(numbers):
        before = last[15 if t == 0 else actions[t - 1]]
        seen = (row @ table + net.encoder.car[car] + before).relu()
        state = _gates(net.cell, seen, state)
        values.append(net.head.weight @ state + net.head.bias)
    return torch.stack(values)


def _mixed_by_fork(mixer, values, numbers):
    """Return the team's value, from (n,) and what the first car observes, by CraftEnv's mixer."""
    state = numbers[13:]
    first = mixer.first_weight(state).abs().view(len(values), 32)
    hidden = nn.functional.elu(values @ first + mixer.first_bias(state))
    return hidden @ mixer.last_weight(state).abs() + mixer.last_bias(state)[0]


@pytest.mark.parametrize("algo", ["iql", "vdn", "qmix"])
def test_the_loss_of_the_released_learner_is_that_of_its_formula(algo):
    """One-step targets of double Q-learning on whole episodes, whose time limit is an end (q_learner.py:37-97)."""
    torch.manual_seed(3)
    preset = protocol("fork", "strip", algo, max_steps=1).settings
    trainer = Trainer(TrainConfig("strip", algo, **{**preset, "max_steps": 1, "worlds": 2}))
    learner, batch = trainer.learner, trainer.play(0)
    for weight in learner.modules.parameters():
        weight.data.normal_(std=0.2)
    ticks, worlds, n = batch.actions.shape
    assert (ticks, batch.done.sum().item(), batch.done[-1].all()) == (3, worlds, True)
    total = 0.0
    for world in range(worlds):
        seen = torch.cat([batch.before.places, batch.after.places[-1:]])[:, world].float()
        offers = torch.cat([batch.before.offers, batch.after.offers[-1:]])[:, world]
        actions = batch.actions[:, world]
        both = [
            torch.stack(
                [_values_of_fork(net, seen[:, car], actions[:, car], car) for car in range(n)]
            )
            for net in (learner.net, learner.target_net)
        ]
        for t in range(ticks):
            cars = torch.arange(n)
            taken = both[0][cars, t, actions[t]]
            best = both[0][:, t + 1].masked_fill(~offers[t + 1], -torch.inf).argmax(-1)
            later = both[1][cars, t + 1, best]
            if algo == "vdn":
                taken, later = taken.sum(), later.sum()
            if algo == "qmix":
                taken = _mixed_by_fork(learner.team, taken, seen[t, 0])
                later = _mixed_by_fork(learner.target_team, later, seen[t + 1, 0])
            target = batch.rewards[t, world] + 0.99 * (t < ticks - 1) * later
            total += (taken - target).square().mean() / (ticks * worlds)
    assert float(learner.loss(batch).detach()) == pytest.approx(float(total), rel=1e-4)


def test_target_networks_may_be_copies_that_are_made_now_and_then():
    """Every two episodes here, as the released learner does every 200 (q_learner.py:105)."""
    preset = protocol("fork", "strip", "vdn", max_steps=1).settings
    changed = preset["hyperparameters"] | {"target_ticks": 6, "batch": 6}
    values = {**preset, "max_steps": 1, "worlds": 1, "hyperparameters": changed}
    trainer = Trainer(TrainConfig("strip", "vdn", **values))
    learner, copied = trainer.learner, []
    for _ in trainer.run(12, until=2.0):
        pairs = zip(learner.online.parameters(), learner.target.parameters(), strict=True)
        copied.append(all(torch.equal(*pair) for pair in pairs))
    assert copied == [False, True, False, True]
    assert isinstance(learner.optimizer, torch.optim.RMSprop)


def _played(task, network):
    """Return the shape of a task's networks, and observations and masks of its first episodes, played at random."""
    trainer = Trainer(TrainConfig(task, "qmix", worlds=10, network=network))
    played = trainer.play(0)
    return trainer.shape, played.before.flat()


def _share(mix, n_cars, state, n):
    """Return by how much the team's value changes with a car's, on average over n states."""
    chosen = torch.zeros(n, n_cars, requires_grad=True)
    (slope,) = torch.autograd.grad(mix(chosen, state).sum(), chosen)
    return float(slope.mean())


@pytest.mark.parametrize(
    "case", [("strip", "map"), ("complex_two_story", "map"), ("designs", "relative")], ids=str
)
def test_the_team_s_value_rises_at_first_with_a_car_s_as_in_the_published_mixer(case):
    """There one or two linear layers make the weights, of a state whose numbers were divided by their largest.

    The table of the state begins as a linear layer does, whose numbers hardly depend on how many things there are.
    """
    shape, observed = _played(*case)
    n, shares = shape.n_cars, []
    for seed in range(6):
        torch.manual_seed(seed)
        mixer = QMixer(shape)
        table, layer = (
            mixer.encoder.table.weight.detach(),
            nn.Linear(shape.places, 2).weight.detach(),
        )
        assert table.abs().max() <= shape.places**-0.5
        assert float(table.std()) == pytest.approx(float(layer.std()), rel=0.02)
        ours = _share(mixer, n, observed, len(observed.places))
        state, published = 0.3 * torch.randn(2000, 50), QMixer(replace(shape, width=50))
        single = _share(published.mix, n, state, 2000)
        for name, n_out in {"first_weight": 32 * n, "last_weight": 32}.items():
            layers = nn.Linear(50, 64), nn.ReLU(), nn.Linear(64, n_out)
            setattr(published, name, nn.Sequential(*layers))
        shares.append((ours, single, _share(published.mix, n, state, 2000)))
    ours, single, double = torch.tensor(shares).mean(0).tolist()
    assert double / 2 < ours < single
    torch.manual_seed(0)
    with torch.no_grad():
        joint, others, actions = (
            JointNet(shape),
            OthersNet(shape),
            observed.offers.long().argmax(-1),
        )
        values = *joint(joint.state(observed), actions), others(observed, actions)
    assert all(value.abs().max() < 0.1 for value in values)

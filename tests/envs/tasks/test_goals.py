import pytest
import scipy.stats
import torch

import pemirl_envs
from pemirl_envs.tasks.goals import GoalBox

BOX = GoalBox(low=(-1.0, 2.0), high=(3.0, 2.5), seed=1)
SIZES = {"train_100": 100, "validation": 15, "test": 30, "confirm": 30}


def test_fixed_sets_share_no_goal_and_lie_in_the_box():
    sets = [BOX.task_set(split) for split in SIZES]
    assert [len(goals) for goals in sets] == list(SIZES.values())
    every = torch.cat(sets)
    assert len(every.unique(dim=0)) == 175
    low, high = BOX.bounds
    assert ((every >= low) & (every <= high)).all()
    assert torch.equal(BOX.task_set("test"), BOX.task_set("test"))


def test_uniform_goals_are_uniform():
    goals = BOX.sample(4000, "uniform", torch.Generator().manual_seed(0)).double().numpy()
    for axis, law in enumerate((scipy.stats.uniform(-1, 4), scipy.stats.uniform(2, 0.5))):
        assert scipy.stats.kstest(goals[:, axis], law.cdf).pvalue > 0.01


@pytest.mark.parametrize("split", SIZES)
def test_draws_cover_the_whole_split(split):
    drawn = BOX.sample(3000, split, torch.Generator().manual_seed(0))
    assert torch.equal(drawn.unique(dim=0), BOX.task_set(split).unique(dim=0))


def test_endless_and_unknown_splits_are_refused():
    for split in ("uniform", "nonsense"):
        with pytest.raises(ValueError, match=rf"'{split}' is not a finite split; expected one of"):
            BOX.task_set(split)
    with pytest.raises(ValueError, match="unknown split 'nonsense'; expected one of"):
        BOX.sample(1, "nonsense", torch.Generator())


# Demonstrations and published results refer to these goals: they may never change.
@pytest.mark.parametrize(
    ("domain", "first"),
    [
        (
            "sweeper",
            [
                (0.2868173, 0.1380769),
                (0.0645277, 0.1519749),
                (0.2675955, 0.0738939),
                (-0.1241577, 0.1241629),
            ],
        ),
        (
            "sawyer_pusher",
            [
                (-0.2366087, 0.7937133),
                (0.0651631, 0.7838029),
                (-0.1827403, 0.987972),
                (0.1692371, 0.8312124),
            ],
        ),
    ],
)
def test_published_goals(domain, first):
    for split, goal in zip(SIZES, first, strict=True):
        for variant in ("normal", "shift"):
            goals = pemirl_envs.task_parameters(f"{domain}/{variant}", split)["goal"]
            assert goals[0].tolist() == pytest.approx(goal, abs=1e-6)

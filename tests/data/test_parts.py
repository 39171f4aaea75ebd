"""A demonstration in two parts: what is shown is not imitated, whatever the lengths."""

import pytest
import torch

from pemirl_trl import DemonstrationDataset
from pemirl_trl.data import in_parts


def pile(count=200, lengths=None):
    torch.manual_seed(0)
    whole = DemonstrationDataset(torch.randn(count, 21, 3), torch.randn(count, 20, 2))
    if lengths is None:
        return whole
    episodes = zip(whole.observation, whole.action, lengths, strict=True)
    return DemonstrationDataset.from_episodes(
        [(o[: n + 1], a[:n]) for o, a, n in episodes], terminated=False, horizon=20
    )


def test_every_step_is_shown_or_imitated_and_both_are_runs_of_a_quarter_and_more():
    parts = in_parts(pile().trajectories(), share=1.0)
    shown, imitated = parts["shown", "mask"], parts["mask"]
    assert bool((shown ^ imitated).all())
    assert bool(((imitated[:, 1:] != imitated[:, :-1]).sum(1) == 1).all())  # one cut
    assert int(imitated.sum(1).min()) >= 5
    assert int(imitated.sum(1).max()) <= 15
    assert 0.4 < float(shown[:, 0].float().mean()) < 0.6  # beginnings and ends alike


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_rest_is_shown_whole_and_imitated_whole(share):
    parts = in_parts(pile(2000).trajectories(), share=share)
    whole = parts["shown", "mask"].all(1) & parts["mask"].all(1)
    assert float(whole.float().mean()) == pytest.approx(1 - share, abs=0.04)


def test_an_encoder_that_reads_all_of_t_sees_nothing_of_what_is_imitated():
    data = pile()
    unseen = torch.tensor([7.0, 8.0, 9.0])
    parts = in_parts(data.trajectories(), 1.0, unseen)
    imitated = parts["mask"].unsqueeze(-1)
    shown = parts["shown"]
    assert "mask" not in shown
    assert bool(((shown["observation"] == unseen).all(-1) == parts["mask"]).all())
    assert float(shown["action"].masked_select(imitated).abs().max()) == 0.0
    kept = shown["observation"].masked_select(~imitated)
    assert torch.equal(kept, data.trajectories()["observation"].masked_select(~imitated))


def test_lengths_of_their_own_are_cut_within_and_padding_is_neither():
    lengths = [1, 2, 3, 20] * 50
    data = pile(lengths=lengths)
    whole = data.trajectories()["mask"]
    for _ in range(20):
        parts = in_parts(data.trajectories(), 1.0)
        shown, imitated = parts["shown", "mask"], parts["mask"]
        assert bool((shown.any(1) & imitated.any(1)).all())
        assert bool(((shown | imitated) == whole).all())
        long = torch.tensor(lengths) > 1
        assert not bool((shown & imitated)[long].any())
        assert bool((shown & imitated == whole)[~long].all())  # one step cannot be cut


def test_after_an_end_nothing_is_cut():
    torch.manual_seed(0)
    episodes = [(torch.randn(9, 3), torch.randn(8, 2)) for _ in range(200)]
    data = DemonstrationDataset.from_episodes(episodes, terminated=True, horizon=20)
    trajectories = data.with_absorbing_states().trajectories()
    acted = ~trajectories["absorbing"]
    parts = in_parts(trajectories, 1.0)
    assert bool((parts["mask"] & acted).any(1).all())
    assert bool((parts["shown", "mask"] & acted).any(1).all())


def test_the_trajectories_stay_as_they_are():
    trajectories = pile().trajectories()
    before = trajectories.clone()
    in_parts(trajectories, 1.0, torch.zeros(3))
    assert bool((trajectories == before).all())
    assert "shown" not in trajectories

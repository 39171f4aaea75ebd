"""Distributions over a few choices, with a floor under each."""

from __future__ import annotations

import torch
from torch import Tensor


def mixed_with_uniform(logits: Tensor, log_share: Tensor) -> Tensor:
    r"""Compute log((1 - eps) softmax(logits)_a + eps / n), a draw of n that is uniform at times.

    With probability eps the choice is uniform, else that of the logits. No log-probability falls
    below log(eps / n), however sure the logits are.

    Args:
        logits: ``[..., n]``, up to a constant.
        log_share: log eps, of eps in (0, 1), ``[]`` or ``[1]``.

    Returns:
        ``[..., n]``, normalised log-probabilities, in nats.

    Example:
        >>> sure = torch.tensor([100.0, 0.0])
        >>> mixed_with_uniform(sure, torch.tensor(0.2).log()).exp()
        tensor([0.9000, 0.1000])
    """
    # Not by logaddexp: its second derivative is NaN once logits differ by ninety.
    share = log_share.exp()
    return ((1.0 - share) * torch.softmax(logits, -1) + share / logits.shape[-1]).log()

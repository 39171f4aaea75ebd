"""Results, statistics and reward quality; figures are in :mod:`pemirl_trl.evaluation.figures`.

That module is not imported here, since it needs matplotlib.
"""

from pemirl_trl.evaluation.results import (
    SETTINGS,
    Result,
    environment_facts,
    normalised_return,
    read,
    table,
)
from pemirl_trl.evaluation.returns import episode_returns
from pemirl_trl.evaluation.reward_quality import (
    argmax_error,
    distance_to_goal,
    position_grid,
    reward_on_grid,
    spearman_with_distance,
)
from pemirl_trl.evaluation.statistics import Interval, bootstrap_interval, spearman, t_interval

__all__ = [
    "SETTINGS",
    "Interval",
    "Result",
    "argmax_error",
    "bootstrap_interval",
    "distance_to_goal",
    "environment_facts",
    "episode_returns",
    "normalised_return",
    "position_grid",
    "read",
    "reward_on_grid",
    "spearman",
    "spearman_with_distance",
    "t_interval",
    "table",
]

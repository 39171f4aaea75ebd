"""Results, statistics and reward quality; figures are in :mod:`pemirl_trl.evaluation.figures`.

That module is not imported here, since it needs matplotlib.
"""

from pemirl_trl.evaluation.results import (
    SETTINGS,
    Result,
    Score,
    environment_facts,
    normalised_return,
    read,
    read_all,
)
from pemirl_trl.evaluation.returns import episode_returns
from pemirl_trl.evaluation.reward_distance import (
    RewardFunction,
    canonicalise_epic,
    canonicalise_feasible,
    epic_distance,
    feasible_distance,
    independent_samples,
    pearson_distance,
    radial_basis,
    shaping_subspace,
)
from pemirl_trl.evaluation.reward_quality import (
    argmax_error,
    distance_to_goal,
    map_of_reward,
    position_grid,
    reward_on_grid,
    spearman_with_distance,
)
from pemirl_trl.evaluation.reward_report import (
    Measure,
    RewardReport,
    reward_report,
    shaped_reward_of,
    state_reward_of,
)
from pemirl_trl.evaluation.statistics import (
    Interval,
    iqm,
    iqm_interval,
    pearson,
    probability_of_improvement,
    spearman,
    t_interval,
)

__all__ = [
    "SETTINGS",
    "Interval",
    "Measure",
    "Result",
    "RewardFunction",
    "RewardReport",
    "Score",
    "argmax_error",
    "canonicalise_epic",
    "canonicalise_feasible",
    "distance_to_goal",
    "environment_facts",
    "epic_distance",
    "episode_returns",
    "feasible_distance",
    "independent_samples",
    "iqm",
    "iqm_interval",
    "map_of_reward",
    "normalised_return",
    "pearson",
    "pearson_distance",
    "position_grid",
    "probability_of_improvement",
    "radial_basis",
    "read",
    "read_all",
    "reward_on_grid",
    "reward_report",
    "shaped_reward_of",
    "shaping_subspace",
    "spearman",
    "spearman_with_distance",
    "state_reward_of",
    "t_interval",
]

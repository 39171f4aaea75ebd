"""Results, statistics, tables and reward quality.

Figures are in :mod:`pemirl_trl.evaluation.figures` and :mod:`pemirl_trl.evaluation.comparison`,
which are not imported here, since they need matplotlib.
"""

from pemirl_trl.evaluation.context_quality import linear_probe
from pemirl_trl.evaluation.convergence import Stage, convergence_table, steps_to_converge
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
from pemirl_trl.evaluation.tables import (
    Column,
    by_seed,
    cost_table,
    improvement_table,
    provenance,
    returns_table,
    reward_table,
    scores_of,
    seeds_table,
)

__all__ = [
    "SETTINGS",
    "Column",
    "Interval",
    "Measure",
    "Result",
    "RewardFunction",
    "RewardReport",
    "Score",
    "Stage",
    "argmax_error",
    "by_seed",
    "canonicalise_epic",
    "canonicalise_feasible",
    "convergence_table",
    "cost_table",
    "distance_to_goal",
    "environment_facts",
    "epic_distance",
    "episode_returns",
    "feasible_distance",
    "improvement_table",
    "independent_samples",
    "iqm",
    "iqm_interval",
    "linear_probe",
    "map_of_reward",
    "normalised_return",
    "pearson",
    "pearson_distance",
    "position_grid",
    "probability_of_improvement",
    "provenance",
    "radial_basis",
    "read",
    "read_all",
    "returns_table",
    "reward_on_grid",
    "reward_report",
    "reward_table",
    "scores_of",
    "seeds_table",
    "shaped_reward_of",
    "shaping_subspace",
    "spearman",
    "spearman_with_distance",
    "state_reward_of",
    "steps_to_converge",
    "t_interval",
]

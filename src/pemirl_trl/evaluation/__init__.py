"""What is measured: returns, contexts, rewards, and their statistics."""

from pemirl_trl.evaluation.context_quality import linear_probe
from pemirl_trl.evaluation.joint_information import joint_information
from pemirl_trl.evaluation.returns import (
    Actor,
    episode_returns,
    returns_per_task,
    whole_episodes,
)
from pemirl_trl.evaluation.reward_distance import (
    RewardFunction,
    canonicalise_epic,
    canonicalise_feasible,
    epic_distance,
    evaluate_reward,
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
    seeds_interval,
    spearman,
    t_interval,
)
from pemirl_trl.evaluation.task_space import agreed_contexts, held_out_information

__all__ = [
    "Actor",
    "Interval",
    "Measure",
    "RewardFunction",
    "RewardReport",
    "agreed_contexts",
    "argmax_error",
    "canonicalise_epic",
    "canonicalise_feasible",
    "distance_to_goal",
    "epic_distance",
    "episode_returns",
    "evaluate_reward",
    "feasible_distance",
    "held_out_information",
    "independent_samples",
    "iqm",
    "iqm_interval",
    "joint_information",
    "linear_probe",
    "map_of_reward",
    "pearson",
    "pearson_distance",
    "position_grid",
    "probability_of_improvement",
    "radial_basis",
    "returns_per_task",
    "reward_on_grid",
    "reward_report",
    "seeds_interval",
    "shaped_reward_of",
    "shaping_subspace",
    "spearman",
    "spearman_with_distance",
    "state_reward_of",
    "t_interval",
    "whole_episodes",
]

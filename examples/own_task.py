"""A task of your own: meta-train on its demonstrations, infer rewards, train policies on them.

``python examples/own_task.py`` takes half a minute; with 0.1 it does a tenth of the iterations. The
task and its demonstrations are in ``reach.py``: put yours in their place.
"""

import sys
from dataclasses import replace
from functools import partial

import torch
from reach import T, demonstrations, environment

from pemirl_trl import InferContext, methods
from pemirl_trl.evaluation import whole_episodes

K = 8  # rollouts of a context


def main(share: float = 1.0) -> dict[str, float]:
    """True returns over 10 new goals with reversed steering, of three policies."""
    torch.manual_seed(0)
    pile, new = demonstrations(400), demonstrations(10)
    config = methods.METHODS["pemirl_robust"]  # the library's preset, with fewer iterations
    few = replace(config.training, iterations=round(40 * share), rollouts_per_context=K)
    imitation = replace(config.meta_il, steps=100 * round(20 * share))
    config = replace(config, training=few, meta_il=imitation)
    meta_il, model = methods.new_model(pile, config), methods.new_model(pile, config)
    methods.train(methods.MetaIL(meta_il, pile.trajectories(), config.meta_il))
    methods.start_from(model, meta_il, config)
    infer = InferContext(model.encoder, pile, rollouts_per_context=K, tasks=pile.tasks())
    env = environment(config.contexts_per_batch * K, infer)
    methods.train(methods.build(config, model, env, pile.trajectories()))

    # r(s, m) of each new demonstration, and a policy trained on it.
    shown = {"rollouts_per_context": K, "draw": "all", "sample": False, "tasks": new.tasks()}
    there = environment(len(new) * K, InferContext(model.encoder, new, **shown), steering=-1.0)
    adaptation = methods.AdaptationConfig()
    policy, _ = methods.initial_policy(model, adaptation)
    optimization = replace(adaptation.optimization, iterations=round(70 * share))
    adapt = partial(methods.PolicyOptimization, rollouts_per_context=K, reward=model.reward)
    methods.train(adapt(there, policy, T, optimization))
    actors = {"random": None, "carried over": model.policy, "adapted": policy}
    rollouts = {name: whole_episodes(there, actor, T) for name, actor in actors.items()}
    return {name: float(r["next", "reward"].sum(1).mean()) for name, r in rollouts.items()}


if __name__ == "__main__":
    print(main(*map(float, sys.argv[1:])))

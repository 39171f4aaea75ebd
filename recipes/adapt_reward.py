"""Infer r(s, m) of new tasks from one demonstration each, and train a policy on it (Algorithm 2).

    python recipes/adapt_reward.py model_file=runs/my_run/model.safetensors
    python recipes/adapt_reward.py experiment=ant  # of meta_train.py experiment=ant
    python recipes/adapt_reward.py method=airl  # of meta_train.py method=airl
    python recipes/adapt_reward.py test_demonstrations=my_demonstration.safetensors

Writes ``policy.safetensors`` and the learning curve to ``run_dir``. Rewards are the learned ones;
true returns, where the demonstrations come with their tasks, are metrics.
"""

from pemirl_lab.cli import run

if __name__ == "__main__":
    run("adapt_reward")

"""Infer r(s, m) of new tasks from one demonstration each, and train a policy on it (Algorithm 2).

    python recipes/adapt_reward.py model_file=runs/my_run/model.safetensors
    python recipes/adapt_reward.py experiment=ant  # of the run of pemirl meta_train experiment=ant
    python recipes/adapt_reward.py method=airl  # of the run of pemirl meta_train method=airl
    python recipes/adapt_reward.py test_demonstrations=my_demonstration.safetensors
    python recipes/adapt_reward.py model_file=M test_demonstrations=ONE env=my:make_env

With ``env=`` it is an environment of your own, and the settings follow from the demonstrations; see
``pemirl meta_train``. Short tries choose the start, unless ``initial_policy=`` says it, and how
widely to explore, unless ``exploration=`` does; ``adaptation.json`` tells what came out.

Writes ``policy.safetensors`` and the learning curve to ``run_dir``. Rewards are the learned ones;
true returns, where the demonstrations come with their tasks, are metrics.
"""

from pemirl_lab.cli import run

if __name__ == "__main__":
    run("adapt_reward")

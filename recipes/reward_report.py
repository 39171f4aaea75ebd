"""How close is the learned reward to the true one? One page with figures.

    python recipes/reward_report.py model_file=runs/my_run/model.safetensors
    python recipes/reward_report.py transfer=true  # and what policies trained on it reach

Writes ``report.md``, ``report.json`` and figures to ``run_dir``. The latent m of a task is the mean
of q(m | its one demonstration).
"""

from pemirl_lab.cli import run

if __name__ == "__main__":
    run("reward_report")

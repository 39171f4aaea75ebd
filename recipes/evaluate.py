"""Evaluate a meta-trained model: a table, a results file, reward maps and learning curves.

    python recipes/evaluate.py                          # of the runs of meta_train and adapt_reward
    python recipes/evaluate.py experiment=ant
    python recipes/evaluate.py meta_run=... adaptation_run=...

One-shot returns on the training dynamics; policy generalisation and reward adaptation on the
changed ones. Each of the last policy, of the mean action, with m the mean of q(m | demonstration).
"""

from pemirl_lab.cli import run

if __name__ == "__main__":
    run("evaluate")

"""Train an expert on the true reward: TRPO with a policy that reads the task.

    python recipes/train_expert.py
    python recipes/train_expert.py environment=point_maze/right output=my_expert.safetensors
    python recipes/train_expert.py task=ant

Writes the policy's weights to ``output``; everything else goes to ``run_dir``.
"""

from pemirl_lab.cli import run

if __name__ == "__main__":
    run("train_expert")

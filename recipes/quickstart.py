"""From unlabelled demonstrations to a policy on a reward inferred from one demonstration.

    python recipes/quickstart.py
    python recipes/quickstart.py experiment=ant seed=1
    python recipes/quickstart.py preset=smoke            # seconds: does everything run here?
    python recipes/quickstart.py -m seed=0,1,2           # three seeds, one after the other

Meta-trains on Point-Maze with the barrier on the left, infers the goals of 30 unseen tasks from one
demonstration each, trains a policy on the inferred rewards with the barrier on the right, and
prints a table. Give the same command again after an interruption: it resumes.
"""

from pemirl_lab.cli import run

if __name__ == "__main__":
    run("quickstart")

"""Run the rows of a table over seeds: the paper's experiments, the baselines, the ablations.

    python recipes/reproduce.py table=point_maze  # every row, every seed
    python recipes/reproduce.py table=ablations row=base,info_none seed=0,1  # some of it
    python recipes/reproduce.py table=ant hydra.launcher.n_jobs=4  # so many side by side
    python recipes/reproduce.py table=ant --list  # the commands, one a job
    python recipes/reproduce.py table=ant hydra/launcher=submitit_slurm  # hydra-submitit-launcher
    python recipes/reproduce.py table=ant hydra/launcher=ray  # hydra-ray-launcher
    python recipes/reproduce.py table=ant confirm=true  # at the end, once

Each seed has its own demonstrations and its own Meta-IL, which all its rows share. A job writes
``results/TABLE/ROW/seedN.json``; the same command does what is missing, and resumes what died.
``pemirl report --write`` turns the files into pages. With ``confirm=true`` the same trained model
is also measured on tasks, and under a shift, by which nothing was chosen:
``results/TABLE_confirm/ROW/seedN.json``.
"""

from pemirl_lab.cli import run

if __name__ == "__main__":
    run("reproduce")

"""What a task's experts reach, and the training expert where the dynamics have changed.

    python recipes/measure_experts.py task=ant
    python recipes/measure_experts.py task=ant rescale=[disabled]      # that expert is a new one

Two rows of the task's table, ``results/TASK/expert`` and ``results/TASK/expert_carried_over``: true
returns of the mean action over the test tasks, and what a person would look at (the task's
``outcomes``). Two more, ``scripted`` and ``scripted_carried_over``, where the task has controllers
by hand. Where an expert has been replaced, ``rescale`` names its dynamics: what is stored in the
task's tables is then normalised by the new one. The returns stay as they were.
"""

from pemirl_lab.cli import run

if __name__ == "__main__":
    run("measure_experts")

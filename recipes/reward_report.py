r"""How close is a reward to the true one? One HTML page with figures.

    python recipes/reward_report.py model_file=runs/my_run/model.safetensors
    python recipes/reward_report.py transfer=true  # and what policies trained on it reach
    python recipes/reward_report.py reward=my_module:my_reward
    python recipes/reward_report.py reward=point_maze  # of the zoo, or a file of export_reward
    python recipes/reward_report.py reward=my_module:my_reward true_reward=my_module:true_reward \
        env=my_module:make_env test_demonstrations=FILE run_dir=runs/report

``reward=`` is a file, or a function ``(observation [n, S], m [n, D]) -> [n]`` of tensors, or of
NumPy arrays with ``numbers=numpy``. Of a file, m is the mean of q(m | the task's one
demonstration); of a function it is what the task is (the goal) or, with ``encoder_file=FILE``, what
that file's q says. With ``env=`` it is an environment of your own, and ``true_reward`` a function
``(observation, task) -> [n]``.

Writes ``report.html``, one file that needs no other, and ``report.md`` with its figures and
``report.json`` to ``run_dir``. EPIC and maps are there where the true reward is a function of a
position (Point-Maze); EPIC also where it is given.
"""

from pemirl_lab.cli import run

if __name__ == "__main__":
    run("reward_report")

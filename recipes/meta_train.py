"""Meta-train q(m | demonstration), r(s, m) and a policy on unlabelled demonstrations.

    python recipes/meta_train.py
    python recipes/meta_train.py experiment=ant
    python recipes/meta_train.py method=airl seed=1
    python recipes/meta_train.py training.info_coeff=0 model.context_dim=5 run_dir=runs/no_info
    python recipes/meta_train.py demonstrations=FILE env=my_module:make_env run_dir=runs/mine

With ``env=`` it is an environment of your own: the settings follow from the demonstrations, any of
them can be given (``training.iterations=100``), and ``preset=`` is one of the library's (robust,
contrastive with ``task_space=[0,1]``, paper).

Writes ``model.safetensors`` and, where the method has contexts, ``meta_il.safetensors`` (Meta-IL:
a baseline, and what initialises the encoder) to ``run_dir``.
"""

from pemirl_lab.cli import run

if __name__ == "__main__":
    run("meta_train")

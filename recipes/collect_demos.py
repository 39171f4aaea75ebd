"""Roll an expert out into demonstrations, so many per task of a split.

    python recipes/collect_demos.py
    python recipes/collect_demos.py split=test output=data/point_maze_test.safetensors
    python recipes/collect_demos.py expert=[one.safetensors,other.safetensors]     # by turns

Writes one safetensors file to ``output``. Actions are drawn from the expert's distribution, as
maximum-entropy IRL assumes. Task parameters are stored for metrics; no learner reads them.
"""

from pemirl_lab.cli import run

if __name__ == "__main__":
    run("collect_demos")

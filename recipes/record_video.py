"""Film a policy on a few unseen tasks, with MuJoCo's own renderer.

    export MUJOCO_GL=osmesa
    python recipes/record_video.py run=runs/quickstart/point_maze/pemirl_robust/seed0
    python recipes/record_video.py task=ant policy=expert output=ant.mp4

Writes ``output`` (mp4). Headless rendering needs Debian's ``libosmesa6``.
"""

from pemirl_lab.cli import run

if __name__ == "__main__":
    run("record_video")

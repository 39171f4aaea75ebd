"""Films; where there is nothing to render with, what is refused."""

import os
import shutil
import subprocess

import pytest
from imageio_ffmpeg import get_ffmpeg_exe

from pemirl_lab.commands import record_video

SMALL = ("run=smoke", "tasks=2", "output=film.mp4", "width=64", "height=48")


@pytest.mark.skipif(
    os.environ.get("MUJOCO_GL", "disable") == "disable", reason="no OpenGL library to render with"
)
@pytest.mark.parametrize("policy", ["adapted", "expert"])
def test_a_policy_is_filmed(smoke, settings, here, policy):
    shutil.copytree(smoke[0] / "smoke", "smoke")
    record_video.run(*settings("record_video", *SMALL, f"policy={policy}"))
    decode = [get_ffmpeg_exe(), "-i", "film.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    film = subprocess.run(decode, capture_output=True, check=True).stdout
    frame = len(film) // 200  # two episodes of 100 steps
    assert len(film) == 200 * frame > 0
    assert film[:frame] != film[99 * frame : 100 * frame]


def test_who_is_filmed_on_what_tasks(smoke, settings, here):
    shutil.copytree(smoke[0] / "smoke", "smoke")
    for choose in (record_video.adapted, record_video.expert):
        _, _, count = choose(*settings("record_video", *SMALL))
        assert count == 2
    _, _, count = record_video.expert(*settings("record_video", "tasks=99"))
    assert count == 30  # all that there are


def test_there_is_no_other_policy_to_film(settings):
    with pytest.raises(ValueError, match=r"^policy=best: expected 'adapted' or 'expert'"):
        settings("record_video", "policy=best")


def test_a_run_that_is_not_there_says_who_writes_it(settings, here):
    with pytest.raises(FileNotFoundError, match="pemirl quickstart or meta_train writes it"):
        record_video.run(*settings("record_video", "run=none"))

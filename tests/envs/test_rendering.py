"""Rendering, in a Python process of its own: the GL library is chosen when MuJoCo is imported."""

import os
import subprocess
import sys
from ctypes.util import find_library

import numpy as np
import pytest
import torch
from imageio_ffmpeg import get_ffmpeg_exe

import pemirl_envs
from pemirl_envs.rendering import write_video

needs_gl = pytest.mark.skipif(
    not find_library("OSMesa"),
    reason="no OSMesa library to render with (Debian: libosmesa6)",
)

RENDER = """
import sys
import gymnasium, numpy as np, pemirl_envs, torch
from pemirl_envs.rendering import Renderer, render
frames = {}
for name in pemirl_envs.TASKS:
    env = pemirl_envs.make(name, 2, seed=0)
    env.reset()
    frames[name] = render(env.task, env.physics_state(), width=64, height=48)
left = pemirl_envs.make("point_maze/left", 2, seed=0)
goals = torch.tensor([[0.0, 0.5], [0.5, 0.5]])
left.reset(left.reset().update({"task": {"goal": goals}}))
left.episodes.simulation.write({"qpos": torch.zeros(2, 2)})
frames["goals"] = render(left.task, left.physics_state(), width=64, height=64)
single = gymnasium.make("pemirl_envs/PointMazeLeft-v0", render_mode="rgb_array")
single.reset(seed=0)
frames["gym"] = single.render()
single.close()
batch = gymnasium.make_vec("pemirl_envs/PointMazeLeft-v0", 2, render_mode="rgb_array")
batch.reset(seed=0)
frames["gym_vector"] = np.stack(batch.render())
batch.close()
dm = pemirl_envs.load("point_maze", "left", task_kwargs={"random": 0})
dm.reset()
frames["dm_control"] = dm.physics.render(480, 480, camera_id="top")
np.savez(sys.argv[1], **frames)
"""

NO_GL = """
import pemirl_envs
from pemirl_envs.rendering import RenderingError, render
env = pemirl_envs.make("point_maze/left", 1, seed=0)
env.rollout(2)
try:
    render(env.task, env.physics_state())
except RenderingError as error:
    print(error)
"""


MISSING_LIBRARY = """
import ctypes.util
import tensordict
ctypes.util.find_library = lambda name: None
ctypes.CDLL.__init__ = lambda *arguments, **keywords: (_ for _ in ()).throw(OSError("missing"))
try:
    import pemirl_envs
except ImportError as error:
    print(error)
"""


def python(script, gl, *arguments):
    run = subprocess.run(
        [sys.executable, "-c", script, *arguments],
        env=os.environ | {"MUJOCO_GL": gl, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    path = tmp_path_factory.mktemp("frames") / "frames.npz"
    python(RENDER, "osmesa", str(path))
    with np.load(path) as arrays:
        return dict(arrays)


def moved(one, other):
    """Where two frames differ clearly: the mean (row, column), in fractions of the frame."""
    difference = np.abs(one.astype(float) - other.astype(float)).max(-1) > 40
    return np.argwhere(difference).mean(0) / one.shape[:2]


@needs_gl
def test_every_variant_is_drawn_and_differs_from_the_others(frames):
    visible = [name for name in pemirl_envs.TASKS if not name.endswith("_rk4")]  # an integrator
    pictures = [frames[name][0] for name in visible]
    for i, picture in enumerate(pictures):
        assert picture.shape == (48, 64, 3)
        assert picture.dtype == np.uint8
        assert picture.std() > 10
        assert all(np.abs(picture.astype(int) - other).max() > 40 for other in pictures[:i])


@needs_gl
def test_the_goal_is_drawn_where_it_is(frames):
    near, far = frames["goals"]
    row, column = moved(near, far)
    # Goals at x = 0 and 0.5, y = 0.5 in a picture centred at (0.25, 0.25): their mean is above
    # the centre, and as far to the left as to the right of it.
    assert row < 0.4
    assert column == pytest.approx(0.5, abs=0.03)


@needs_gl
def test_all_faces_show_the_same_picture(frames):
    single = frames["gym"]
    assert single.shape == (480, 480, 3)
    np.testing.assert_array_equal(single, frames["dm_control"])
    assert frames["gym_vector"].shape == (2, 480, 480, 3)


def test_without_a_gl_library_everything_else_works():
    message = python(NO_GL, "disable")
    assert "libosmesa6" in message
    assert "MUJOCO_GL=osmesa" in message
    assert "MUJOCO_GL is disable" in message


def test_a_missing_gl_library_is_named_at_import():
    message = python(MISSING_LIBRARY, "osmesa")
    assert "could not be imported with MUJOCO_GL=osmesa" in message
    assert "libosmesa6" in message
    assert "MUJOCO_GL=disable" in message


def test_tensordict_is_imported_before_mujoco():
    """The other order crashes with OSMesa and a PyTorch that brings triton."""
    order = python("import sys, pemirl_envs; print(*sys.modules)", "disable").split()
    assert order.index("tensordict") < order.index("mujoco")


def test_an_unknown_camera_is_refused():
    task = pemirl_envs.get_task("point_maze/left")
    with pytest.raises(ValueError, match=r"unknown camera 'side'; expected one of \['top'\]"):
        pemirl_envs.rendering.Renderer(task, camera="side")


def test_a_video_holds_its_frames(tmp_path):
    levels = torch.tensor([0, 80, 160, 240], dtype=torch.uint8)
    frames = levels[:, None, None, None].expand(4, 64, 64, 3).numpy()
    path = tmp_path / "video.mp4"
    write_video(path, frames, fps=20)
    decode = [get_ffmpeg_exe(), "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    run = subprocess.run(decode, capture_output=True, check=True)
    read = np.frombuffer(run.stdout, np.uint8).reshape(frames.shape)
    assert np.abs(read.mean((1, 2, 3)) - levels.numpy()).max() < 4
    assert b"20 fps" in run.stderr
    assert list(tmp_path.iterdir()) == [path]

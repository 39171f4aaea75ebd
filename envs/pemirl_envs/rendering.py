"""Pictures and videos of a task through MuJoCo's own renderer, without a display.

A video of one simulation of a rollout::

    states = []
    env.rollout(100, policy, callback=lambda env, _: states.append(env.physics_state()[0]))
    write_video("episode.mp4", render(env.task, torch.stack(states)), fps=20)
"""

from __future__ import annotations

import os
import pathlib
import tempfile
from types import TracebackType
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from pemirl_envs.tasks import Task

Frame = NDArray[np.uint8]

_NO_GL = (
    "MuJoCo could not open an OpenGL context. To render without a display, install OSMesa (Debian: "
    "apt-get install --no-install-recommends libosmesa6) and set MUJOCO_GL=osmesa before Python "
    "starts, or MUJOCO_GL=egl where a GPU driver provides EGL. MUJOCO_GL is {backend}"
)


class RenderingError(RuntimeError):
    """There is no OpenGL library to render with; everything but rendering works without one."""


class Renderer:
    """Draws states of a task; close it, or use it as a context manager.

    Args:
        task: the task.
        width: pixels.
        height: pixels.
        camera: the name of a camera of the task's model.

    Raises:
        RenderingError: no OpenGL context can be opened; says what to install.
        ValueError: the model has no such camera.
    """

    def __init__(
        self, task: Task, *, width: int = 480, height: int = 480, camera: str = "top"
    ) -> None:
        model = task.model
        cameras = [model.camera(i).name for i in range(model.ncam)]
        if camera not in cameras:
            raise ValueError(f"unknown camera {camera!r}; expected one of {cameras}")
        self._model, self._data, self._camera = model, mujoco.MjData(model), camera
        try:
            self._renderer = mujoco.Renderer(model, height, width)
        except ValueError:  # a frame that is too large, not a missing library
            raise
        except Exception as error:  # each GL backend fails in its own way
            backend = os.environ.get("MUJOCO_GL", "not set")
            raise RenderingError(_NO_GL.format(backend=backend)) from error

    def frame(self, state: Tensor) -> Frame:
        """Draws one row of ``TaskEnv.physics_state()``, uint8 ``[H, W, 3]``."""
        row = np.asarray(state, dtype=np.float64)
        mujoco.mj_setState(self._model, self._data, row, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(self._model, self._data)
        self._renderer.update_scene(self._data, self._camera)
        frame: Frame = self._renderer.render()
        return frame

    def close(self) -> None:
        """Frees the OpenGL context."""
        self._renderer.close()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def render(task: Task, states: Tensor, **view: Any) -> Frame:
    """Draws rows of ``TaskEnv.physics_state()``, ``[T, n_state]``, as uint8 ``[T, H, W, 3]``.

    ``view`` holds keywords of :class:`Renderer`, which also says what may be raised.
    """
    with Renderer(task, **view) as renderer:
        return np.stack([renderer.frame(state) for state in states])


def write_video(path: str | os.PathLike[str], frames: Frame, fps: float) -> None:
    """Writes frames, uint8 ``[T, H, W, 3]``, as an mp4 video.

    Raises:
        ImportError: ``imageio[ffmpeg]`` is not installed.
    """
    import imageio.v3  # optional: nothing else needs it

    path = pathlib.Path(path)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        temporary = pathlib.Path(folder) / path.name
        imageio.v3.imwrite(temporary, frames, fps=fps)
        os.replace(temporary, path)

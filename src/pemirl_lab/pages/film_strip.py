"""A film as a picture: one row per episode, frames at even distances.

    pemirl film_strip docs/videos/ant_disabled_adapted.mp4 strip.png --episodes 2 --columns 8

Reading a film needs the extra ``video``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pemirl_envs.rendering import Frame
from pemirl_trl.files import atomic_path

__all__ = ["film_strip"]


def film_strip(frames: Frame, episodes: int, columns: int) -> Frame:
    """Frames of ``episodes`` episodes of equal length, one after the other, tiled.

    Args:
        frames: uint8 ``[T, H, W, 3]``.
        episodes: rows; T is a multiple of it.
        columns: of each episode, from its first frame to its last.

    Returns:
        uint8 ``[episodes H, columns W, 3]``.

    Raises:
        ValueError: the film does not divide into so many episodes, or they are too short.
    """
    total = len(frames)
    if min(episodes, columns) < 1 or total % episodes or total // episodes < columns:
        raise ValueError(
            f"{total} frames do not give {episodes} episodes of {columns} frames or more each"
        )
    chosen = np.linspace(0, total // episodes - 1, columns).round().astype(int)
    rows = frames.reshape(episodes, -1, *frames.shape[1:])[:, chosen]  # [E, C, H, W, 3]
    strip: Frame = np.concatenate(np.concatenate(rows.swapaxes(0, 1), axis=2), axis=0)
    return strip


def main(arguments: Sequence[str]) -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(
        "pemirl film_strip", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("film", type=Path, help="of pemirl record_video")
    parser.add_argument("picture", type=Path, help="a PNG file to write")
    parser.add_argument("--episodes", type=int, default=1, help="in the film; one row each")
    parser.add_argument("--columns", type=int, default=8, help="frames of an episode")
    given = parser.parse_args(arguments)
    if not given.film.is_file():
        parser.exit(2, f"pemirl film_strip: there is no file {given.film}\n")
    try:
        import imageio.v3  # optional: nothing but films needs it
    except ImportError:
        parser.exit(2, "pemirl film_strip: reading films needs pip install 'pemirl-trl[video]'\n")
    try:
        with imageio.v3.imopen(given.film, "r") as film:
            strip = film_strip(film.read(), given.episodes, given.columns)
    except (OSError, ValueError) as error:
        parser.exit(2, f"pemirl film_strip: {given.film}: {error}\n")
    with atomic_path(given.picture) as temporary:
        imageio.v3.imwrite(temporary, strip, extension=".png")

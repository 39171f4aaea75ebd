"""A strip has the frames that it should, each in its place."""

import imageio.v3
import numpy as np
import pytest

from pemirl_lab.pages.film_strip import film_strip, main

FILM = np.broadcast_to(np.arange(12, dtype=np.uint8)[:, None, None, None], (12, 2, 3, 3))
"""Frames of 2 x 3 pixels, each of its own number."""


def test_rows_are_episodes_from_their_first_frame_to_their_last():
    strip = film_strip(FILM, episodes=2, columns=3)
    assert strip.shape == (4, 9, 3)
    assert strip[::2, ::3, 0].tolist() == [[0, 2, 5], [6, 8, 11]]
    assert (strip[:2, 3:6] == 2).all()  # a frame stays whole


@pytest.mark.parametrize(("episodes", "columns"), [(5, 2), (2, 7), (0, 1), (1, 0)])
def test_a_film_that_does_not_divide_is_refused(episodes, columns):
    with pytest.raises(
        ValueError, match=rf"12 frames do not give {episodes} episodes of {columns}"
    ):
        film_strip(FILM, episodes, columns)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # imageio's pipes
def test_the_command_reads_a_film_and_says_what_is_wrong(tmp_path, capsys):
    film, picture = tmp_path / "film.mp4", tmp_path / "strip.png"
    imageio.v3.imwrite(film, np.zeros((8, 32, 48, 3), np.uint8), fps=4)
    main([str(film), str(picture), "--episodes", "2", "--columns", "4"])
    assert imageio.v3.imread(picture).shape == (64, 192, 3)
    for arguments, message in (
        ([str(film), str(picture), "--episodes", "3"], "8 frames do not give 3 episodes of 8"),
        ([str(tmp_path / "gone.mp4"), str(picture)], "there is no file"),
    ):
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        assert stopped.value.code == 2
        assert message in capsys.readouterr().err

"""``pemirl check`` says what is suspicious about a file of demonstrations."""

import pytest
import torch

from pemirl_lab.measuring.check import main
from pemirl_trl import DemonstrationDataset


def test_published_demonstrations_have_nothing_suspicious(capsys):
    main(["data/point_maze_train.safetensors", "--environment", "point_maze/left"])
    told = capsys.readouterr().out
    assert "800 demonstrations of 100 steps" in told
    assert "nothing suspicious" in told


def test_what_is_suspicious_is_said_with_its_cure(tmp_path, capsys):
    observation = torch.randn(12, 21, 3).cumsum(1)
    observation[..., 2] = 1.0
    file = tmp_path / "demos.safetensors"
    DemonstrationDataset(observation, 1e4 * torch.randn(12, 20, 2)).save(file)
    main([str(file)])
    told = capsys.readouterr().out
    assert "feature 2" in told
    assert "action" in told


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.safetensors"], "no file nowhere.safetensors"),
        (["data/point_maze_left_expert.safetensors"], "expected 'demonstrations'"),
        (["data/point_maze_test.safetensors", "--environment", "maze"], "unknown task 'maze'"),
    ],
)
def test_what_cannot_be_read_is_explained(arguments, message, capsys):
    with pytest.raises(SystemExit) as left:
        main(arguments)
    assert left.value.code == 2
    assert message in capsys.readouterr().err

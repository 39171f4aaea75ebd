"""The table of held-out information shows the two best components by their worst body."""

import json

import pytest

from pemirl_lab.pages.transfer_table import transfer_parts


def test_components_are_ranked_by_their_worst_body_over_seeds(tmp_path):
    (tmp_path / "legs").mkdir()
    for seed, speed in enumerate((0.05, 0.07)):
        worst = {"yaw": -0.01, "speed": speed, "height": -0.2}
        family = {name: {"worst": value, "mean": 1.0} for name, value in worst.items()}
        content = json.dumps({"families": {"2": family}})
        (tmp_path / f"legs/seed{seed}.json").write_text(content)
    lines = transfer_parts(tmp_path, ["legs"])["legs"].splitlines()
    # 12.71 x 0.01414 / sqrt(2) to either side.
    expected = "| 2 | 2 | speed | 0.060 [-0.067, 0.187] | yaw | -0.010 [-0.010, -0.010] |"
    assert lines[2:] == [expected]
    with pytest.raises(ValueError, match="holds no results"):
        transfer_parts(tmp_path, ["arms"])

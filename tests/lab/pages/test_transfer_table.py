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


def test_policies_are_grouped_by_what_r_reads_and_by_bodies(tmp_path):
    (tmp_path / "ants").mkdir()

    def write(reads, bodies, seed, gap, read):
        true = {"adapted": 300 + seed, "carried_over": 10.0, "known": 330.0, "random": -10.0}
        content = {
            "reads": reads,
            "read": read,
            "bodies": bodies,
            "gap_closed": gap,
            "returns": {name: {"true": value} for name, value in true.items()},
            "contexts": {"task": 0.99} | ({"body": 0.031} if bodies > 1 else {}),
        }
        file = tmp_path / f"ants/{reads}_bodies{bodies}_seed{seed}.json"
        file.write_text(json.dumps(content))

    write("found", 2, 0, 0.9, ["speed"])
    write("found", 2, 1, 1.0, ["speed", "yaw"])
    write("whole", 1, 0, 0.0, ["height", "speed", "yaw"])
    lines = transfer_parts(tmp_path, ["ants"])["ants"].splitlines()
    expected = "300.0 | 10.0 | 330.0 | -10.0 | 0.99 | – |"
    assert lines[2] == f"| the whole state | 1 | 1 | 0.000 | {expected}"
    found = "| found: speed; or speed, yaw | 2 | 2 | 0.950 [0.315, 1.585] | 300.5 |"
    assert lines[3].startswith(found)
    assert lines[3].endswith("| 0.99 | 0.03 |")

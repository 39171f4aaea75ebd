"""One row an iteration, also after a kill."""

from pemirl_lab.runs.metrics import forget_from


def test_rows_that_come_anew_are_dropped_in_all_files(tmp_path):
    (tmp_path / "trpo").mkdir()
    for name in ("return.csv", "trpo/kl.csv"):
        (tmp_path / name).write_text("1,-40.0\n2,-30.5\n3,-20.25\n", encoding="utf-8")
    (tmp_path / "notes.txt").write_text("3,kept\n", encoding="utf-8")
    forget_from(3, tmp_path)
    for name in ("return.csv", "trpo/kl.csv"):
        assert (tmp_path / name).read_text(encoding="utf-8") == "1,-40.0\n2,-30.5\n"
    assert (tmp_path / "notes.txt").read_text(encoding="utf-8") == "3,kept\n"
    forget_from(1, tmp_path)
    assert (tmp_path / "return.csv").read_text(encoding="utf-8") == ""


def test_a_line_that_a_kill_cut_off_is_dropped(tmp_path):
    file = tmp_path / "return.csv"
    for cut in ("2", "2,", "2,-3", ""):
        file.write_text(f"1,-40.0\n{cut}", encoding="utf-8")
        forget_from(3, tmp_path)
        assert file.read_text(encoding="utf-8") == "1,-40.0\n"


def test_a_folder_that_is_not_there_has_nothing_to_forget(tmp_path):
    forget_from(1, tmp_path / "none")
    assert not (tmp_path / "none").exists()

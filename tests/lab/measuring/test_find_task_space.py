"""What a reward may read, by command."""

import pytest
import torch

from pemirl_lab.cli import main as pemirl
from pemirl_lab.measuring.find_task_space import tasks_of
from pemirl_trl import DemonstrationDataset

T, EACH = 10, 40


def demonstrations(turns, seed, *, labelled=True):
    """The first component tells the hidden side, the second one a body's own way."""
    generator = torch.Generator().manual_seed(seed)
    side = torch.tensor([1.0, -1.0]).repeat(EACH // 2)
    seen = torch.randn(EACH, T + 1, 2, generator=generator)
    seen = seen + side[:, None, None] * torch.tensor([1.0, turns])
    action = side[:, None, None] + 0.1 * torch.randn(EACH, T, 1, generator=generator)
    task = {"side": side.unsqueeze(-1)} if labelled else None
    return DemonstrationDataset.from_episodes(zip(seen, action, strict=True), task=task)


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, turns, seed in (("one", 1.0, 0), ("other", -1.0, 1)):
        demonstrations(turns, seed).save(f"{name}.safetensors")


def told(monkeypatch, capsys, *words):
    monkeypatch.setattr("sys.argv", ["pemirl", "find_task_space", *words])
    pemirl()
    return capsys.readouterr().out.splitlines()


def test_the_table_and_what_to_do_with_it(files, monkeypatch, capsys):
    words = ["meta_il.steps=300", "model.encoder_hidden=[32]", "model.context_dim=1"]
    lines = told(monkeypatch, capsys, "demonstrations=[one.safetensors,other.safetensors]", *words)
    assert [line.split()[0] for line in lines[1:3]] == ["0", "1"]
    assert lines[-1] == "what tells the task in every body: task_space=[0]"


def test_tasks_are_paired_by_what_the_files_say():
    bodies = [demonstrations(1.0, 0), demonstrations(-1.0, 1)[:10]]
    first, second = tasks_of(bodies)
    assert (first[:10] == second).all()
    assert first.unique().tolist() == [0, 1]
    assert tasks_of([bodies[0], demonstrations(1.0, 0, labelled=False)]) is None


def test_mistakes_are_said(files, monkeypatch, capsys):
    with pytest.raises(SystemExit, match="pemirl find_task_space: missing demonstrations="):
        told(monkeypatch, capsys)
    with pytest.raises(SystemExit, match="of 1 body; expected those of two or more"):
        told(monkeypatch, capsys, "demonstrations=[one.safetensors]")
    both = "demonstrations=[one.safetensors,other.safetensors]"
    with pytest.raises(SystemExit, match="meta_il"):
        told(monkeypatch, capsys, both, "meta_il.no=1")
    assert "demonstrations=[" in "\n".join(told(monkeypatch, capsys, "--help"))

"""Cards of what a run has trained, from what its folder says."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic.dataclasses import dataclass

from pemirl_lab import results
from pemirl_lab.runs.places import data_file, run_file
from pemirl_lab.runs.run_folder import FREE, read_json, read_run
from pemirl_trl import DemonstrationDataset
from pemirl_trl.configuration import CHECKED
from pemirl_trl.files import Card, atomic_path, content_digest, read_metadata
from pemirl_trl.methods.own_training import digest

_NO_SETTINGS = (
    *(
        "versions",
        "hardware",
        "commit",
        "results",
        "table_name",
        "experts",
        "subsets",
        "experiment",
    ),
    *("expert_training", "evaluation", *FREE),
)
"""What a run says of itself that is no setting of its training."""


@dataclass(frozen=True, config=CHECKED)
class Export:
    """The values that both commands share.

    Attributes:
        model_file: of ``pemirl meta_train`` or ``pemirl quickstart``, in its run's folder.
        licence: of the weights, an SPDX identifier.
        command: what makes it anew, for the card.
        demonstrations: what it was trained on, where that is not where the run read it.
    """

    model_file: str
    licence: str = "unknown"
    command: str = "unknown"
    demonstrations: str | None = None

    def card(self) -> Card:
        """The card of the model.

        Raises:
            FileNotFoundError: no model, or no demonstrations where the run read them.
            ValueError: the demonstrations have changed since.
        """
        model = run_file(self.model_file, "meta_train")
        folder = model.parent
        if not (folder / "config.yaml").exists():
            raise FileNotFoundError(
                f"no file {folder / 'config.yaml'}: the card of a model is made of what its run's "
                "folder says; give the model_file there"
            )
        run = read_run(folder)
        return Card(
            domain=str(run.get("environment", run.get("env", "unknown"))),
            data_sha256=self._data_digest(folder, run),
            settings={k: _shared(v) for k, v in run.items() if k not in _NO_SETTINGS},
            measures=_measures(folder, read_metadata(model)["method"]),
            licence=self.licence,
            command=self.command,
            versions={**run["versions"], "commit": run["commit"]},
        )

    def _data_digest(self, folder: Path, run: Mapping[str, Any]) -> str:
        noted = read_json(folder / "inputs.json").get("demonstrations")
        if noted is None:
            raise ValueError(f"{folder / 'inputs.json'} does not say what the run was trained on")
        file = data_file(self.demonstrations or noted["file"])
        if content_digest(file) != noted["sha256"]:
            raise ValueError(
                f"{file} is not what the run in {folder} was trained on (its content differs): "
                "give demonstrations=FILE"
            )
        words = {name: run.get(name) for name in ("observation_keys", "discrete_actions")}
        return digest(DemonstrationDataset.load(file, **words))


def _shared(value: Any) -> Any:
    """A setting as others may see it: of a path into this machine's folders, the name alone."""
    return Path(value).name if isinstance(value, str) and Path(value).is_absolute() else value


def _measures(folder: Path, method: str) -> dict[str, float]:
    """Returns and measures of the reward, where the run has been evaluated."""
    file = folder / "results" / f"{method}.json"
    if not file.exists():
        return {}
    result = results.read(file)
    measures: dict[str, float] = {}
    for score in result.scores:
        name = f"{score.setting}/{score.variant}/{score.goals}"
        measures |= {f"{name}/return": score.mean, f"{name}/normalised": score.normalised}
    return measures | dict(result.reward)


def write_page(card: Card, file: Path) -> Path:
    """Write a card as Markdown beside the file that it is of; return where."""
    page = file.with_suffix(".md")
    with atomic_path(page) as temporary:
        temporary.write_text(card.markdown(file.stem), encoding="utf-8")
    return page


def summary(card: Card, file: Path, page: Path, numbers: dict[str, Any]) -> str:
    """What to tell whoever exported it."""
    sizes = ", ".join(f"{name}={value}" for name, value in numbers.items())
    return f"{card.domain} ({sizes}; licence: {card.licence}) -> {file}, card -> {page}"

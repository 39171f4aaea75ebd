"""From ``key=value`` to a resolved configuration, by Hydra: what wins over what stands here.

config < method < task < experiment < preset < a table's row < the command line. Methods are those
of :data:`pemirl_trl.methods.METHODS`; all else is YAML in ``conf/``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf

from pemirl_trl.methods import METHODS, AdaptationConfig

CONF = Path(__file__).resolve().parents[1] / "conf"


def register_library() -> None:
    """Make the library's configurations known to Hydra: the group ``method``, and adaptation's."""
    store = ConfigStore.instance()
    store.store(name="library", node={"adaptation": asdict(AdaptationConfig())})
    for name, method in METHODS.items():
        node = {"method": name, **asdict(method)}
        store.store(group="method", name=name, node=node, package="_global_")
    OmegaConf.register_new_resolver("runs", folder_of_runs, replace=True)


def folder_of_runs(preset: str) -> str:
    """Where runs lie: ``${runs:${preset}}``. Those of a preset have a folder of their own."""
    return "runs" if preset == "full" else f"runs/{preset}"


def compose(command: str, overrides: Sequence[str] = (), *, hydra: bool = False) -> DictConfig:
    """The configuration of a command, inside or outside of a run of Hydra's.

    Args:
        command: such as ``"meta_train"``.
        overrides: in the language of the command line; of two for one key, the later one counts.
        hydra: include Hydra's own settings.
    """
    register_library()
    chosen = list({override_key(text): text for text in overrides}.values())
    if GlobalHydra.instance().is_initialized():
        return hydra_compose(command, chosen, return_hydra_config=hydra)
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return hydra_compose(command, chosen, return_hydra_config=hydra)


def override_key(override: str) -> str:
    """What an override is about: ``"a.b"`` of ``"+a.b=1"``."""
    return override.split("=", 1)[0].lstrip("+~")


def plain(config: DictConfig) -> dict[str, Any]:
    """A configuration as a dictionary, with its interpolations resolved."""
    return {str(k): v for k, v in OmegaConf.to_container(config, resolve=True).items()}  # type: ignore[union-attr]

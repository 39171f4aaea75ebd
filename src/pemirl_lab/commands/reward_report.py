r"""How close is a reward to the true one? One HTML page with figures.

    pemirl reward_report model_file=runs/my_run/model.safetensors
    pemirl reward_report transfer=true  # and what policies trained on it reach
    pemirl reward_report reward=my_module:my_reward
    pemirl reward_report reward=point_maze  # of the zoo, or a file of export_reward
    pemirl reward_report reward=my_module:my_reward true_reward=my_module:true_reward \
        env=my_module:make_env test_demonstrations=FILE run_dir=runs/report

``reward=`` is a file, or a function ``(observation [n, S], m [n, D]) -> [n]`` of tensors, or of
NumPy arrays with ``numbers=numpy``. Of a file, m is the mean of q(m | the task's one
demonstration); of a function it is what the task is (the goal) or, with ``encoder_file=FILE``, what
that file's q says. With ``env=`` it is an environment of your own, and ``true_reward`` a function
``(observation, task) -> [n]``.

Writes ``report.html``, one file that needs no other, and ``report.md`` with its figures and
``report.json`` to ``run_dir``. EPIC and maps are there where the true reward is a function of a
position (Point-Maze); EPIC also where it is given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field

import torch
from matplotlib.figure import Figure
from pydantic.dataclasses import dataclass
from tensordict import TensorDictBase

import pemirl_envs
from pemirl_lab.commands.adapt_reward import adapt
from pemirl_lab.measuring.candidates import Candidate, Numbers, of_model, of_name, on_rows
from pemirl_lab.measuring.learned_rewards import ReportConfig, coverage_of, grid, measure_reward
from pemirl_lab.measuring.own_rewards import measure_own_reward, own_coverage
from pemirl_lab.measuring.scores import Scorer, load_test_demonstrations
from pemirl_lab.pages.figures import reward_maps, reward_scatter, save_figure
from pemirl_lab.pages.reward_page import RewardPage
from pemirl_lab.runs.own_task import OwnTask, load_function, load_make_env
from pemirl_lab.runs.places import RunRefused, data_file, run_file
from pemirl_lab.runs.run_folder import RunFolder, say
from pemirl_lab.runs.settings import Settings
from pemirl_trl import DemonstrationDataset, PEMIRLModel
from pemirl_trl.configuration import CHECKED, Share
from pemirl_trl.evaluation import (
    RewardReport,
    distance_to_goal,
    evaluate_reward,
    map_of_reward,
)
from pemirl_trl.files import atomic_path
from pemirl_trl.pretrained import load_model

DRAWN_TASKS = 4
DRAWN_TRANSITIONS = 150  # per task, in a scatter plot
MAPS = "Maps of r, of f where there is one, and of the true reward; star: goal, circle: start."
SCATTER = "Rewards over true ones, each dot a transition."


@dataclass(frozen=True, config=CHECKED)
class Own:
    """What this command has of its own.

    Attributes:
        model_file: whose reward, where ``reward`` is not given.
        reward: ``module:function``, or the file or the zoo's name of a reward.
        encoder_file: of a function: whose q says what m is.
        numbers: of a function: whether it takes tensors or NumPy arrays.
        gamma: of a function: discount of the shaping that distances do not see.
        transfer: whether policies are trained on a model's reward, too.
        report: what is measured.
    """

    model_file: str
    reward: str | None = None
    encoder_file: str | None = None
    numbers: Numbers = "torch"
    gamma: Share = 0.99
    transfer: bool = False
    report: ReportConfig = field(default_factory=ReportConfig)


@dataclass(frozen=True, config=CHECKED)
class OwnEnvironment(OwnTask):
    """The values of this command with an environment of the user's own; as in :class:`Own`.

    Attributes:
        true_reward: ``module:function``, of observations and of what the task is.
        test_demonstrations: one of each task, with the tasks.
    """

    reward: str = field(kw_only=True)
    true_reward: str = field(kw_only=True)
    test_demonstrations: str = field(kw_only=True)
    encoder_file: str | None = None
    numbers: Numbers = "torch"
    gamma: Share = 0.99
    report: ReportConfig = field(default_factory=ReportConfig)

    def __post_init__(self) -> None:
        if self.settings:
            raise ValueError(f"unknown values {sorted(self.settings)}; see pemirl reward_report -h")


def run(settings: Settings, own: Own) -> RewardReport:
    """Measure, draw, and write the page.

    Raises:
        RunRefused: ``transfer`` of a reward that is no model's.
        ValueError: a reward that is none.
    """
    if own.transfer and own.reward is not None:
        raise RunRefused(
            "transfer=true trains policies of a model's sizes: give model_file=FILE instead of "
            f"reward={own.reward}"
        )
    folder = RunFolder.of(settings)
    folder.reads("test demonstrations", data_file(settings.test_demonstrations))
    demonstrations, model = load_test_demonstrations(settings), None
    if own.reward is None:
        model = load_model(folder.reads("model", run_file(own.model_file, "meta_train")))
        candidate = of_model(model, demonstrations, own.model_file)
    else:
        candidate = of_name(
            own.reward,
            demonstrations,
            encoder_file=own.encoder_file,
            numbers=own.numbers,
            gamma=own.gamma,
        )
    with folder.timed("report"):
        coverage = coverage_of(settings, own.report.episodes, candidate.context, demonstrations)
        report = measure_reward(settings, own.report, candidate, demonstrations, coverage)
    page = RewardPage(
        candidate,
        report,
        demonstrations,
        environment=settings.test_environment,
        coverage=_in_words(settings, own.report),
        features=own.report.features,
        figures=draw(settings, own.report, candidate, demonstrations, coverage),
        returns={} if model is None or not own.transfer else transfer(settings, folder, model),
    )
    write(page, folder)
    return report


def run_own(task: OwnEnvironment) -> RewardReport:
    """Measure on an environment of the user's own, and write the page."""
    make_env = load_make_env(task.env)
    data_path = data_file(task.test_demonstrations)
    demonstrations = task.demonstrations_in(data_path)
    demonstrations.tasks()  # raises before a folder is claimed where nobody knows them
    name = task.true_reward
    true = on_rows(load_function(name, "true_reward"), f"true_reward={name}", task.numbers)
    candidate = of_name(
        task.reward,
        demonstrations,
        encoder_file=task.encoder_file,
        numbers=task.numbers,
        gamma=task.gamma,
    )
    folder = task.folder()
    folder.reads("test demonstrations", data_path)
    with folder.timed("report"):
        episodes = task.report.episodes
        coverage = own_coverage(
            make_env, demonstrations, candidate, true, episodes=episodes, seed=task.seed
        )
        report, features = measure_own_reward(task.report, candidate, true, coverage, task.seed)
    count = len(demonstrations)
    chosen = list(range(min(DRAWN_TASKS, count)))
    page = RewardPage(
        candidate,
        report,
        demonstrations,
        environment=task.env,
        coverage={
            "random": f"{episodes} episodes of uniformly random actions, the same for all tasks",
            "demonstrated": "each task's demonstration",
            "mixed": "every second transition of both",
        },
        features=features,
        figures={"scatter.png": (_scatter(candidate, coverage, chosen, _titles(chosen)), SCATTER)},
    )
    write(page, folder)
    return report


def write(page: RewardPage, folder: RunFolder) -> None:
    """Write the page in both forms, its figures and its numbers."""
    for name, (figure, _) in page.figures.items():
        save_figure(figure, folder.file(f"figures/{name}"))
    folder.write_json("report.json", page.content())
    with atomic_path(folder.file("report.md")) as temporary:
        temporary.write_text(page.markdown(), encoding="utf-8")
    page.write_html(folder.file("report.html"))
    say(f"{page.report.markdown()}report -> {folder.file('report.html')}")


def draw(
    settings: Settings,
    report: ReportConfig,
    candidate: Candidate,
    demonstrations: DemonstrationDataset,
    coverage: Mapping[str, TensorDictBase],
) -> dict[str, tuple[Figure, str]]:
    """Rewards over the true one, of a few tasks; and their maps, where there are some."""
    if not settings.planar:
        chosen = list(range(min(DRAWN_TASKS, len(demonstrations))))
        figure = _scatter(candidate, coverage, chosen, _titles(chosen))
        return {"scatter.png": (figure, SCATTER)}
    goals = demonstrations.tasks()["goal"]
    spread = torch.linspace(0, len(goals) - 1, DRAWN_TASKS).round().long()
    chosen = goals[:, 0].argsort()[spread].tolist()  # spread over the range of goals
    titles = [f"goal x = {float(g[0]):.2f} m" for g in goals[chosen]]
    bounds, positions = grid(settings, report.resolution)
    plan = pemirl_envs.layout(settings.test_environment)
    like = coverage["random"][chosen]
    maps = {k: map_of_reward(r, like, positions) for k, r in candidate.rewards.items()}
    figure = reward_maps(
        maps["r"],
        -distance_to_goal(positions, goals[chosen]),
        bounds,
        goals[chosen],
        shaped=maps.get("f"),
        start=plan.start,
        segments=list(plan.walls.values()),
        demonstrations=demonstrations[chosen].observation,
        titles=titles,
    )
    scatter = _scatter(candidate, coverage, chosen, titles)
    return {"reward_maps.png": (figure, MAPS), "scatter.png": (scatter, SCATTER)}


def _scatter(
    candidate: Candidate,
    coverage: Mapping[str, TensorDictBase],
    chosen: Sequence[int],
    titles: Sequence[str],
) -> Figure:
    learned, true = {}, {}
    for name, batch in coverage.items():
        every = max(1, batch.shape[1] // DRAWN_TRANSITIONS)
        some = batch[list(chosen)][:, ::every]
        learned[name] = evaluate_reward(candidate.rewards["r"], some)
        true[name] = some["next", "reward"].squeeze(-1)
    return reward_scatter(learned, true, titles)


def _titles(chosen: Sequence[int]) -> list[str]:
    return [f"task {i}" for i in chosen]


def _in_words(settings: Settings, report: ReportConfig) -> dict[str, str]:
    """What each coverage distribution is."""
    count = report.episodes * pemirl_envs.get_task(settings.test_environment).horizon
    words = {
        "random": f"{count} transitions of uniformly random actions, per task",
        "expert": "as many of the expert trained on the true reward, on its mean actions",
        "mixed": "every second one of both",
    }
    if settings.planar:
        words["map"] = (
            f"a grid of {report.resolution} x {report.resolution} states at rest (s' = s, no "
            "action), against minus the distance to the goal"
        )
    return words


def transfer(
    settings: Settings, folder: RunFolder, model: PEMIRLModel
) -> dict[str, dict[str, float]]:
    """True returns of policies trained on r: under the training dynamics, and under changed ones.

    Each beside the expert's and random actions'; means over tasks.
    """
    scorer, table = Scorer(settings, load_test_demonstrations(settings)), {}
    where = {"self-transfer": settings.environment, "shift": settings.test_environment}
    for kind, name in where.items():
        policy, _ = adapt(settings, folder, model, environment_name=name, stage=kind)
        returns = {
            "random": scorer.references(name)["random"],
            "expert": scorer.references(name)["expert"],
            "learned reward": scorer.returns(name, model, policy),
        }
        table[f"{kind} ({name})"] = {k: float(v.mean()) for k, v in returns.items()}
    return table

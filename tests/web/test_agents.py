"""Agents in the playground act as in Python: the same runs to the bit, or the same choices."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

from surface_gym.agents import library
from surface_gym.agents.export.web import read_run, write_agents, write_run
from surface_gym.agents.library import PolicyCard, save_policy
from surface_gym.agents.rules import find_rules
from surface_gym.agents.rules.base import CompiledRule
from surface_gym.agents.rules.departures import HoldAndRelease, PassAndPark, TimeSlots
from surface_gym.agents.rules.patterns import Patterns, PatternsInOrder
from surface_gym.agents.rules.sorting import BestSorting, SortEach, StreamEventRule
from surface_gym.agents.slope_policy import LocalNetwork, ParcelNetwork
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.registration import TASKS, env_id
from surface_gym.sensors import Camera, Exact
from surface_gym.tasks import TASKS as ONE_PARCEL
from surface_gym.web.scene import TaskScene
from tests.environments import ON_SLOPES
from tests.web.conftest import Site, check_script, end_in_page, end_in_python, open_sort, wait_for

PERIODS = 300
REACTING = [  # the page has no quadrants
    rule for task in ONE_PARCEL for rule in find_rules(task)
    if isinstance(rule.make, type) and issubclass(rule.make, CompiledRule)
    and rule.actions != "quadrants"
]  # fmt: skip
RULES = [
    ("singulate", "time slots", TimeSlots),
    ("singulate", "hold and release", HoldAndRelease),
    ("merge", "time slots", TimeSlots),
    ("sequence", "pass and park", PassAndPark),
    ("singulate", "patterns", Patterns),
    ("sequence", "patterns", PatternsInOrder),
]
SIZE, SIDE = 6, 14  # columns of what is seen in Sort
TIE = 1e-4  # of two shares that rounding may tell apart either way


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The agents that ship, and one per module of each task on a slope, whose weights are drawn."""
    folder = tmp_path_factory.mktemp("shelf")
    shutil.copytree(library.SHELF, folder, dirs_exist_ok=True)
    torch.manual_seed(0)
    for task in ON_SLOPES:
        card = PolicyCard(env_id(task), "local", "modules", 0.04, (16,))
        save_policy(
            LocalNetwork(4, card.hidden).state_dict(), card, folder / f"{task}-drawn" / "seed-0"
        )
        (folder / f"{task}-drawn" / "card.yaml").write_text("command: none\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(library, "SHELF", folder)
        yield folder


@pytest.fixture(scope="module")
def written(site: Site, shelf: Path) -> set[str]:
    """The tasks whose agents are beside the pages."""
    assert shelf == library.SHELF
    (site.folder / "agents.json").unlink(missing_ok=True)
    return set()


@pytest.fixture
def agents(site: Site, written: set[str], play: Any) -> Any:
    """Open the playground at a scene of a task, which has all agents there are."""

    def opened(scene: TaskScene) -> Any:
        site.add("sort", scene.task, *([f"{scene.task}-camera"] if scene.camera else []))
        if scene.task not in written:
            write_agents(site.folder)
            written.add(scene.task)
        return play(address=scene.url())

    return opened


def test_policies_and_layouts_act_in_the_page_as_in_python(agents):
    page = agents(TaskScene("sort"))
    wait_for(page, "playground.agents.names('sort').includes('sort-dqn')")
    for name in ("sort-ppo", "sort-dqn", "sort-modules", "best fixed layout"):
        is_policy = name.startswith("sort-")
        actions = "halves" if name in ("sort-ppo", "sort-dqn") else "modules"
        env = gym.make("SmartSurface/Sort-v0", actions=actions)
        agent = library.load(name) if is_policy else BestSorting(EnvConfig("sort"))
        for seed in (0, 1, 5):
            assert end_in_page(page, name, seed) == end_in_python(env, agent, seed)


LABS = [name for name in library.names() if library.load(name).card.observe]


@pytest.mark.parametrize("name", LABS)
def test_a_policy_of_the_lab_sees_axes_and_outline_and_acts_as_in_python(agents, name):
    policy = library.load(name)
    card = policy.card
    page = agents(TaskScene(card.task, agent=name))
    env = gym.make(card.env_id, actions=card.actions, observe=card.observe)
    for seed in (0, 3):
        assert end_in_page(page, name, seed) == end_in_python(env, policy, seed)


@pytest.mark.parametrize("rule", REACTING, ids=lambda rule: f"{rule.task}: {rule.name}")
@pytest.mark.parametrize("sensors", [Exact(), Camera()], ids=["exact", "camera"])
def test_a_rule_runs_as_in_python(agents, rule, sensors):
    page = agents(TaskScene(rule.task, agent=rule.name, camera=isinstance(sensors, Camera)))
    wait_for(page, f"playground.shown[0].name === '{rule.name}'")
    env = gym.make(env_id(rule.task), actions=rule.actions, sensors=sensors)
    agent = rule.make(EnvConfig(rule.task, actions=rule.actions, sensors=sensors))
    for seed in (0, 3):
        assert end_in_page(page, rule.name, seed) == end_in_python(env, agent, seed)


def test_agents_act_side_by_side_and_the_keyboard_takes_over(play):
    page = open_sort(play)
    page.select_option("#agent", "all at 45°")
    page.select_option("#beside", "all at \N{MINUS SIGN}45°")
    wait_for(page, "playground.shown.length === 2")
    page.click("#start")
    wait_for(page, "playground.shown.every(({ run }) => run.over)")
    ends = page.evaluate("playground.shown.map(({ run }) => run.over)")
    assert set(ends) == {"wrong side", "success"}
    page.click("#again")
    page.click("#step")
    page.locator("canvas").first.focus()
    page.keyboard.press("1")
    page.click("#step")
    page.click("#step")
    assert page.input_value("#agent") == "you"
    axes = page.evaluate("playground.shown.map(({ run }) => [...run.frame().axes])")
    assert axes[0].count(0) == 32
    assert axes[1].count(0) == 0


def run_in_python(task: str, agent: Any, seed: int, **arguments: Any) -> list[float]:
    """Run an agent that decides for each parcel; return the reward, the time, what was counted,
    and where the parcels are that are there.
    """
    actions = getattr(agent, "acts_by", "parcels")
    env = gym.make(env_id(task), actions=actions, **arguments)
    table, info = env.reset(seed=seed)
    rewards, state = 0.0, None
    for _ in range(PERIODS):
        action, state = agent.predict(table, state)
        table, reward, terminated, _, info = env.step(action)
        rewards += float(reward)
        if terminated:  # parcels have jammed
            break
    assert info["correct"] > 0
    batch = env.unwrapped.batch
    tally = [info[each] for each in ("entered", "correct", "wrong", "touches")]
    return [rewards, info["time"], *tally, *batch.parcels.truth[batch.streams.present[0]].flat]


def run_in_page(page: Any) -> list[float]:
    found: list[float] = page.evaluate(
        """(periods) => {
          const { run } = playground.shown[0];
          playground.pause();
          while (run.period < periods && !run.over) run.advance();
          const there = run.machine.view("streams.present");
          const truth = [...run.machine.view("parcels.truth")];
          const tally = [...run.machine.view("streams.tally")].slice(0, 4).map(Number);
          return [run.rewards, run.time, ...tally,
            ...truth.filter((_, k) => there[Math.floor(k / 6)])];
        }""",
        PERIODS,
    )
    return found


@pytest.mark.parametrize("name", ["event rule", "sort-ppo"])
def test_modules_of_a_stream_obey_the_parcels_as_in_python(agents, name):
    config = EnvConfig("flow", actions="parcels")
    rule = StreamEventRule(config) if name == "event rule" else SortEach(config)
    page = agents(TaskScene("flow", 2, name))
    assert run_in_page(page) == run_in_python("flow", rule, 2)


@pytest.mark.parametrize(("task", "name", "rule"), RULES)
def test_a_rule_on_a_slope_runs_as_in_python_again_too(agents, task, name, rule):
    page = agents(TaskScene(task, 2, name))
    wanted = run_in_python(task, rule(EnvConfig(task, actions=rule.acts_by)), 2)
    assert len(wanted) > 6 + 6 * 2  # some parcels are on their way
    assert run_in_page(page) == wanted
    page.click("#again")
    assert run_in_page(page) == wanted


def test_a_rule_on_a_slope_leaves_a_wider_gap_where_a_camera_errs(agents):
    page = agents(TaskScene("merge", 2, "time slots", camera=True))
    rule = TimeSlots(EnvConfig("merge", actions="parcels", sensors=Camera()))
    assert run_in_page(page) == run_in_python("merge", rule, 2, sensors=Camera())


def watch(page: Any, chosen: str) -> list[tuple[list[float], list[int]]]:
    """Run the page's scene; list each table, and what was chosen by it, by an expression."""
    seen: list[tuple[list[float], list[int]]] = page.evaluate(
        f"""(periods) => {{
          const {{ run }} = playground.shown[0];
          const seen = [];
          playground.pause();
          while (run.period < periods && !run.over) {{
            const table = [...run.machine.view("parcels.observation")];
            run.advance();
            seen.push([table, [...{chosen}]]);
          }}
          return seen;
        }}""",
        PERIODS,
    )
    return seen


def assert_parcels_chosen(page: Any, policy: Any, config: EnvConfig) -> None:
    """Assert that the page's policy of parcels chooses as one does in Python."""
    state, compared = None, 0
    options = len(config.chosen_orientations)
    for numbers, chosen in watch(page, "run.agent.chosen"):
        table = np.array(numbers, dtype=np.float32).reshape(config.rows, -1)
        action, state = policy.predict(table, state)
        there = table[:, ta.COLUMN.present.place] > 0.5
        ours, theirs = action.reshape(-1, 2)[there], np.array(chosen).reshape(-1, 2)[there]
        compared += len(ours)
        if (ours != theirs).any():  # rounding has tipped one, and what follows is another run
            due = state.due[0, there]
            each, place = np.arange(len(ours)), np.array([options, 1])
            owed = [due[each, ours @ place] + 1.0, due[each, theirs @ place]]
            assert ((owed[0] - owed[1])[(ours != theirs).any(axis=1)] < TIE).all()
            break
    assert compared > 300


def assert_modules_chosen(page: Any, policy: Any, config: EnvConfig) -> None:
    """Assert that the page's policy of modules on a slope chooses as one does in Python."""
    tables, chosen = zip(*watch(page, "run.wanted"), strict=True)
    seen = np.array(tables, dtype=np.float32).reshape(len(tables), config.rows, -1)
    actions, _ = policy.predict(seen)
    moved = (actions != 3).sum()
    assert moved > 1000
    assert (actions != np.array(chosen)).sum() <= TIE * moved


@pytest.mark.parametrize("task", ON_SLOPES)
def test_a_policy_of_parcels_chooses_as_in_python(agents, task):
    config = EnvConfig(task, actions="parcels")
    page = agents(TaskScene(task, 2, f"{task}-parcels"))
    assert_parcels_chosen(page, library.load(f"{task}-parcels", config=config), config)


@pytest.mark.parametrize("task", ON_SLOPES)
def test_a_policy_of_modules_chooses_as_in_python(agents, task):
    page = agents(TaskScene(task, 2, f"{task}-drawn"))
    config = EnvConfig(task)
    assert_modules_chosen(page, library.load(f"{task}-drawn", config=config), config)


@pytest.mark.parametrize("kind", ["parcels", "local"])
def test_a_run_on_a_slope_acts_as_in_python(agents, site, tmp_path, kind):
    page, run = agents(TaskScene("merge")), tmp_path / "my 2nd run, #7 (100%)"
    assert_chosen, actions = {
        "parcels": (assert_parcels_chosen, "parcels"),
        "local": (assert_modules_chosen, "modules"),
    }[kind]
    network: torch.nn.Module = LocalNetwork(4, (8,))
    config = EnvConfig("merge", actions=actions)
    if kind == "parcels":
        network = ParcelNetwork(config.features, 4, (8,))
        torch.nn.init.normal_(network.actor[-1].weight)
    card = PolicyCard(env_id("merge"), kind, actions, 0.04, (8,))
    for seed in (3, 4):
        save_policy(network.state_dict(), card, run / f"seed-{seed}")
    beside = tmp_path / "beside"
    beside.mkdir()
    policy = read_run(run, None)
    assert write_run(run, policy, None, None, beside, site.folder) == ("merge", run.name)
    shutil.copytree(beside, site.folder, dirs_exist_ok=True)
    page.goto("about:blank")
    page.goto(site.address + TaskScene("merge", 2, run.name).url())
    wait_for(page, f"globalThis.playground?.shown[0]?.name === {json.dumps(run.name)}")
    files = library.read_files(run / "seed-3")
    assert_chosen(page, library.from_files(files, config=config), config)


def test_a_policy_of_sort_s_modules_chooses_as_in_python_for_both_parcels_and_sides(agents):
    policy, page = library.load("sort-modules"), agents(TaskScene("sort"))
    wait_for(page, "playground.agents.names('sort').includes('sort-modules')")
    decided, apart, starts = 0, 0, set()
    for seed in range(12):
        page.evaluate(f"playground.reopen({{ seed: {seed}, agent: 'sort-modules' }})")
        tables, chosen = zip(*watch(page, "run.wanted"), strict=True)
        seen = np.array(tables, dtype=np.float32)
        actions, _ = policy.predict(seen[:, : len(TASKS["sort"]().features)])
        starts.add((seen[0, SIZE], seen[0, SIDE]))
        decided += int((actions != 3).sum())
        apart += int((actions != np.array(chosen)).sum())
    assert len(starts) == 4
    assert decided > 2000
    assert apart <= TIE * decided


@pytest.mark.parametrize("task", ON_SLOPES)
def test_an_agent_is_loaded_as_it_is_chosen_and_its_script_gives_the_same_run(agents, task):
    page = agents(TaskScene(task, 1))
    asked: list[str] = []
    page.on("request", lambda each: asked.append(each.url.rpartition("/")[2]))
    page.select_option("#agent", f"{task}-parcels")
    wait_for(page, f"playground.shown[0].name === '{task}-parcels'")
    assert f"agent-{task}-parcels.bin" in asked
    assert f"agent-{task}-drawn.bin" not in asked
    page.select_option("#beside", f"{task}-drawn")
    wait_for(page, "playground.shown.length === 2")
    assert f"agent-{task}-drawn.bin" in asked
    page.evaluate(
        """() => {
          for (let k = 0; k < 60; k++) for (const { run } of playground.shown) run.advance();
          const [{ run }] = playground.shown;
          playground.turn(run, run.modules().slice(0, 40), 0);
          for (let k = 0; k < 10; k++) run.advance();
          playground.isStale = true;
        }"""
    )
    assert page.evaluate("playground.shown.map(({ name }) => name)") == ["you", f"{task}-drawn"]
    check_script(page)


def test_without_agents_a_task_on_a_slope_has_the_player_and_layouts(site, written, play):
    written.clear()
    (site.folder / "agents.json").unlink(missing_ok=True)
    page = play("merge")
    page.select_option("#task", "merge")
    wait_for(page, "playground.scene.task === 'merge'")
    names = page.locator("#agent option").all_inner_texts()
    assert names[0] == "you"
    assert all(name.startswith("all at") for name in names[1:])

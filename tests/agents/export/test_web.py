"""Agents for the playground: their files hold the networks and the layouts, for tasks there are."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from surface_gym.agents import library
from surface_gym.agents.export import web
from surface_gym.agents.export.policy import NetworkDecision, network_decision, shipped
from surface_gym.agents.export.web import main
from surface_gym.agents.library import save_policy
from surface_gym.agents.module_policy import make_actor
from surface_gym.agents.policy import make_network
from surface_gym.agents.rules import find_rules
from surface_gym.agents.rules.sorting import BestSorting
from surface_gym.agents.scheduling.leading import schedule
from surface_gym.compiler.wasm import Module
from surface_gym.compiler.wasm_image import BASE, compute_signature, name_arguments
from surface_gym.config import EnvConfig
from surface_gym.env import SmartSurfaceEnv, make_batch
from surface_gym.flow.batch import StreamBatch, stream_functions
from surface_gym.flow.kernel import make_assigning_kernel
from surface_gym.flow.state import NOBODY
from surface_gym.tasks import TASKS
from surface_gym.web.build import make_config
from tests.environments import STREAMS


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("site")
    (made / "site.json").write_text('{"tasks": ["sort", "flow", "merge"], "agents": false}')
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(web, "compile_module", write_nothing)
        main([str(made)])
    return made


def write_nothing(kernel: Any, arguments: tuple[Any, ...], file: Path) -> Module:
    """Write a module without code."""
    assert callable(kernel)
    assert arguments
    file.touch()
    return Module(b"", "")


def test_it_has_the_agents_of_the_site_s_tasks(folder):
    assert json.loads((folder / "site.json").read_text())["agents"]
    agents = json.loads((folder / "agents.json").read_text())
    assert list(agents) == ["sort", "flow", "merge"]
    assert set(agents["flow"]["streams"]) == {"event rule", "sort-ppo"}
    of_sort = {name for name in library.names() if library.load(name).card.task == "sort"}
    assert set(agents["sort"]["policies"]) == of_sort
    assert set(agents["sort"]["layouts"]) == {"best fixed layout"}
    assert json.loads((folder / "home.json").read_text())["obeying"] == agents["flow"]["obeying"]


def assert_holds(folder: Path, name: str, decision: NetworkDecision) -> None:
    """Assert that a folder's agents hold a decision, by the name of its agent."""
    card = json.loads((folder / "agents.json").read_text())["sort"]["policies"][name]
    weights = np.fromfile(folder / "agents.bin", "<f4").astype(np.float64)
    values = seen = np.random.default_rng(0).uniform(-1.0, 1.0, decision.features)
    for k, (inputs, outputs, place) in enumerate(card["layers"]):
        if k:
            values = np.tanh(values) if card["activation"] == "tanh" else np.maximum(values, 0.0)
        matrix = weights[place : place + inputs * outputs].reshape(outputs, inputs)
        values = matrix @ values + weights[place + matrix.size : place + matrix.size + outputs]
    assert values == pytest.approx(decision.network.scores(seen), abs=1e-12)
    assert decision.symmetry is not None
    assert card["mirror"] == decision.symmetry.images.tolist() == [0, 2, 1, 3]


@pytest.mark.parametrize("name", ["sort-ppo", "sort-dqn"])
def test_the_weights_are_those_of_the_policy(folder, name):
    assert_holds(folder, name, network_decision(shipped(name)))


def test_the_weights_of_a_policy_of_modules_give_its_logits(folder):
    card = json.loads((folder / "agents.json").read_text())["sort"]["policies"]["sort-modules"]
    weights = np.fromfile(folder / "agents.bin", "<f4")
    network = library.load("sort-modules")._network
    seen = np.random.default_rng(0).uniform(-1.0, 1.0, (5, card["layers"][0][0]))
    values = seen.astype(np.float32)
    for k, (inputs, outputs, place) in enumerate(card["layers"]):
        matrix = weights[place : place + inputs * outputs].reshape(outputs, inputs)
        values = np.tanh(values) if k else values
        values = values @ matrix.T + weights[place + matrix.size : place + matrix.size + outputs]
    split = len(card["shared"])
    shared, own = (torch.from_numpy(seen[:, part].astype(np.float32)) for part in
                   (slice(split), slice(split, None)))  # fmt: skip
    with torch.no_grad():
        wanted = network.log_probability(shared, torch.arange(5), own)
    found = torch.from_numpy(values).log_softmax(dim=1)
    np.testing.assert_allclose(found, wanted, atol=1e-5)
    assert card["mirror"] == [0, 2, 1, 3]
    assert card["rest"] == 3


def write_run(run: Path, name: str | None, task: str | None, *folders: Path) -> tuple[str, str]:
    return web.write_run(run, web.read_run(run, task), name, task, *folders)


def test_the_policy_of_a_run_joins_those_of_the_package(folder, tmp_path):
    run, beside = tmp_path / "mine", tmp_path / "beside"
    shutil.copytree(library.SHELF / "sort-dqn", run)
    beside.mkdir()
    assert write_run(run, None, None, beside, folder) == ("sort", "mine")
    for name, mine in (("mine", "sort-dqn"), ("sort-ppo", "sort-ppo")):
        assert_holds(beside, name, network_decision(shipped(mine)))
    site = json.loads((beside / "site.json").read_text())
    assert site == {"tasks": ["sort", "flow", "merge"], "agents": True}


def test_a_run_of_sort_s_modules_has_the_card_of_the_one_that_ships(folder, tmp_path):
    run = tmp_path / "mine"
    shutil.copytree(library.SHELF / "sort-modules", run)
    assert write_run(run, "sort", "sort", tmp_path, folder) == ("sort", "mine")
    policies = json.loads((tmp_path / "agents.json").read_text())["sort"]["policies"]
    numbers = np.fromfile(tmp_path / "agents.bin", "<f4")
    mine, shipped_card = policies["mine"], policies["sort-modules"]
    for one, other in zip(mine.pop("layers"), shipped_card.pop("layers"), strict=True):
        assert one[:2] == other[:2]
        size = (one[0] + 1) * one[1]
        assert (numbers[one[2] :][:size] == numbers[other[2] :][:size]).all()
    assert mine == shipped_card


@pytest.mark.parametrize("name", ["merge-parcels", "merge-local"])
def test_a_run_on_a_slope_has_the_card_and_the_weights_of_one_that_ships(
    folder, tmp_path, monkeypatch, name
):
    monkeypatch.setattr(web, "compile_module", write_nothing)
    run, beside = tmp_path / "my run #1", tmp_path / "beside"
    shutil.copytree(library.SHELF / name, run)
    beside.mkdir()
    assert write_run(run, None, "merge", beside, folder) == ("merge", "my run #1")
    before, after = (json.loads((each / "agents.json").read_text()) for each in (folder, beside))
    card = after["merge"]["streams"].pop("my run #1")
    assert after == before
    shipped_card = before["merge"]["streams"][name]
    assert card == {**shipped_card, "weights": "agent-run.bin"}
    weights = (folder / shipped_card["weights"]).read_bytes()
    assert (beside / card["weights"]).read_bytes() == weights
    assert (beside / "agents.bin").read_bytes() == (folder / "agents.bin").read_bytes()
    for made in (f"{card['code']}.wasm", f"{card['machine']}.bin", f"{card['machine']}.json"):
        assert (beside / made).read_bytes() == (folder / made).read_bytes()


def test_a_run_acts_before_the_package_s_agents_are_written(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(web, "compile_module", write_nothing)
    package, beside = tmp_path / "package", tmp_path / "beside"
    for each in (package, beside):
        each.mkdir()
    shutil.copy(folder / "site.json", package)
    write_run(library.SHELF / "merge-parcels", None, None, beside, package)
    agents = json.loads((beside / "agents.json").read_text())
    assert set(agents["merge"]) == {"obeying", "streams"}
    card = agents["merge"]["streams"]["merge-parcels"]
    for code in (agents["merge"]["obeying"]["code"], card["code"]):
        assert (beside / f"{code}.wasm").is_file()


@pytest.mark.parametrize(
    ("name", "task", "said"),
    [
        ("sort-ppo", "stop", "task must be the run's, 'sort', got 'stop'"),
        ("merge-local", "sequence", "task must be the run's, 'merge', got 'sequence'"),
        ("flow-schedule", "flow", "run must hold a policy of parcels, .*, got schedule, parcels"),
    ],
)
def test_a_run_that_the_page_cannot_show_is_refused(folder, tmp_path, name, task, said):
    with pytest.raises(ValueError, match=said):
        write_run(library.SHELF / name, task, task, tmp_path, folder)
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_observes_one_group_finds_it_among_all_that_the_page_shows(folder, tmp_path):
    card = replace(library.load("sort-ppo").card, observe=("load",), hidden=(8,))
    config = card.env_config()
    save_policy(make_network(card, config).state_dict(), card, tmp_path / "run")
    write_run(tmp_path / "run", None, None, tmp_path, folder)
    agents = json.loads((tmp_path / "agents.json").read_text())
    shown = make_config("sort").features
    columns = agents["sort"]["policies"]["run"]["columns"]
    assert [shown[column] for column in columns] == list(config.features)
    assert columns != list(range(len(columns)))


@pytest.mark.parametrize(
    ("name", "other", "said"),
    [
        ("sort-modules", {"observe": ("parcel",), "hidden": (8,)},
         r"run must hold .*, got modules, modules, \['parcel'\]"),
        ("merge-parcels", {"control_period": 0.02}, r"control_period must be 0\.04 s.*, got 0\.02"),
    ],
)  # fmt: skip
def test_a_run_that_sees_more_or_decides_more_often_than_the_page_is_refused(
    folder, tmp_path, name, other, said
):
    policy = library.load(name)
    card = replace(policy.card, **other)
    network: Any = policy._network
    if "hidden" in other:
        network = make_actor(card.env_config(), card.hidden)
    save_policy(network.state_dict(), card, tmp_path / "run")
    with pytest.raises(ValueError, match=said):
        write_run(tmp_path / "run", None, None, tmp_path, folder)


def test_a_layout_is_what_the_rule_chooses_at_the_seed_s_start(folder):
    layouts = json.loads((folder / "agents.json").read_text())["sort"]["layouts"][
        "best fixed layout"
    ]
    env, rule = SmartSurfaceEnv("sort"), BestSorting(EnvConfig("sort"))
    assert len(layouts) == 20
    for seed in (0, 7):
        wanted, _ = rule.predict(env.reset(seed=seed)[0])
        choices = [choice for choice, many in layouts[seed] for _ in range(many)]
        assert choices == wanted.tolist()


def test_agents_on_a_slope_are_the_rules_and_those_that_ship_each_with_its_files(folder):
    agents = json.loads((folder / "agents.json").read_text())["merge"]
    assert (folder / f"{agents['obeying']['code']}.wasm").is_file()
    learned = [each for each in library.names() if each.startswith("merge-")]
    assert "merge-parcels" in learned
    assert list(agents["streams"]) == ["time slots", "hold and release", "patterns", *learned]
    for name, card in agents["streams"].items():
        assert card["kind"] == "rule" or card["weights"] == f"agent-{name}.bin"
        layout = json.loads((folder / f"{card['machine']}.json").read_text())
        assert layout["bytes"] == (folder / f"{card['machine']}.bin").stat().st_size
        assert (folder / f"{card['code']}.wasm").is_file()


@pytest.mark.parametrize("task", STREAMS)
def test_modules_obey_the_same_where_all_is_of_another_run_but_what_is_copied(task):
    run, other = (begin_stream(task, seed) for seed in (2, 5))
    kernel = make_assigning_kernel(stream_functions(run.config))
    rng, owned = np.random.default_rng(0), 0
    for period in range(300):
        turned = rng.random(run.surfaces.command.shape) < 0.05
        run.step(np.where(turned, rng.integers(0, 3, turned.shape), 3))
        if period % 30:
            continue
        copied = name_arguments(kernel, other.arguments)
        for name, values in name_arguments(kernel, run.arguments).items():
            if name in web.OBEYING_READS:
                copied[name][:] = values
        for each in (run, other):
            kernel(*each.arguments)
        assert (run.streams.owner == other.streams.owner).all()
        owned += int((run.streams.owner != NOBODY).sum())
    assert owned > 100


def begin_stream(task: str, seed: int) -> StreamBatch:
    batch = make_batch(EnvConfig(task, actions="parcels"), 1)
    assert isinstance(batch, StreamBatch)
    batch.seed(0, np.random.default_rng(seed))
    batch.place_drawn(np.arange(1))
    return batch


def test_weights_of_an_agent_on_a_slope_are_those_of_its_layers_and_no_more(folder):
    card = json.loads((folder / "agents.json").read_text())["merge"]["streams"]["merge-parcels"]
    weights = np.fromfile(folder / card["weights"], "<f4")
    network = library.load("merge-parcels")._network.state_dict()
    layers = [*card["encoder"], *card["actor"], card["attend"], card["pair"]]
    names = ["encoder.0", "encoder.2", "actor.0", "actor.2", "attend", "pair"]
    for name, (inputs, outputs, place) in zip(names, layers, strict=True):
        matrix, bias = (network[f"{name}.{each}"].numpy() for each in ("weight", "bias"))
        assert matrix.shape == (outputs, inputs)
        found = weights[place : place + matrix.size + bias.size]
        assert found.tolist() == [*matrix.ravel().tolist(), *bias.tolist()]
    assert weights.size == sum((inputs + 1) * outputs for inputs, outputs, _ in layers)


def test_a_folder_without_a_site_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main([str(tmp_path)])
    said = f"folder must be one that `surface-gym web` has written, got {tmp_path}"
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("task", TASKS)
def test_every_rule_of_a_task_acts_in_the_page_unless_it_searches(task, tmp_path, monkeypatch):
    monkeypatch.setattr(web, "write_machine", lambda code, *_: {"code": code})
    there = {**web.write_rules(task, tmp_path), **web.find_layouts(task, seeds=1)}
    rules = find_rules(task)
    wanted = {each.name for each in rules if not each.searches and each.actions != "quadrants"}
    # All modules at 90 deg, which is a layout of Track, are there of every task.
    assert wanted - set(there) == ({"fixed layout"} if task == "track" else set())


def test_code_of_streams_is_of_one_function(tmp_path, monkeypatch):
    """Tasks share files of code, also tasks whose rules have one name and other functions."""
    written = {}

    def note(code, name, kernel, *_):
        assert written.setdefault(code, kernel) is kernel, name
        return {"code": code}

    monkeypatch.setattr(web, "write_machine", note)
    cards = {task: web.write_rules(task, tmp_path) for task in STREAMS}
    codes = [cards[task]["patterns"]["code"] for task in ("singulate", "merge", "sequence")]
    assert codes[0] == codes[1] != codes[2]


def test_a_card_says_which_numbers_are_others_with_a_camera(tmp_path: Path):
    rule = {each.name: each for each in find_rules("slow")}["braking rule"]
    card = json.loads(json.dumps(web.write_rule(rule, tmp_path)))
    assert card == {
        "kind": "rule", "code": "agent-slow-braking-rule", "machine": "agent-slow-braking-rule",
        "camera": {"model.noise": 0.01},
    }  # fmt: skip
    layout = json.loads((tmp_path / f"{card['machine']}.json").read_text())
    assert layout["bytes"] == (tmp_path / f"{card['machine']}.bin").stat().st_size
    assert (tmp_path / f"{card['code']}.wasm").stat().st_size < 40_000


@pytest.fixture(scope="module")
def layout(folder):
    return json.loads((folder / "home.json").read_text())


def test_the_module_of_flow_steps_it(layout):
    upper, flow = web.make_home_config(web.find_methods()[0]), EnvConfig("flow")
    batch, plain = web.place_stream(upper), make_batch(flow, 1, compiles=False)
    assert batch.make_kernel() is plain.make_kernel()
    named = name_arguments(plain.make_kernel(), plain.arguments)
    assert layout["signature"] == compute_signature(named)


def test_both_lines_have_the_same_boxes_of_all_kinds_for_all_exits(folder, layout):
    block = (folder / "home.bin").read_bytes()
    assert len(block) == layout["bytes"]
    for method in web.find_methods():
        streams = web.place_stream(web.make_home_config(method)).streams
        for name in ("time", "body", "exit", "start"):
            _, _, address = layout["fields"][f"streams.{name}"]
            there = getattr(streams, name).tobytes()
            assert block[address - BASE : address - BASE + len(there)] == there
        kinds = np.stack([streams.body[0], streams.exit[0]], axis=1)
        assert len(kinds) == web.BOXES
        assert len(np.unique(kinds, axis=0)) == 2 * 3
    assert [mark["label"] for mark in layout["starts"]["marks"][0]] == ["left", "right", "straight"]


def test_the_memories_are_those_of_the_comparison_s_schedulers(folder, layout):
    assert [card["byGroups"] for card in layout["lines"]] == [True, False]
    for card, scheduler in zip(layout["lines"], web.make_schedulers(), strict=True):
        block = (folder / f"{card['machine']}.bin").read_bytes()
        fields = json.loads((folder / f"{card['machine']}.json").read_text())["fields"]
        named = name_arguments(schedule, scheduler.start_arguments())
        assert list(fields) == list(named)
        for name in ("orders.gaps", "orders.delay", "orders.options", "way.place", "way.spans"):
            kind, shape, address = fields[name]
            values = np.frombuffer(block, kind, np.prod(shape, dtype=int), address - BASE)
            np.testing.assert_array_equal(values.reshape(shape), named[name])

"""The command, what it writes, and what it refuses."""

import json
import sys

import numpy as np
import pytest

from surface_gym.agents.export.check import find_compiler
from surface_gym.agents.export.cli import ExportConfig, export, main, make_metadata, make_model
from surface_gym.agents.export.page import UNKNOWN, find_need, make_page
from surface_gym.agents.export.policy import TRAINED_IN, Training, network_decision, of_run, shipped
from surface_gym.agents.learning.config import RENAMED, PPOConfig
from surface_gym.agents.learning.runs import write_config
from surface_gym.agents.policy import save_policy
from surface_gym.config import EnvConfig
from surface_gym.core.actions import GROUPS, group_features
from surface_gym.tasks import TASKS
from surface_gym.tasks.base import Feature
from tests.agents.export.made import CARDS, made, network_of


def test_it_writes_three_files_that_it_has_checked(tmp_path, capsys) -> None:
    onnx = pytest.importorskip("onnx", reason="onnx, of the extra `export`, is missing")
    runtime = pytest.importorskip(
        "onnxruntime", reason="onnxruntime, of the extra `export`, is missing"
    )
    main(["sort-ppo", "--seed", "1", "--out", str(tmp_path), "--observations", "400"])
    printed = "".join(capsys.readouterr().out.split())
    assert "ONNX:400observations,800choices:thesame" in printed
    assert ("C:nottried" in printed) == (find_compiler() is None)
    names = {file.name for file in tmp_path.iterdir()}
    assert names == {"sort-ppo.onnx", "sort-ppo.h", "sort-ppo.md"}
    model = onnx.load(tmp_path / "sort-ppo.onnx")
    says = {each.key: each.value for each in model.metadata_props}
    source = shipped("sort-ppo", 1)
    assert says == make_metadata(source)
    assert (says["agent"], says["seed"], says["control_period"]) == ("sort-ppo", "1", "0.04")
    assert json.loads(says["orientations"]) == list(source.config.chosen_orientations)
    assert json.loads(says["features"])[14] == "side"
    assert source.digest in (tmp_path / "sort-ppo.h").read_text()
    assert [each.version for each in model.opset_import] == [17]
    session = runtime.InferenceSession(
        tmp_path / "sort-ppo.onnx", providers=["CPUExecutionProvider"]
    )
    (value,) = session.get_inputs()
    assert (value.name, value.shape, value.type) == (
        "observation", ["num_envs", 15], "tensor(float)",
    )  # fmt: skip
    assert [(each.name, each.type) for each in session.get_outputs()] == [
        ("choices", "tensor(int64)"),
        ("angles", "tensor(double)"),
    ]


def test_modules_that_share_weights_have_no_c_header(tmp_path, capsys) -> None:
    pytest.importorskip("onnx", reason="onnx, of the extra `export`, is missing")
    with pytest.raises(SystemExit, match=r"formats must be onnx for sort-modules, .* ONNX alone"):
        main(["sort-modules", "--formats", "c", "--out", str(tmp_path)])
    assert list(tmp_path.iterdir()) == []
    main(["sort-modules", "--out", str(tmp_path), "--observations", "200"])
    names = {file.name for file in tmp_path.iterdir()}
    assert names == {"sort-modules.onnx", "sort-modules.md"}
    assert "sort-modules.h" not in (tmp_path / "sort-modules.md").read_text()
    main(["slow-dqn", "--formats", "c", "--out", str(tmp_path / "c"), "--observations", "200"])
    assert {file.name for file in (tmp_path / "c").iterdir()} == {"slow-dqn.h", "slow-dqn.md"}
    capsys.readouterr()


def test_a_run_is_exported_under_its_own_name_or_another(tmp_path) -> None:
    save_policy(network_of("window"), CARDS["window"], tmp_path / "window")
    source = of_run(tmp_path / "window", "mine")
    assert (source.name, source.seed, source.training.preset) == ("mine", 0, "nominal")
    assert of_run(tmp_path / "window").name == "window"
    write_config(PPOConfig(preset="lab"), tmp_path / "window" / "config.yaml")
    lab = of_run(tmp_path / "window").training
    assert [each.name for each in lab.presets] == list(TRAINED_IN["lab"])
    for flag in ("preset", next(old for old, name in RENAMED.items() if name == "preset")):
        command = f"python train.py --{flag} lab"
        (tmp_path / "window" / "card.yaml").write_text(f"command: {command}\n")
        training = of_run(tmp_path / "window").training
        assert (training.preset, training.command) == ("lab", command)
    with pytest.raises(ValueError, match="seed must be one of 0, got 3"):
        of_run(tmp_path / "window", seed=3)


@pytest.mark.parametrize("name", CARDS)
def test_the_page_lists_every_feature_and_angle(name) -> None:
    source = made(name)
    page = make_page(source, make_metadata(source), {"ONNX": None, "C": None})
    for each in source.config.features:
        assert f"| {each.name} | {each.low:g} | {each.high:g} | {each.meaning} |" in page
    for angle in source.config.chosen_orientations:
        assert f"| {angle:.9g} | {np.degrees(angle):g} |" in page
    assert f"every {source.config.control_period * 1e3:g} ms" in page
    assert "not tried" in page
    assert ("shown in a mirror" in page) == (source.config.task_name == "sort")


@pytest.mark.parametrize("task", TASKS)
def test_every_feature_of_the_package_says_what_it_needs(task) -> None:
    config = EnvConfig(task=task, actions="window", observe_axes=True)
    shown = (*config.features, *group_features(tuple(GROUPS)))
    assert [each.name for each in shown if find_need(each) == UNKNOWN] == []
    assert find_need(Feature("mood", 0.0, 1.0, "of the parcel")) == UNKNOWN


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"name": "juggle-ppo"}, r"name must be one of 'flow-ppo', .*, got 'juggle-ppo'"),
        ({}, "name must be one of .*, got None"),
        ({"name": "sort-ppo", "task": "mine.py:Mine"}, "task must stand beside --run"),
        ({"name": "sort-ppo", "observations": 3}, "observations must be .* at least 100"),
    ],
)
def test_what_is_no_export_is_refused(given, named) -> None:
    with pytest.raises(ValueError, match=named):
        ExportConfig(**given)


def test_what_cannot_be_exported_is_refused(tmp_path) -> None:
    with pytest.raises(ValueError, match="preset must be one of"):
        _ = Training("weather").presets
    with pytest.raises(SystemExit, match="error: name must be that of an agent of single parcels"):
        main(["flow-ppo", "--out", str(tmp_path / "out")])
    with pytest.raises(SystemExit, match="holds no policy"):
        main(["--run", str(tmp_path), "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()


def test_a_missing_library_is_reported_with_the_extra_that_brings_it(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)
    wanted = r"needs onnx, .*'surface_gym\[agents,export\]'"
    source = shipped("sort-ppo")
    with pytest.raises(ImportError, match=wanted):
        make_model(network_decision(source), {})
    with pytest.raises(ImportError, match=wanted):
        export(source, tmp_path)
    with pytest.raises(SystemExit, match=wanted):
        main(["sort-ppo", "--out", str(tmp_path)])
    assert list(tmp_path.iterdir()) == []

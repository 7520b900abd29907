"""The comparison on the home page: its files hold one stream and both schedules."""

import json

import numpy as np
import pytest

from surface_gym.agents.export import home
from surface_gym.agents.scheduling.leading import schedule
from surface_gym.compiler.wasm_image import BASE, compute_signature, name_arguments
from surface_gym.config import EnvConfig
from surface_gym.env import make_batch


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("site")
    home.write_home(made, {"code": "agent-flow-obeying"})
    return made


@pytest.fixture(scope="module")
def layout(folder):
    return json.loads((folder / "home.json").read_text())


def test_the_module_of_flow_steps_it(layout):
    upper, flow = home.make_config(home.find_methods()[0]), EnvConfig("flow")
    batch, plain = home.place_stream(upper), make_batch(flow, 1, compiles=False)
    assert batch.make_kernel() is plain.make_kernel()
    named = name_arguments(plain.make_kernel(), plain.arguments)
    assert layout["signature"] == compute_signature(named)


def test_both_lines_have_the_same_boxes_of_all_kinds_for_all_exits(folder, layout):
    block = (folder / "home.bin").read_bytes()
    assert len(block) == layout["bytes"]
    for method in home.find_methods():
        streams = home.place_stream(home.make_config(method)).streams
        for name in ("time", "body", "exit", "start"):
            _, _, address = layout["fields"][f"streams.{name}"]
            there = getattr(streams, name).tobytes()
            assert block[address - BASE : address - BASE + len(there)] == there
        kinds = np.stack([streams.body[0], streams.exit[0]], axis=1)
        assert len(kinds) == home.BOXES
        assert len(np.unique(kinds, axis=0)) == 2 * 3
    assert [mark["label"] for mark in layout["starts"]["marks"][0]] == ["left", "right", "straight"]


def test_the_memories_are_those_of_the_comparison_s_schedulers(folder, layout):
    assert [card["byGroups"] for card in layout["lines"]] == [True, False]
    for card, scheduler in zip(layout["lines"], home.make_schedulers(), strict=True):
        block = (folder / f"{card['machine']}.bin").read_bytes()
        fields = json.loads((folder / f"{card['machine']}.json").read_text())["fields"]
        named = name_arguments(schedule, scheduler.start_arguments())
        assert list(fields) == list(named)
        for name in ("orders.gaps", "orders.delay", "orders.options", "way.place", "way.spans"):
            kind, shape, address = fields[name]
            values = np.frombuffer(block, kind, np.prod(shape, dtype=int), address - BASE)
            np.testing.assert_array_equal(values.reshape(shape), named[name])

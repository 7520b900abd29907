"""The playground in a browser: each control, each task, thrown parcels, scenes shared and bad."""

import json
import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.registration import PERIODS
from surface_gym.web.scene import TableScene, TaskScene, ThrownParcel, pack
from tests.web.conftest import (
    NARROW,
    PAGE,
    WIDE,
    check_controls,
    check_script,
    end_states,
    open_sort,
    run_script,
    wait_for,
)


@pytest.fixture
def table(play):
    """An empty table, where all modules roll along x."""
    page = play()
    page.select_option("#task", "table")
    wait_for(page, "playground.scene.parcels.length === 0")
    return page


def scene(page):
    return page.evaluate("playground.scene")


def place(page, x, y):
    """Return where [px] a point [m] of the first picture is in the window, once all is laid out."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    box = page.locator("canvas").first.bounding_box()
    px, py = page.evaluate(f"playground.shown[0].picture.toCanvas({x}, {y})")
    return box["x"] + px, box["y"] + py


def drag(page, start, end):
    page.mouse.move(*place(page, *start))
    page.mouse.down()
    page.mouse.move(*place(page, *end), steps=4)
    page.mouse.up()


def share(page):
    """Return the address of the page's scene, without the host."""
    page.click("#link")
    wait_for(page, "document.getElementById('shared').textContent")
    return page.url.rpartition("/")[2]


def set_slider(page, name, value):
    page.locator(name).fill(str(value))


def assert_same(page):
    """Assert that the page's Python script gives the same run, to the bit."""
    found = end_states(page)
    printed = [[float(each) for each in line[:7]] for line in run_script(page)]
    assert found == printed != []


@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["wide", "narrow"])
def test_it_fits_the_screen_and_moves_by_itself(play, size):
    page = play(size=size, reduced_motion="no-preference")
    wait_for(page, "playground.shown[0].run.time > 0.2")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert page.inner_text("#start") == "Pause"


def test_all_controls_have_names_and_are_reached_by_the_keyboard(play):
    check_controls(play())


def test_a_parcel_is_thrown_where_and_as_fast_as_the_pointer_drags(table):
    drag(table, (0.5, 0.4), (1.1, 0.55))
    (thrown,) = scene(table)["parcels"]
    assert thrown["pose"][:2] == pytest.approx([0.5, 0.4], abs=0.01)
    assert thrown["velocity"][:2] == pytest.approx([1.2, 0.3], abs=0.03)
    wait_for(table, "playground.shown[0].run.tracks[0].motion.at(-6) > 0.6")


def test_a_click_throws_as_the_sliders_say(table):
    for name, value in {"length": 0.4, "width": 0.2, "mass": 5, "turned": 90, "throw-speed": 2,
                        "heading": 90, "spin": 1, "load": 0.2}.items():  # fmt: skip
        set_slider(table, f"#{name}", value)
    table.mouse.click(*place(table, 1.0, 0.3))
    (thrown,) = scene(table)["parcels"]
    assert thrown["base"] == {"rectangle": [0.4, 0.2]}
    assert (thrown["mass"], thrown["com_offset"]) == (5, pytest.approx([0.04, 0.0]))
    assert thrown["pose"][2] == math.pi / 2
    assert thrown["velocity"] == pytest.approx([0.0, 2.0, 1.0])


@pytest.mark.parametrize("shape", ["disc", "polygon"])
def test_other_shapes_are_thrown(table, shape):
    table.select_option("#shape", shape)
    table.mouse.click(*place(table, 0.5, 0.5))
    assert list(scene(table)["parcels"][0]["base"]) == [shape]
    assert_same(table)


def test_a_parcel_is_thrown_by_the_keyboard_and_by_touch(play):
    page = play(size=NARROW, has_touch=True)
    page.click("#clear")
    page.locator("canvas").focus()
    for key in ("ArrowRight", "ArrowUp", "Enter"):
        page.keyboard.press(key)
    assert len(scene(page)["parcels"]) == 1
    page.touchscreen.tap(*place(page, 1.8, 0.3))
    assert len(scene(page)["parcels"]) == 2


def test_no_parcel_comes_in_where_there_is_one_or_no_table(table):
    set_slider(table, "#throw-speed", 0)
    table.mouse.click(*place(table, 0.5, 0.5))
    table.mouse.click(*place(table, 0.55, 0.5))
    assert "There is a parcel already" in table.inner_text("#message")
    assert len(scene(table)["parcels"]) == 1
    table.evaluate("playground.try(() => playground.throw(playground.shown[0].run, [9, 9], null))")
    assert "must come in over the table" in table.inner_text("#message")


def test_there_is_room_for_24_parcels_and_the_25th_is_refused(table):
    table.evaluate(
        """() => {
          document.getElementById("length").value = 0.1;
          document.getElementById("width").value = 0.1;
          const { run } = playground.shown[0];
          const place = (k) => [0.2 + 0.2 * (k % 9), 0.2 + 0.3 * Math.floor(k / 9)];
          for (let k = 0; k < 25; k++) playground.try(() => playground.throw(run, place(k), null));
        }"""
    )
    assert len(scene(table)["parcels"]) == 24
    assert "at most 24 parcels" in table.inner_text("#message")
    assert table.evaluate("playground.stepOnce() ?? playground.shown[0].run.time") > 0.0


def test_a_run_goes_on_for_longer_where_more_is_thrown_and_ends_after_a_minute(table):
    end_states(table)
    assert table.evaluate("playground.shown[0].run.time") == pytest.approx(20.0)
    table.mouse.click(*place(table, 0.5, 0.5))
    assert scene(table)["duration"] == pytest.approx(40.0)
    assert_same(table)
    set_slider(table, "#tilt", 1)
    end_states(table)
    set_slider(table, "#tilt", 2)
    end_states(table)
    table.mouse.click(*place(table, 0.5, 0.5))
    assert "at most 60 s" in table.inner_text("#message")


def test_modules_turn_by_click_by_dragging_and_all_at_once(table):
    table.check("input[value=turn]")
    table.select_option("#angle", "-45")
    table.mouse.click(*place(table, 0.25, 0.15))
    axes = table.evaluate("[...playground.shown[0].run.axes]")
    assert [k for k, angle in enumerate(axes) if angle != math.pi / 2] == [24 + 2]
    assert axes[26] == -math.pi / 4
    table.select_option("#brush", "1")
    table.select_option("#angle", "other")
    set_slider(table, "#other", 20)
    drag(table, (0.55, 0.55), (1.05, 0.55))
    axes = table.evaluate("[...playground.shown[0].run.axes]")
    assert axes.count(pytest.approx(math.radians(20))) >= 3 * 7
    table.select_option("#angle", "0")
    table.click("#all")
    assert set(table.evaluate("[...playground.shown[0].run.axes]")) == {0}
    table.select_option("#layout", "whirl")
    assert len(set(table.evaluate("[...playground.shown[0].run.axes]"))) > 10


def test_the_table_has_tilt_friction_and_size(table):
    set_slider(table, "#tilt", 10)
    set_slider(table, "#downhill", 90)
    set_slider(table, "#along", 0.6)
    set_slider(table, "#across", 0.02)
    found = scene(table)
    assert found["tilt"] == pytest.approx(math.radians(10))
    assert found["tilt_direction"] == math.pi / 2
    assert found["friction"] == [0.6, 0.02, 0.005]
    table.select_option("#size", "6 12")
    wait_for(table, "playground.scene.rows === 6")
    assert scene(table)["friction"] == [0.6, 0.02, 0.005]


def test_it_pauses_steps_begins_again_and_is_slower_or_faster(table):
    table.mouse.click(*place(table, 0.5, 0.5))
    assert table.inner_text("#state") == "running"
    table.keyboard.press("Space")
    assert table.inner_text("#state") == "paused"
    before = table.evaluate("playground.shown[0].run.time")
    table.click("#step")
    assert table.evaluate("playground.shown[0].run.time") == pytest.approx(before + 0.02)
    table.keyboard.press("r")
    assert table.evaluate("playground.shown[0].run.time") == 0.0
    table.select_option("#speed", "4")
    table.click("#start")
    wait_for(table, "playground.shown[0].run.time > 1")


def test_forces_and_traces_are_drawn(table):
    table.mouse.click(*place(table, 0.5, 0.5))
    wait_for(table, "playground.shown[0].run.time > 0.3")
    table.keyboard.press("Space")
    table.check("#forces")
    table.check("#traces")
    wait_for(table, "playground.shown[0].picture.frame.parcels[0].forces?.length > 3")
    forces = table.evaluate("playground.shown[0].picture.frame.parcels[0].forces")
    ax = sum(each[2] for each in forces) / 10.0
    state = table.evaluate("[...playground.shown[0].run.machine.view('world.state')].slice(0, 8)")
    assert ax == pytest.approx(state[6], abs=1e-6)  # all that accelerates it
    assert len(table.evaluate("playground.shown[0].picture.frame.traces[0].points")) > 20


def test_a_script_gives_one_parcel_s_run(table):
    table.select_option("#layout", "zigzag")
    set_slider(table, "#turned", 25)
    table.mouse.click(*place(table, 0.3, 0.45))
    assert_same(table)


def test_several_parcels_and_a_table_that_changes_on_the_way(table):
    drag(table, (0.4, 0.5), (1.0, 0.5))
    wait_for(table, "playground.shown[0].run.time > 0.2")
    drag(table, (0.4, 0.2), (1.2, 0.3))
    set_slider(table, "#tilt", 5)
    table.check("input[value=turn]")
    table.select_option("#angle", "0")
    table.mouse.click(*place(table, 1.5, 0.5))
    found = scene(table)
    assert len(found["changes"]) > 0
    assert found["parcels"][1]["step"] > 0
    assert_same(table)


def test_a_scene_is_shared_by_its_address(table, play):
    drag(table, (0.4, 0.5), (1.0, 0.6))
    wait_for(table, "playground.shown[0].run.time > 0.2")
    table.select_option("#layout", "sort")
    other = play(address=share(table))
    assert scene(other) == scene(table)
    assert end_states(other) == end_states(table)


def test_a_scene_of_python_opens_in_the_page(play):
    surface = sg.layouts.sorting()
    thrown = (
        ThrownParcel(sg.layouts.box("S"), (0.125, 1.0, 0.0), (1.5, 0.0, 0.0)),
        ThrownParcel(sg.Parcel(sg.Disc(0.1), mass=2.0), (0.2, 1.0, 0.0), (1.5, 0.1, 0.0), step=150),
    )
    made = TableScene(surface, thrown, 3.0, changes=((60, sg.layouts.sorting(side=1, tilt=0.1)),))
    page = play(address=made.url())
    found = end_states(page)
    for mine, run in zip(found, made.run().trajectories, strict=True):
        assert mine == [run.time[-1], *run.pose[-1], *run.velocity[-1]]
    with page.expect_download() as saved:
        page.click("#json")
    assert json.loads(saved.value.path().read_text()) == json.loads(made.to_json())


def test_a_run_comes_out_as_csv_and_json_opens(table, tmp_path):
    drag(table, (0.4, 0.5), (1.0, 0.5))
    end_states(table)
    with table.expect_download() as saved:
        table.click("#csv")
    rows = saved.value.path().read_text().splitlines()
    assert rows[0].startswith("time [s],parcel,x [m]")
    assert len(rows[-1].split(",")) == 8
    file = tmp_path / "scene.json"
    file.write_text(TableScene(sg.layouts.sorting("B")).to_json())
    table.set_input_files("#open", str(file))
    wait_for(table, "playground.scene.rows === 20")


GOOD = json.loads(TableScene(sg.layouts.sorting()).to_json())
PARCEL = {"base": {"disc": 0.1}, "mass": 1, "pose": [1, 1, 0], "velocity": [0, 0, 0]}
BAD = {
    "cut short": (TableScene(sg.layouts.sorting()).url()[16:-9], "cut short"),
    "no scene": ("nothing", "holds no scene"),
    "damaged": ("1.%%%", "damaged"),
    "no object": (pack("[1, 2]"), "must be an object"),
    "half": (pack('{"version": 1'), "is not whole"),
    "another version": (pack(json.dumps({**GOOD, "version": 9})), "version must be 1"),
    "not a number": (pack(json.dumps({**GOOD, "tilt": None})), "tilt must be a finite number"),
    "NaN": (pack(json.dumps({**GOOD, "tilt": math.nan})), "is not whole"),
    "steep": (pack(json.dumps({**GOOD, "tilt": 2.0})), "tilt must be from"),
    "a million parcels": (pack(json.dumps({**GOOD, "parcels": [0] * 1_000_000})), "at most"),
    "25 parcels": (pack(json.dumps({**GOOD, "parcels": [PARCEL] * 25})), "at most 24 parcels"),
    "a million modules": (pack(json.dumps({**GOOD, "rows": 5000, "columns": 200})), "at most 6000"),
    "a bad base": (
        pack(json.dumps({**GOOD, "parcels": [{**PARCEL, "base": {"disc": -1}}]})), "disc must be",
    ),
    "a star": (
        pack(json.dumps({**GOOD, "parcels": [{**PARCEL, "base": {"polygon": [[0, 0], [1, 0],
            [0.2, 0.2], [0, 1]]}}]})), "must be convex",
    ),
    "long": (pack(json.dumps({**GOOD, "duration": 1e9})), "duration must be"),
    "an unknown task": (pack(json.dumps({"version": 1, "task": "dance"})), "task must be one of"),
    "a seed that there is not": (TaskScene("sort", seed=99).url()[16:], "seeds 0 to 19"),
    "a large number": (pack(json.dumps({**GOOD, "commands": "x" * 3_000_000})), "at most 2000000"),
}  # fmt: skip


def test_an_address_that_is_cut_short_gets_a_message_and_a_scene_that_runs(play):
    fragment, said = BAD["cut short"]
    page = play(address=f"{PAGE}#{fragment}")
    wait_for(page, "playground.scene !== undefined")
    assert said in page.inner_text("#message")
    page.click("#step")
    assert page.evaluate("playground.shown[0].run.time") > 0.0


def test_bad_scenes_get_a_message_and_the_page_goes_on(play):
    page = play()
    for fragment, said in BAD.values():
        page.evaluate("fragment => { playground.say(''); location.hash = fragment }", fragment)
        wait_for(page, "document.getElementById('message').textContent")
        assert said in page.inner_text("#message")
        before = page.evaluate("playground.shown[0].run.time")
        page.click("#step")
        assert page.evaluate("playground.shown[0].run.time") > before


@pytest.mark.parametrize("task", list(PERIODS))
def test_a_task_begins_by_seed_runs_and_gives_the_same_run_in_python(play, task):
    page = play(task)
    page.select_option("#task", task)
    wait_for(page, f"playground.scene.task === '{task}'")
    page.select_option("#seed", "3")
    wait_for(page, "playground.scene.seed === 3")
    page.evaluate(
        """() => {
          const { run } = playground.shown[0];
          for (let k = 0; k < 120 && !run.over; k++) {
            const some = run.modules().filter((m) => m % 5 === k % 5);
            if (k % 7 === 0) playground.turn(run, some, k % 2 ? 0 : 0.785);
            run.advance();
          }
          playground.isStale = true;
        }"""
    )
    more = check_script(page)
    if PERIODS[task] is not None:
        truth = page.evaluate("[...playground.shown[0].run.machine.view('parcels.truth')]")
        assert truth == [float(each) for each in more[-6:]]


def test_stuck_modules_and_late_axes(play):
    page = open_sort(play)
    page.check("input[value=stick]")
    page.mouse.click(*place(page, 1.05, 1.05))
    wait_for(page, "playground.scene.stuck.length === 1")
    page.select_option("#late", "2")
    wait_for(page, "playground.scene.late === 2")
    page.locator("canvas").focus()
    page.keyboard.press("1")
    turned = []
    for _ in range(4):
        page.click("#step")
        turned.append(
            page.evaluate("[...playground.shown[0].run.frame().axes].filter((a) => a === 0).length")
        )
    assert turned == [0, 0, 31, 31]
    end_states(page)
    run_script(page)
    page.click("#mend")
    wait_for(page, "playground.scene.stuck.length === 0")
    page.click("#stick-some")
    wait_for(page, "playground.scene.stuck.length === 4")
    page.click("#stick-some")
    wait_for(page, "playground.scene.stuck.length === 8")


def test_a_task_s_scene_is_shared_with_what_was_done(play):
    page = open_sort(play)
    page.locator("canvas").focus()
    page.click("#step")
    page.locator("canvas").focus()
    page.keyboard.press("2")
    ends = end_states(page)
    other = play(address=share(page))
    assert end_states(other) == ends
    other.click("#afresh")
    wait_for(other, "playground.shown[0].run.time === 0")
    assert end_states(other) != ends


def test_driven_modules_carry_a_parcel_as_in_python(play):
    page = open_sort(play, "sort-omni")
    assert page.locator("#kind option").all_inner_texts() == ["idle", "omni"]
    page.select_option("#kind", "omni")
    wait_for(page, "playground.scene.modules === 'omni'")
    rolling, drives = page.evaluate(
        "[playground.shown[0].run.about.rolling, playground.shown[0].run.about.drives]"
    )
    assert drives[rolling] == [1.5, 0.0]
    assert page.locator("#angle option").all_inner_texts()[1] == "0.5 m/s, 45\N{DEGREE SIGN}"
    page.select_option("#angle", "1")
    page.click("#all")
    for _ in range(5):
        page.click("#step")
    drawn = np.array(page.evaluate("playground.shown[0].run.frame().drives"))
    zone = page.evaluate("playground.shown[0].run.modules()")
    assert drawn[zone] == pytest.approx(np.full((len(zone), 2), 0.5 * math.sqrt(0.5)))
    assert page.is_disabled("#camera")
    ((time, *motion),) = end_states(page)
    ((_, *printed),) = run_script(page)
    assert [time, *motion] == [float(each) for each in (printed[0], *printed[-6:])]
    page.select_option("#kind", "idle")
    wait_for(page, "playground.scene.modules === 'idle'")
    assert page.locator("#angle option").count() == 5


def test_a_kind_of_modules_that_is_not_there_is_refused(play):
    page = open_sort(play)
    page.evaluate("playground.reopen({ modules: 'popup' })")
    wait_for(page, "!document.getElementById('message').hidden")
    assert "no such task with popup modules" in page.inner_text("#message")


def test_starts_of_all_seeds_equal_those_of_the_environment(play):
    import gymnasium as gym

    page = open_sort(play)
    env = gym.make("SmartSurface/Sort-v0")
    for seed in range(20):
        _, info = env.reset(seed=seed)
        page.evaluate(f"playground.reopen({{ seed: {seed} }})")
        truth = page.evaluate("[...playground.shown[0].run.machine.view('parcels.truth')]")
        assert truth == [*info["pose"], *info["velocity"]]


def test_sines_and_cosines_are_those_of_the_c_library(play):
    page = play()
    angles = [0.0, -0.0, 1e-9, *np.linspace(-7.0, 7.0, 20_001).tolist(), 1e3, -1e5]
    found = page.evaluate(
        """async (angles) => {
          const { sin, cos } = await import("./machine.js");
          return angles.map((angle) => [sin(angle), cos(angle)]);
        }""",
        angles,
    )
    assert found == [[math.sin(angle), math.cos(angle)] for angle in angles]


def test_a_theme_and_zoom(play):
    page = play()
    page.select_option("#theme", "dark")
    assert page.evaluate("document.documentElement.style.colorScheme") == "dark"
    before = page.evaluate("playground.shown[0].picture.scale")
    page.mouse.move(*place(page, 1.0, 0.5))
    page.mouse.wheel(0, -300)
    wait_for(page, f"playground.shown[0].picture.scale > {before}")
    page.click("#fit")
    assert page.evaluate("playground.shown[0].picture.scale") == pytest.approx(before)

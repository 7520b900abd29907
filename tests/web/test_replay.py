"""A replay's page in a browser: each control, by pointer, keyboard and touch, and nothing else."""

import math
import re
from dataclasses import replace
from importlib.resources import files

import gymnasium as gym
import numpy as np
import pytest

import surface_gym as sg
from surface_gym.player import Replay, replay
from surface_gym.recorder import record_trajectory
from surface_gym.recording import Mark, RecordedParcel, Recording
from surface_gym.rendering import ink
from tests.docs.reading import DOCS
from tests.web.conftest import NARROW, WIDE

PAGE = files("surface_gym.web") / "page"


def stream(seconds: float = 4.0) -> Recording:
    """Two parcels on 4 x 20 modules that turn once a second, and an exit."""
    count = round(25 * seconds) + 1
    time = np.arange(count) / 25.0
    box = sg.Rectangle(0.4, 0.3).outline
    parcels = []
    for k, first in enumerate((0, 25)):
        rows = min(count - first, 60)
        since = time[:rows]
        pose = np.column_stack([0.3 + 0.5 * since, np.full(rows, 0.2), 0.1 * since])
        velocity = np.tile([0.5, 0.0, 0.1], (rows, 1))
        parcels.append(RecordedParcel(box, first, pose, velocity, "AB"[k], k))
    corners = np.array([[1.0, 0.4], [1.5, 0.4], [1.5, 0.6], [1.0, 0.6]])
    return Recording(
        title="Stream",
        control_period=0.04,
        time=time,
        rotor=np.ones((4, 20), dtype=bool),
        angles=np.radians([0.0, 45.0]),
        axis=np.broadcast_to((time % 2.0 >= 1.0)[:, None, None], (count, 4, 20)).astype(np.uint8),
        marks=(Mark("exit", corners, "left", 0),),
        parcels=tuple(parcels),
        delivered=(time[:, None] > 3.0).astype(float),
        metrics={"reward": time},
        outcome="time is over",
    )


@pytest.fixture(scope="module")
def trajectory() -> Recording:
    box = sg.Parcel(sg.Rectangle(0.25, 0.25), mass=10.0)
    run = sg.simulate(sg.layouts.sorting(), box, (0.125, 1.0, 0.0), (1.5, 0.0, 0.0))
    return record_trajectory(run)


@pytest.fixture(scope="module")
def merging() -> Recording:
    """Parcels that push each other, since one half of the modules leads them into the other."""
    env = sg.RecordReplay(gym.make("SmartSurface/Singulate-v0"))
    env.reset(seed=1)
    degrees = np.degrees(env.unwrapped.batch.params.acting.orientations).round().tolist()
    _, rows, _, columns = env.unwrapped.batch.bodies.zone[0].tolist()
    halves = np.where(np.arange(rows) < rows / 2, degrees.index(90.0), degrees.index(45.0))
    for _ in range(150):
        *_, terminated, truncated, _ = env.step(np.repeat(halves, columns))
        if terminated or truncated:
            break
    assert len(env.recording.pushes) > 0
    return env.recording


class Opened:
    """A page that is open, and what is on it."""

    def __init__(self, page, recordings):
        self.page = page
        self.recordings = recordings

    def control(self, role, name):
        return self.page.get_by_role(role, name=name, exact=True)

    @property
    def time(self) -> float:
        return float(self.page.locator("output").inner_text().split()[0])

    @property
    def reading(self) -> str:
        return self.page.locator("#reading").inner_text()

    def picture(self, run: int = 0) -> str:
        script = "k => document.querySelectorAll('canvas')[k].toDataURL()"
        return self.page.evaluate(script, run)

    def scrub(self, frame: float) -> None:
        self.control("slider", "Time").fill(str(frame))

    def place(self, x: float, y: float, run: int = 0) -> tuple[float, float]:
        """Compute where on the screen a point of the surface is, with all of it shown."""
        box = self.page.locator("canvas").nth(run).bounding_box()
        found = self.recordings[run]
        rows, columns = found.rotor.shape
        margin = 0.25 * min(found.pitch)
        left, low = np.array(found.origin) - 0.5 * np.array(found.pitch)
        view = found.view or (
            left, low, left + columns * found.pitch[0], low + rows * found.pitch[1],
        )  # fmt: skip
        width, height = view[2] - view[0] + 2 * margin, view[3] - view[1] + 2 * margin
        scale = min(box["width"] / width, box["height"] / height)
        across, up = x - (view[0] + view[2]) / 2, y - (view[1] + view[3]) / 2
        return (
            box["x"] + box["width"] / 2 + scale * across,
            box["y"] + box["height"] / 2 - scale * up,
        )


@pytest.fixture
def show(tab, tmp_path):
    """Open a replay, which says nothing and asks for nothing but its page."""

    def opened(made: Replay, size=WIDE, **options) -> Opened:
        made.save(tmp_path / "run.html")
        page = tab(size, "log debug info warning error", ("file:", "data:", "blob:"), **options)
        page.goto((tmp_path / "run.html").as_uri())
        page.wait_for_selector("canvas")
        return Opened(page, list(made.recordings.values()))

    return opened


@pytest.fixture
def put(tab, tmp_path):
    """Open a page of this text."""

    def opened(text: str, **options):
        (tmp_path / "page.html").write_text(text)
        page = tab(**options)
        page.goto((tmp_path / "page.html").as_uri())
        return page

    return opened


def test_it_plays_pauses_and_plays_again_from_its_end(show):
    shown = show(replay(stream(1.0)))
    assert shown.time == 0.0
    shown.control("combobox", "Speed").select_option("4")
    shown.control("button", "Play").click()
    shown.control("button", "Play").wait_for()  # it is Pause until the end
    assert shown.time == 1.0
    assert shown.page.locator(".end").inner_text() == "time is over"
    shown.control("combobox", "Speed").select_option("0.05")
    shown.control("button", "Play").click()
    shown.control("button", "Pause").click()
    assert shown.time < 1.0
    at = shown.time
    shown.page.wait_for_timeout(100)
    assert shown.time == at


def test_it_is_scrubbed_and_stepped(show):
    shown = show(replay(stream()))
    first = shown.picture()
    shown.scrub(50)
    assert shown.time == 2.0
    assert shown.picture() != first
    shown.scrub(50.5)
    assert shown.time == 2.02
    shown.control("button", "A frame on").click()
    assert shown.time == 2.04
    shown.control("button", "A frame back").click()
    assert shown.time == 2.0
    shown.scrub(0)
    assert shown.picture() == first


def test_the_keyboard_does_all_of_it(show):
    shown = show(replay(stream()))
    keys = shown.page.keyboard
    for key, time in (
        ("ArrowRight", 0.04), ("Shift+ArrowRight", 0.44), ("ArrowLeft", 0.4), ("End", 4.0),
        ("Home", 0.0),
    ):  # fmt: skip
        keys.press(key)
        assert shown.time == time
    whole = shown.picture()
    keys.press("+")
    larger = shown.picture()
    assert larger != whole
    keys.press("-")
    keys.press("0")
    assert shown.picture() == whole
    keys.press(">")
    assert shown.control("combobox", "Speed").input_value() == "2"
    keys.press("<")
    assert shown.control("combobox", "Speed").input_value() == "1"
    keys.press("t")
    assert not shown.control("checkbox", "Traces").is_checked()
    keys.press("Space")
    shown.control("button", "Pause").wait_for()
    keys.press("Space")
    shown.control("button", "Play").wait_for()


def test_the_keyboard_reads_parcels_and_modules(show):
    shown = show(replay(stream()))
    keys = shown.page.keyboard
    shown.scrub(30)
    shown.page.locator("canvas").focus()
    keys.press("n")
    assert shown.reading.startswith("parcel 1 (A) 0.50 m/s towards 0.0°")
    keys.press("n")
    assert shown.reading.startswith("parcel 2 (B)")
    keys.press("m")
    assert shown.reading == "module in row 2, column 10: axis 45.0°"
    keys.press("ArrowUp")
    keys.press("ArrowLeft")
    assert shown.reading == "module in row 3, column 9: axis 45.0°"
    keys.press("Escape")
    keys.press("ArrowLeft")
    assert "Point at a parcel" in shown.reading
    assert shown.time == 1.16


def test_driven_modules_show_their_velocity(show):
    idle = stream(1.0)
    drive = (idle.time >= 0.5)[:, None, None] * np.ones((1, 4, 20), dtype=np.uint8)
    driven = np.array([[0.0, 1.0], [-2.0, 0.0]])
    shown = show(replay(idle=idle, driven=replace(idle, velocities=driven, drive=drive)))
    shown.page.locator("canvas").last.focus()
    first = shown.picture(1)
    assert first != shown.picture(0)
    shown.page.keyboard.press("m")
    assert "running at 1.00 m/s towards 90.0°" in shown.reading
    shown.scrub(20)
    assert "running at 2.00 m/s towards 180.0°" in shown.reading
    shown.page.keyboard.press("Escape")
    assert shown.picture(1) != first


def test_keys_zoom_about_the_parcel_that_is_chosen(show):
    shown = show(replay(stream()))
    place = shown.place(0.3, 0.2)  # of the first, in the first frame
    shown.page.mouse.click(*place)
    shown.page.mouse.move(5, 5)
    for _ in range(6):
        shown.page.keyboard.press("+")
    shown.page.keyboard.press("Escape")
    assert "Point at a parcel" in shown.reading
    shown.page.mouse.move(*place)
    assert shown.reading.startswith("parcel 1 (A)")


def test_tab_reaches_every_control_and_each_has_a_name(show):
    shown = show(replay(stream()))
    script = """() => {
        const at = document.activeElement;
        return at.ariaLabel || at.closest("label")?.textContent || at.textContent;
    }"""
    names = []
    for _ in range(16):
        shown.page.keyboard.press("Tab")
        names.append(shown.page.evaluate(script))
    assert names[1:14] == [
        "Play", "A frame back", "A frame on", "Time", "Speed", "Zoom out", "Zoom in", "Show all",
        "Traces", "Theme", "Numbers", "Keys", names[13],
    ]  # fmt: skip
    assert names[0].startswith("Stream: one parcel on a surface of 4 by 20")


def test_pointing_reads_a_module_and_a_parcel(show, trajectory):
    shown = show(replay(trajectory))
    frame = 20
    shown.scrub(frame)
    pose, velocity = trajectory.parcels[0].pose[frame], trajectory.parcels[0].velocity[frame]
    shown.page.mouse.move(*shown.place(pose[0], pose[1]))
    assert f"{math.hypot(*velocity[:2]):.2f} m/s" in shown.reading
    contacts = trajectory.contacts[slice(*trajectory.first_contact[frame : frame + 2])]
    carried, friction = contacts[:, 1].sum(), contacts[:, 2:].sum(axis=0)
    assert f"carried with {carried:.1f} N" in shown.reading
    assert re.search(rf"friction {np.hypot(*friction):.1f} N", shown.reading)
    row, column = 10, 30
    shown.page.mouse.move(*shown.place(0.05 + 0.1 * column, 0.05 + 0.1 * row))
    axis = math.degrees(trajectory.angles[trajectory.axis[frame, row, column]])
    assert shown.reading == f"module in row {row}, column {column}: axis {axis:.1f}°"
    shown.page.mouse.move(*shown.place(0.05, 0.05))  # a support
    assert "Point at a parcel" in shown.reading


def test_pointing_reads_the_forces_on_each_parcel_of_a_stream(show, merging):
    shown = show(replay(merging))
    pushes = np.hypot(merging.pushes[:, 4], merging.pushes[:, 5])
    frame = int(np.searchsorted(merging.first_push, int(pushes.argmax()), side="right")) - 1
    shown.scrub(frame)
    contacts = slice(*merging.first_contact[frame : frame + 2])
    read = 0
    for number, parcel in enumerate(merging.parcels):
        row = frame - parcel.first
        if not 0 <= row < len(parcel.pose) - 1:
            continue
        shown.page.mouse.move(*shown.place(*parcel.pose[row, :2]))
        assert f"parcel {number + 1} " in shown.reading
        assert f"{np.hypot(*parcel.velocity[row, :2]):.2f} m/s" in shown.reading
        _, normal, fx, fy = merging.contacts[contacts][merging.bearer[contacts] == number].T
        carried = float(re.search(r"carried with ([\d.]+) N", shown.reading)[1])
        friction = float(re.search(r"friction ([\d.]+) N", shown.reading)[1])
        assert carried == pytest.approx(normal.sum(), abs=0.2)  # a sum of rounded ones
        assert friction == pytest.approx(np.hypot(fx.sum(), fy.sum()), abs=0.2)
        pushed = np.zeros(2)
        for first, second, _, _, *push in merging.pushes[
            slice(*merging.first_push[frame : frame + 2])
        ]:
            pushed += np.array(push) * (int(second == number) - int(first == number))
        found = re.search(r"pushed with ([\d.]+) N", shown.reading)
        assert (found is not None) == bool(pushed.any())
        if found:
            assert float(found[1]) == pytest.approx(np.hypot(*pushed), abs=0.2)
        read += 1
    assert read >= 2
    before = shown.picture()
    shown.control("checkbox", "Forces").click()
    assert shown.picture() != before


def test_forces_and_traces_are_switched(show, trajectory):
    shown = show(replay(trajectory))
    shown.scrub(20)  # where it slides
    seen = {shown.picture()}
    for name in ("Forces", "Traces"):
        shown.control("checkbox", name).click()
        seen.add(shown.picture())
    shown.control("checkbox", "Forces").click()
    seen.add(shown.picture())
    assert len(seen) == 4


def test_forces_that_are_not_known_cannot_be_switched_on(show):
    assert show(replay(stream())).control("checkbox", "Forces").is_disabled()


def test_the_wheel_zooms_where_the_pointer_is_and_dragging_moves(show):
    shown = show(replay(stream()))
    whole = shown.picture()
    place = shown.place(1.05, 0.25)
    shown.page.mouse.move(*place)
    assert "column 10: axis" in shown.reading
    shown.page.mouse.wheel(0, -300)  # the page's own, until the picture is clicked
    assert shown.picture()
    shown.page.mouse.click(*place)
    shown.page.mouse.wheel(0, -300)
    shown.page.wait_for_function(
        "whole => document.querySelector('canvas').toDataURL() !== whole", arg=whole
    )
    assert "column 10: axis" in shown.reading
    before = shown.picture()
    shown.page.mouse.down()
    shown.page.mouse.move(place[0] + 300, place[1], steps=3)
    shown.page.mouse.up()
    assert shown.picture() != before
    shown.control("button", "Show all").click()
    shown.page.keyboard.press("Escape")
    shown.page.mouse.move(5, 5)
    assert shown.picture() == whole


def test_a_tap_reads_what_is_there(show):
    shown = show(replay(stream()), NARROW, has_touch=True, is_mobile=True)
    shown.page.touchscreen.tap(*shown.place(0.3, 0.2))
    assert shown.reading.startswith("parcel 1 (A)")
    shown.page.touchscreen.tap(*shown.place(1.55, 0.35))
    assert shown.reading.startswith("module in row 3, column 15")


def test_runs_are_side_by_side_in_step(show, trajectory):
    shown = show(replay(stream(), trajectory, again=stream(1.0)))
    captions = shown.page.locator("figcaption strong").all_inner_texts()
    assert captions == ["Stream", "Trajectory", "again"]
    shown.scrub(50)
    assert shown.page.locator(".end").all_inner_texts() == ["", trajectory.outcome, "time is over"]
    shown.page.locator("summary", has_text="Numbers").click()
    row = shown.page.locator("tr", has_text="reward")
    row.wait_for()  # the table is filled after it has opened
    assert row.locator("td").all_inner_texts() == ["2", "\N{EN DASH}", "1"]


LIGHT, DARK = "rgb(255, 255, 255)", "rgb(18, 22, 27)"


def assert_turns(frame, colour: str) -> None:
    """Wait until a page or a frame has a background of this colour."""
    from playwright.sync_api import expect

    expect(frame.locator("body")).to_have_css("background-color", colour)


def test_light_and_dark_are_the_systems_or_chosen(show):
    shown = show(replay(stream()), color_scheme="dark")
    assert_turns(shown.page, DARK)
    seen = shown.picture()
    shown.control("combobox", "Theme").select_option("light")
    assert_turns(shown.page, LIGHT)
    assert shown.picture() != seen
    shown.control("combobox", "Theme").select_option("auto")
    assert_turns(shown.page, DARK)
    shown.page.emulate_media(color_scheme="light")
    assert_turns(shown.page, LIGHT)


def test_the_address_says_light_or_dark(show):
    shown = show(replay(stream()), color_scheme="light")
    assert_turns(shown.page, LIGHT)
    for name, colour in (("dark", DARK), ("light", LIGHT), ("dark", DARK), ("neither", LIGHT)):
        shown.page.goto(f"{shown.page.url.partition('#')[0]}#{name}")
        assert_turns(shown.page, colour)


def test_in_a_page_it_follows_the_pages_theme(put):
    script = (DOCS / "assets" / "theme.js").read_text()
    page = put(
        f"<!doctype html><body data-md-color-scheme=slate>{replay(stream())._repr_html_()}"
        f"<script type=module>{script}</script>",
        color_scheme="light",
    )
    frame = page.frame_locator("iframe")
    assert_turns(frame, DARK)
    page.evaluate("document.body.dataset.mdColorScheme = 'default'")
    assert_turns(frame, LIGHT)
    frame.get_by_role("combobox", name="Theme").select_option("dark")
    assert_turns(frame, DARK)
    page.evaluate("document.body.dataset.mdColorScheme = 'slate'")
    page.evaluate("document.body.dataset.mdColorScheme = 'default'")
    frame.get_by_role("combobox", name="Theme").select_option("auto")
    assert_turns(frame, LIGHT)


@pytest.mark.parametrize("size", [WIDE, NARROW])
def test_nothing_is_wider_than_the_screen(show, size, trajectory):
    shown = show(replay(stream(), trajectory), size)
    assert shown.page.evaluate("document.documentElement.scrollWidth") <= size[0]
    for box in shown.page.locator("button, select, input").all():
        place = box.bounding_box()
        assert 0 <= place["x"] <= size[0] - place["width"]


def test_in_a_notebook_it_is_a_frame_of_its_own(put):
    page = put(f"<!doctype html><script>parent.secret = 1</script>{replay(stream())._repr_html_()}")
    frame = page.frame_locator("iframe")
    frame.get_by_role("button", name="A frame on").click()
    assert frame.locator("output").inner_text().startswith("0.04 /")


def test_a_damaged_page_says_so(put):
    page = put(re.sub(r'">eN[\w+/]{40}', '">eN', replay(stream()).html()))
    assert "cannot be shown" in page.get_by_role("alert").inner_text()


def test_the_colours_are_those_of_pictures(tab):
    text = (PAGE / "palette.js").read_text().replace("export ", "")
    angles = np.linspace(-np.pi, np.pi, 50)
    script = f"angles => {{ {text}; return [THEMES.light, EXITS, angles.map(axisColour)]; }}"
    light, exits, axes = tab().evaluate(script, angles.tolist())

    def coded(colour):
        return "#" + "".join(f"{part:02x}" for part in colour)

    for name, colour in light.items():
        if name not in ("bar", "force"):  # in pictures the paper's; there are none of forces
            theirs = getattr(ink, re.sub("([A-Z])", r"_\1", name).upper())
            assert colour == coded(theirs), name
    assert exits == [coded(each) for each in ink.EXITS]
    assert axes == [coded(each) for each in ink.axis_colours(angles).tolist()]

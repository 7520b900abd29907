"""The two lines of the home page: they do what Python does, and deliver what the docs say."""

import re
import shutil
from typing import Any

import numpy as np
import pytest

from surface_gym.agents.export import web
from surface_gym.flow.arrivals import HOUR
from tests.docs.reading import DOCS, ROOT
from tests.web.conftest import NARROW, WIDE, Site, check_controls, wait_for

PAGE = "home.html"
STILL: dict[str, Any] = {"reduced_motion": "reduce"}
MOVING: dict[str, Any] = {"reduced_motion": "no-preference"}
RATE = 13_000.0  # [1/h] of boxes, as the page begins
COMPARED = 400  # control periods of the stream, in which 57 boxes come


@pytest.fixture(scope="module")
def built(site):
    """The site with the home page's files."""
    site.add("flow")
    web.write_home(site.folder, web.write_obeying("flow", site.folder))
    return site


@pytest.fixture
def show(built, visit):
    def opened(**options):
        page = visit(PAGE, **{**STILL, **options})
        assert page.url == f"{built.address}{PAGE}"
        wait_for(page, "globalThis.home?.lines[1].picture.frame")
        return page

    return opened


def reading(page, line, name):
    return page.locator("figure").nth(line).locator(f"[data-reading={name}]").inner_text()


def clocks(page):
    return page.evaluate("home.lines.map(({ run }) => run.time)")


def run_until(page, time, rate):
    """Run both lines from the start of a stream at a rate [1/h] to a time [s]."""
    page.locator("#rate").fill(str(rate))
    page.evaluate(f"home.begin(); while (home.lines[0].run.time < {time}) home.step(); home.draw()")


@pytest.mark.parametrize("line", [0, 1], ids=["zone", "modules"])
def test_a_line_does_what_python_does_to_the_bit(show, line):
    page = show()
    found = page.evaluate(
        """([line, rate, periods]) => {
          const { run } = home.lines[line];
          run.begin();
          run.setRate(rate);
          const found = [];
          for (let k = 0; k < periods; k++) {
            run.advance();
            if (k % 5) continue;
            const tally = [...run.machine.view("streams.tally")].map(Number);
            found.push([...tally, ...run.machine.view("parcels.state")]);
          }
          return found;
        }""",
        [line, RATE, COMPARED],
    )
    scheduler, config = web.make_schedulers()[line], web.make_home_config(web.find_methods()[line])
    batch, state, expected = web.place_stream(config), None, []
    batch.streams.time[0] = HOUR / RATE * np.arange(web.BOXES)
    batch.begin(np.zeros(1, dtype=np.int64))
    for k in range(COMPARED):
        action, state = scheduler.predict(batch.observation, state)
        batch.step(config.action_kind.commands(action, 1))
        if k % 5 == 0:
            expected.append([*batch.streams.tally[0].tolist(), *batch.parcels.state.ravel()])
    assert batch.streams.tally[0, 1] > 15  # deliveries
    np.testing.assert_array_equal(found, expected)


def test_more_than_a_zone_takes_wait_there_and_modules_deliver_what_the_docs_say(show):
    page = show()
    row = r"^\| (.+?) \| \d+ \| \d+ \| (\d+) \| \d+ \|$"  # of the README: at 1.0, 1.5 and 2.0 m/s
    said = dict(re.findall(row, (ROOT / "README.md").read_text(), re.M))
    run_until(page, 40.0, 13_000)
    zone, modules = page.evaluate("home.lines.map(({ rate }) => rate)")
    assert zone == pytest.approx(
        int(said["the whole zone, as in [the study](docs/citing.md#the-study)"]), rel=0.1
    )
    assert modules == pytest.approx(int(said["each module by itself"]), rel=0.1)
    assert int(reading(page, 0, "waiting")) > 50
    run_until(page, 40.0, 4000)
    assert page.evaluate("home.lines.map(({ rate }) => rate)") == pytest.approx([4000] * 2, rel=0.1)
    for line in (0, 1):
        assert int(reading(page, line, "delivered")) > 30
        assert int(reading(page, line, "waiting")) <= 2
        assert reading(page, line, "touches") == "0"
        assert not page.locator("figure").nth(line).locator("[data-reading=wrong]").is_visible()


def test_the_slider_lets_the_boxes_to_come_follow_each_other_otherwise(show):
    page = show()
    run_until(page, 12.0, 8000)
    before = page.evaluate("[...home.lines[0].run.machine.view('streams.time')]")
    page.locator("#rate").fill("2000")
    assert page.inner_text("output") == "2\u202f000"
    after, other = page.evaluate(
        "home.lines.map(({ run }) => [...run.machine.view('streams.time')])"
    )
    assert after == other
    due = page.evaluate("home.lines[0].run.machine.get('streams.due')")
    assert due == 1 + int(12.0 / (HOUR / 8000))
    assert after[:due] == before[:due]
    np.testing.assert_allclose(np.diff(after[due - 1 :]), HOUR / 2000)


def test_after_the_last_box_it_begins_anew(show):
    page = show()
    assert clocks(page) == pytest.approx([9.0, 9.0])  # with boxes all along the lines
    page.evaluate(
        """() => {
          for (const { run } of home.lines) run.machine.view("streams.time").fill(run.time);
          home.step();
        }"""
    )
    assert clocks(page) == pytest.approx([9.0, 9.0])
    assert page.evaluate("home.lines[0].run.machine.get('streams.due')") < 40


@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["wide", "narrow"])
def test_it_fits_the_screen_moves_by_itself_and_pauses(show, size):
    page = show(size=size, **MOVING)
    wait_for(page, "home.lines[0].run.time > 9.3")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert page.text_content("#state") == ""  # nothing is said while numbers run
    page.click("#start")
    at = clocks(page)
    page.wait_for_timeout(300)
    assert clocks(page) == at
    assert re.search(r"Every module: \d+ deliveries, .+; \d+ wait", page.text_content("#state"))
    page.keyboard.press("Space")  # on the button
    wait_for(page, f"home.lines[0].run.time > {at[0] + 0.1}")
    page.click("#again")
    wait_for(page, f"home.lines[0].run.time < {at[0]}")


@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["wide", "narrow"])
def test_labels_of_exits_cover_no_module(show, size):
    """Where the modules are the picture is the same without any label."""
    page = show(size=size)
    same = page.evaluate(
        """() => {
          const { picture, run } = home.lines[0];
          const frame = { ...run.frame({ share: 0 }), parcels: [] };
          const { origin, columns, rotor, pitch: [px, py] } = picture.surface;
          const modules = [...rotor.keys()].filter((k) => rotor[k]);
          const across = modules.map((k) => origin[0] + (k % columns) * px);
          const up = modules.map((k) => origin[1] + Math.floor(k / columns) * py);
          const [left, top] = picture.toCanvas(
            Math.min(...across) - px / 2, Math.max(...up) + py / 2);
          const [right, bottom] = picture.toCanvas(
            Math.max(...across) + px / 2, Math.min(...up) - py / 2);
          const see = () => {
            picture.draw(frame);
            const { context, ratio } = picture;
            const box = [left, top, right - left, bottom - top].map((each) => each * ratio);
            return context.getImageData(...box).data.join();
          };
          const whole = () => picture.canvas.toDataURL();
          const [labelled, all] = [see(), whole()];
          for (const mark of picture.surface.marks) mark.label = "";
          return [see() === labelled, whole() === all];
        }"""
    )
    assert same == [True, False]


def test_it_waits_for_its_reader_where_motion_is_reduced(show):
    page = show()
    page.wait_for_timeout(300)
    assert clocks(page) == pytest.approx([9.0, 9.0])
    assert page.inner_text("#start") == "Start"
    page.click("#start")
    wait_for(page, "home.lines[0].run.time > 9.3")


def test_all_controls_and_readings_have_names(show):
    page = show()
    check_controls(page)
    assert page.get_attribute("#rate", "aria-valuetext") == "13\u202f000 boxes an hour"
    assert page.locator("dl > div > dt + dd").count() == page.locator("dd").count() == 10


@pytest.fixture(scope="module")
def around(built, tmp_path_factory):
    """A page with the film and the site's script, with the playground beside it."""
    folder = tmp_path_factory.mktemp("around")
    beside = folder / "playground"
    beside.mkdir()
    needed = (*web.HOME, "flow.wasm", "agent-flow-obeying.wasm")
    for file in built.folder.iterdir():
        scheduled = file.name.startswith(("agent-home-", "agent-schedule"))
        if file.suffix in (".js", ".css", ".html") or scheduled or file.name in needed:
            shutil.copy(file, beside)
    for name in ("live.js", "theme.js"):
        shutil.copy(DOCS / "assets" / name, folder)
    (folder / "index.html").write_text(
        '<!doctype html><html lang="en"><title>Home</title><link rel="icon" href="data:,">'
        "<style>iframe { width: 100%; border: 0 } p + div { height: 3000px }</style>"
        '<body data-md-color-scheme="default">'
        '<div id="live"><p><img alt="a film"></p></div>'
        '<script type="module" src="live.js"></script><p>More</p><div></div>'
        '<script type="module" src="theme.js"></script></body></html>'
    )
    made = Site(folder)
    yield made
    made.close()


@pytest.fixture
def read(tab, around):
    def opened(size=WIDE, missing="", **options):
        page = tab(size, **options)
        if missing:
            page.route(f"**/{missing}", lambda route: route.fulfill(status=404))
        page.goto(f"{around.address}index.html")
        return page

    return opened


@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["wide", "narrow"])
def test_it_takes_the_film_s_place_in_the_site_s_colours_while_it_is_seen(read, size):
    page = read(size)
    page.wait_for_selector("#live iframe")
    assert page.locator("#live img").count() == 0
    frame = page.frames[1]
    wait_for(frame, "home.lines[0].run.time > 9.3")
    wait_for(frame, "Math.abs(innerHeight - document.documentElement.offsetHeight) <= 1")
    assert frame.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert frame.evaluate("home.lines[0].picture.colours.paper") == "#ffffff"
    page.evaluate("document.body.dataset.mdColorScheme = 'slate'")
    wait_for(frame, "home.lines[0].picture.colours.paper === '#12161b'")
    page.evaluate("scrollTo(0, document.body.scrollHeight)")
    wait_for(frame, "!home.isRunning")
    page.evaluate("scrollTo(0, 0)")
    wait_for(frame, "home.isRunning")
    assert frame.get_attribute("a", "target") == "_top"
    assert frame.get_attribute("a", "href") == "playground.html"


def test_the_film_stays_where_scripts_do_not_run(read):
    page = read(java_script_enabled=False)
    assert page.locator("#live img").count() == 1
    assert page.locator("iframe").count() == 0


def test_the_film_stays_where_no_playground_is_beside(read):
    page = read(missing="home.json")
    page.wait_for_load_state("networkidle")
    assert page.locator("#live img").count() == 1
    assert page.locator("iframe").count() == 0


def test_the_film_stays_where_the_lines_cannot_run(read):
    page = read(missing="flow.wasm")
    message = page.frame_locator("#live iframe").locator("#message")
    message.filter(has_text="flow.wasm could not be loaded").wait_for(state="attached")
    assert page.locator("#live img").is_visible()
    assert not page.locator("iframe").is_visible()

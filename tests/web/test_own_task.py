"""A custom task in the playground: the script that the page saves gives the same run."""

import json
from pathlib import Path
from typing import Any

import pytest

from surface_gym.agents.library import find_task
from surface_gym.web.build import CAMERA, NOISE, write_own, write_task
from surface_gym.web.scene import TaskScene
from tests.environments import run_python
from tests.web.conftest import Site, copy_newer, wait_for

REACH = Path(__file__).parents[2] / "examples" / "reach.py"


@pytest.fixture(scope="module")
def own(site: Site, modules: Path) -> str:
    site.add("sort")
    task = find_task(f"{REACH}:Reach")
    name = write_own(task, site.folder, site.folder)
    copy_newer(site.folder, modules)
    return name


def turn_some(page: Any) -> None:
    """Turn some modules now and then, so that axes differ, until the run is over."""
    page.evaluate(
        """() => {
          const { run } = playground.shown[0];
          playground.pause();
          for (let k = 0; !run.over; k++) {
            const some = run.modules().filter((module) => module % 5 === k % 5);
            if (k % 7 === 0) playground.turn(run, some, k % 2 ? 0.785 : -0.785);
            run.advance();
          }
          playground.isStale = true;
        }"""
    )


@pytest.mark.parametrize(
    "faults", [{}, {"stuck": [[8, 9], [7, 12], [8, 12]]}, {"camera": True}], ids=str
)
def test_its_script_gives_the_same_end_in_another_process(own, site, visit, tmp_path, faults):
    if "camera" in faults:
        write_task(NOISE, site.folder)
        write_task(own + CAMERA, site.folder, find_task(f"{REACH}:Reach"))
    page = visit(TaskScene(own, 3, tasks=(own,)).url())
    wait_for(page, f"globalThis.playground?.scene?.task === '{own}'")
    page.evaluate(f"playground.reopen({json.dumps(faults)})")
    wait_for(page, f"playground.scene.camera === {json.dumps('camera' in faults)}")
    turn_some(page)
    with page.expect_download() as saved:
        page.click("#python")
    script = tmp_path / "scene.py"
    saved.value.save_as(script)
    words = run_python(script.name, folder=tmp_path).split()
    over, *numbers = page.evaluate(
        """(({ run }) => [run.over, run.rewards, run.time,
             ...run.machine.view('parcels.truth')])(playground.shown[0])"""
    )
    assert numbers == [float(each) for each in words[:2] + words[-6:]]
    assert over == " ".join(words[2:-6])

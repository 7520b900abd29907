"""Speed of the playground in headless Chromium: time to the first motion, and time of the physics.

python -m benchmarks.page FOLDER

`surface-gym web FOLDER` writes the folder. The benchmark needs Playwright and Chromium.
"""

import argparse
import gzip
import math
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright

import surface_gym as sg
from surface_gym.web.scene import TableScene, ThrownParcel

CHROMIUM = "/usr/bin/chromium"
PARCELS = 24
SECONDS = 6.0  # of the run that is timed
SIZES = (0.2, 0.35)  # [m]


class Server(SimpleHTTPRequestHandler):
    """A server of files, which records their compressed sizes."""

    zipped: dict[str, int] = {}

    def log_message(self, *_: Any) -> None:
        """Write nothing."""

    def send_head(self) -> Any:
        """Answer a request, and record the size [bytes] of the compressed file."""
        file = Path(self.translate_path(self.path))
        if file.is_file():
            self.zipped[self.path] = len(gzip.compress(file.read_bytes(), mtime=0))
        return super().send_head()


def crowd() -> TableScene:
    """Make parcels that collide on a table of 800 modules, and slide on for seconds."""
    parcels = []
    for k, parcel in enumerate(sg.parcel.assortment(PARCELS, 0, SIZES)):
        row, column = divmod(k, 6)
        pose = (0.4 + 0.62 * column, 0.3 + 0.45 * row, 0.3 * k)
        parcels.append(ThrownParcel(parcel, pose, (1.5 - 0.5 * column, 0.6 * (1.5 - row), 1.0)))
    axis = np.where(np.arange(800).reshape(20, 40) % 2, math.pi / 4, -math.pi / 4)
    surface = sg.Surface(axis, np.ones((20, 40), dtype=bool), mu_max=0.05)
    return TableScene(surface, tuple(parcels), duration=20.0)


def main() -> None:
    """Measure the pages in a folder."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.page", description=__doc__)
    parser.add_argument("folder", type=Path, help="that `surface-gym web` has written")
    folder = parser.parse_args().folder
    handler = partial(Server, directory=str(folder))
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://127.0.0.1:{server.server_port}/"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        times = []
        for _ in range(3):
            page = browser.new_context().new_page()
            page.goto(f"{address}playground.html")
            page.wait_for_selector("canvas")
            while not (moved := page.evaluate("playground.moved")):
                page.wait_for_timeout(20)
            times.append(moved / 1000)
            page.close()
        print(f"to the first moving picture: {min(times):.2f} s, the best of {len(times)}; "
              f"{sum(Server.zipped.values()) / 1000:.0f} kB zipped")  # fmt: skip
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.goto(address + crowd().url())
        page.wait_for_selector("canvas")
        page.click("#start")
        page.wait_for_timeout(1000 * SECONDS)
        found = page.evaluate(
            "(({ share, frames, shown }) => [share, frames, shown[0].run.time])(playground)"
        )
        share, frames, time = found
        alone = page.evaluate(
            """() => {
              const { run } = playground.shown[0];
              playground.pause();
              run.begin();
              const before = performance.now();
              for (let k = 0; k < 400; k++) run.advance();
              return (performance.now() - before) / 2000;
            }"""
        )
        present = page.evaluate("playground.shown[0].run.frame().parcels.length")
        print(f"{PARCELS} parcels, {present} left after 2 s: physics takes {share:.1%} of a frame, "
              f"at {frames / SECONDS:.0f} frames a second, in which {time / SECONDS:.2f} s passed "
              f"each second; stepped alone it takes {alone:.1%} of real time")  # fmt: skip
        browser.close()
    server.shutdown()


if __name__ == "__main__":
    main()

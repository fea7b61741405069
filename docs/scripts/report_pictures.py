"""Draw the screenshots of docs/report.md: `python docs/scripts/report_pictures.py PAPER POPULATION TIMED`.

The arguments are folders of runs: of the suites `paper` and `population`, and of a run with --timing.
Needs playwright and Chromium.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

IMAGES = Path(__file__).parent.parent / "images"
FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
WIDTH = 1280
SHOTS = {  # name: run, address, height, colour scheme
    "report-images": (0, "#view=images&snr=10&est=music2d&est=fft4d", 1460, "light"),
    "report-curves": (0, "#view=curves&point=-10|music2d", 800, "light"),
    "report-maps": (0, "#view=maps", 560, "dark"),
    "report-overview": (1, "#view=overview", 900, "light"),
    "report-scenes": (1, "#view=scenes", 720, "light"),
    "report-time": (2, "#view=time", 760, "light"),
}


def main(folders: list[Path]) -> None:
    """Take all screenshots."""
    executable = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=executable, args=FLAGS)
        for name, (number, address, height, scheme) in SHOTS.items():
            page = browser.new_page(viewport={"width": WIDTH, "height": height}, color_scheme=scheme)
            page.goto((folders[number] / "report.html").resolve().as_uri() + address)
            page.wait_for_selector("body[data-ready]")
            page.wait_for_timeout(6000)
            page.screenshot(path=IMAGES / f"{name}.png")
            page.close()
        browser.close()


if __name__ == "__main__":
    main([Path(folder) for folder in sys.argv[1:]])

"""The pictures of the report, by `python docs/pictures/make.py` from the root of the repository: the bundled
logs are identified, and their report is looked at in a Chromium that is installed already, in light."""

import io
import shutil
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from sysid.command.cli import main

HERE = Path(__file__).parent
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
COLOURS = 256  # of a picture, which makes it half of its size
VIEWS = {  # pixels of the window, how many of the screen are one of them, and what to scroll to
    "report": ((1100, 1000), 1, "body"),
    "report_figures": ((1100, 1000), 1, "figure"),
    "report_phone": ((390, 844), 2, "body"),
    "report_phone_figures": ((390, 844), 2, "figure"),
}


def taken(page: Page, to: str) -> Image.Image:
    """What the window shows when it is scrolled so that the first of `to` is at its top."""
    page.evaluate("to => document.querySelector(to).scrollIntoView()", to)
    shown = Image.open(io.BytesIO(page.screenshot()))
    return shown.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)


def make(report: Path) -> None:
    """All pictures of a report."""
    path = next(filter(None, map(shutil.which, BROWSERS)))
    with sync_playwright() as run:
        browser = run.chromium.launch(executable_path=path, args=["--no-sandbox"])
        for name, ((width, height), scale, to) in VIEWS.items():
            page = browser.new_page(
                viewport={"width": width, "height": height}, device_scale_factor=scale, color_scheme="light"
            )
            page.goto(report.resolve().as_uri())
            taken(page, to).save(HERE / f"{name}.png", optimize=True)
        browser.close()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        main(["data/synthetic/*.csv", "-o", folder])
        make(Path(folder) / "report.html")

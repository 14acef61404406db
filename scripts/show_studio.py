"""Picture of the studio: the page in a headless Chromium, after a push.

Needs Debian's package `chromium` and the extras `studio` and `dev`.
"""

import argparse
import io
import shutil
import warnings
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, ViewportSize, sync_playwright

from cmf_mj.cli.common import refuse
from cmf_mj.show.studio.server import Studio

SIZE = ViewportSize(width=1440, height=900)
"""Of the picture [px]."""

ARGUMENTS = (
    *("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"),
)
"""Chromium without a GPU: WebGL in software."""

PATIENCE = 120_000
"""Longest wait for the page [ms]."""


def begin(page: Page, url: str, seconds: float) -> None:
    """Open the page, push the platform and let some time pass."""
    page.set_default_timeout(PATIENCE)
    page.goto(url)
    page.get_by_text("real-time factor").wait_for()
    for button in page.locator(".mantine-Notification-closeButton").all():
        button.click()
    page.get_by_label("push", exact=True).first.click()
    page.get_by_role("option", name="left", exact=True).click()
    page.get_by_label("push now", exact=True).first.click()
    page.mouse.move(SIZE["width"] / 2, SIZE["height"] / 2)
    page.wait_for_timeout(1000.0 * seconds)


def main() -> None:
    """Parse the arguments and write the picture."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.png")
    parser.add_argument("--seconds", type=float, default=12.0, help="time before the picture")
    parser.add_argument("--port", type=int, default=8471, help="TCP port")
    arguments = parser.parse_args()
    chromium = shutil.which("chromium")
    if chromium is None:
        refuse(ValueError("no Chromium to open the page in: apt-get install chromium"))
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection")
    studio = Studio(port=arguments.port)
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium, args=list(ARGUMENTS))
            page = browser.new_page(viewport=SIZE)
            begin(page, studio.url, arguments.seconds)
            arguments.out.parent.mkdir(parents=True, exist_ok=True)
            picture = Image.open(io.BytesIO(page.screenshot(timeout=PATIENCE)))
            picture.quantize(256, Image.Quantize.MAXCOVERAGE).save(arguments.out, optimize=True)
            browser.close()
    finally:
        studio.stop()
    print(arguments.out)


if __name__ == "__main__":
    main()

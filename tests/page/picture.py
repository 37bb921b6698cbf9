"""Makes the picture of the page in README.md: what a reader sees a minute after the first command.

picture.py PROGRAM [OUT]     OUT: docs/images/watch.png unless given
"""

import pathlib
import shutil
import subprocess
import sys
import tempfile

from page import watching
from playwright.sync_api import expect, sync_playwright

# As wide as GitHub shows a README, with two pixels for each.
SCREEN = {"width": 880, "height": 1000}
HERE = pathlib.Path(__file__).resolve().parents[2]


def first_command():
    """The first command of README.md, without cargo's part."""
    line = next(line for line in (HERE / "README.md").read_text().splitlines() if line.startswith("    cargo run"))
    return line.partition(" -- ")[2].split()


def main():
    program = str(pathlib.Path(sys.argv[1]).resolve())
    out = pathlib.Path(sys.argv[2] if len(sys.argv) > 2 else HERE / "docs/images/watch.png").resolve()
    with tempfile.TemporaryDirectory() as place:
        # The same seed without a mentor is what a reader types next.
        for command in (first_command(), [word if word != "trestle" else "dqn" for word in first_command()]):
            subprocess.run([program, *command], cwd=place, check=True, capture_output=True, timeout=300)
        (run,) = (path.name for path in pathlib.Path(place, "runs").iterdir() if "dqn" not in path.name)
        with watching(program, str(pathlib.Path(place, "runs"))) as url, sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
            page = browser.new_page(viewport=SCREEN, color_scheme="light", reduced_motion="reduce", device_scale_factor=2)
            page.goto(f"{url}/run/{run}")
            expect(page.locator(".stage svg")).to_be_visible(timeout=60_000)
            expect(page.locator(".legend li").first).to_be_visible(timeout=60_000)
            page.wait_for_timeout(1500)
            card = page.locator("section.card").nth(1).bounding_box()
            clip = {"x": 0, "y": 0, "width": SCREEN["width"], "height": round(card["y"] + card["height"] + 12)}
            page.screenshot(path=out, clip=clip, full_page=True)
            browser.close()
    print(f"{out}: {out.stat().st_size >> 10} KiB")


if __name__ == "__main__":
    main()

"""Makes docs/viewer.webp, the picture that moves at the top of README and of the site: the viewer of a body in headless
Chromium, some of its modes one after the other.

    python -m scripts.animate pipelines/connecting_rod.h5

The file is refused above 600 kB, which is what a page of a project may ask of its readers.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from morembs.app.jobs.viewing import scene_of_files
from morembs.fem.viewer import viewer_page
from tests.support.browser import Page, browser

TARGET = Path(__file__).resolve().parents[1] / "docs" / "viewer.webp"
VIEWER = "document.querySelector('.morembs-viewer').viewer"
WIDTH, HEIGHT = 900, 400
MODES, FRAMES, TURNS = (0, 1, 3), 20, 1
MILLISECONDS, LARGEST_BYTES = 70, 600_000


def pictures(page: Page) -> list[Image.Image]:
    """Frames of each mode through its swings; the part turns a little all the while."""
    frames = []
    page.run("document.querySelector('h1').remove(), 1")
    page.run(f"{VIEWER}.play(false), {VIEWER}.fit(), 1")
    for mode in MODES:
        page.run(f"{VIEWER}.choose(0, {mode}), 1")
        for number in range(FRAMES * TURNS):
            phase = np.sin(2 * np.pi * number / FRAMES)
            sway = 0.02 * np.cos(np.pi * (number + 0.5) / FRAMES)
            page.run(f"{VIEWER}.turn({sway}, 0), {VIEWER}.phase = {phase}, {VIEWER}.paint(), 1")
            frames.append(Image.fromarray(page.picture().astype(np.uint8)))
    return frames


def main() -> int:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("body", type=Path)
    parser.add_argument("-o", "--out", type=Path, default=TARGET)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        html = Path(name) / "body.html"
        html.write_text(viewer_page(scene_of_files([given.body])[0]), encoding="utf-8")
        with browser(Path(name)) as page:
            page.open(html, WIDTH, HEIGHT)
            page.wait(f"{VIEWER}?.drawing")
            frames = pictures(page)
    moving = {"save_all": True, "append_images": frames[1:], "duration": MILLISECONDS, "loop": 0, "method": 4}
    for quality in (70, 55, 40, 25):
        frames[0].save(given.out, quality=quality, **moving)
        size = given.out.stat().st_size
        if size <= LARGEST_BYTES:
            print(f"{given.out}: {len(frames)} pictures, {size:,} bytes, quality {quality}")
            return 0
    print(f"{given.out} has {size:,} bytes; at most {LARGEST_BYTES:,} are allowed", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())

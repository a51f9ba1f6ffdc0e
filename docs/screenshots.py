"""Pictures of the report and of the machine drawing, for docs/images.

Runs the demo in a scratch folder and opens what it wrote in a headless Chromium. Pictures have a
palette of 128 colours and must stay below 300 kB.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from generators.paths import DOCS, ROOT
from PIL import Image

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
LARGEST = 300_000
"""Bytes that a picture may have."""
MACHINE = "hexapod.yaml"
COMMANDS = (("demo", "--out", "demo"), ("check", MACHINE, "--draw", "machine.html"))


@dataclass(frozen=True)
class Shot:
    """One picture: its name, the page below the scratch folder, width and height in pixels."""

    name: str
    page: str
    width: int = 1280
    height: int = 900


SHOTS = (Shot("report", "demo/report.html"), Shot("report-narrow", "demo/report.html", 390, 844),
         Shot("machine", "machine.html", 1280, 860))


def browser() -> str:
    """Return the path of a Chromium.

    Raises:
        SystemExit: there is none.
    """
    found = next((p for p in map(shutil.which, BROWSERS) if p), None)
    if found is None:
        raise SystemExit(f"A Chromium is needed: none of {', '.join(BROWSERS)} is installed.")
    return found


def take(shot: Shot, folder: Path, target: Path) -> None:
    """Take a picture of a page, once its scripts have drawn."""
    pages = sorted(folder.glob(shot.page)) or sorted(folder.rglob(Path(shot.page).name))
    raw = folder / f"{shot.name}.png"
    # a window narrower than 500 px is widened by Chromium: a frame of that width is not
    narrow = shot.width < 500
    page = folder / "frame.html"
    size = f"border:0;width:{shot.width}px;height:{shot.height}px"
    page.write_text(f'<body style="margin:0"><iframe src="{pages[0].as_uri()}" style="{size}">'
                    "</iframe>", encoding="utf-8")
    subprocess.run(
        [browser(), "--headless=new", "--no-sandbox", "--hide-scrollbars", "--disable-gpu",
         "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--allow-file-access-from-files",
         f"--user-data-dir={folder / 'profile'}", "--force-device-scale-factor=1",
         f"--window-size={shot.width},{shot.height}", "--virtual-time-budget=20000",
         f"--screenshot={raw}", (page if narrow else pages[0]).as_uri()],
        check=True, capture_output=True, timeout=180)
    with Image.open(raw) as picture:
        small = picture.convert("RGB").crop((0, 0, shot.width, shot.height))
        small.quantize(128, dither=Image.Dither.NONE).save(target, optimize=True)
    used = target.stat().st_size
    if used > LARGEST:
        raise SystemExit(f"{target.name} has {used} bytes, more than {LARGEST}.")
    print(f"{target.name}: {used // 1000} kB")


def main() -> None:
    """Run the commands, then take all pictures."""
    (DOCS / "images").mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        shutil.copy(ROOT / "sample_data" / MACHINE, folder)    # a picture shows no path of a desk
        for words in COMMANDS:
            done = subprocess.run([sys.executable, "-m", "ppmcal", *words], cwd=folder,
                                  capture_output=True, text=True, check=False)
            if done.returncode > 1:
                raise SystemExit(done.stderr)
        for shot in SHOTS:
            take(shot, folder, DOCS / "images" / f"{shot.name}.png")


if __name__ == "__main__":
    main()

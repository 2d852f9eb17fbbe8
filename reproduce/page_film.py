"""The film of the page in use, docs/page/film.webp: a leg is dragged, and the walker walks on.

    python -m reproduce.page_film

Needs playwright (requirements-extras.lock) and a chromium in the PATH.
"""

import io
import shutil

from PIL import Image
from playwright.sync_api import sync_playwright

from reproduce.page import TARGET

FRAMES_PER_SECOND = 10
WIDTH, HEIGHT = 640, 474  # pixels
PULLED = ((7, -6),) * 9  # pixels a frame, of a leg's end


def main() -> None:
    frames = []
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 1000, "height": 740})
        # Time passes frame by frame, however long a picture takes.
        page.clock.install(time=0)
        page.goto(TARGET.as_uri())
        page.wait_for_function("window.designrl")
        page.evaluate("document.querySelector('#playground').scrollIntoView({behavior: 'instant'})")

        def shoot(count: int = 1) -> None:
            for _ in range(count):
                page.clock.run_for(1000 // FRAMES_PER_SECOND)
                picture = Image.open(io.BytesIO(page.screenshot()))
                frames.append(picture.convert("RGB").resize((WIDTH, HEIGHT)))

        page.clock.pause_at(60)
        page.clock.run_for(3000)
        shoot(14)
        box = page.locator("#playground canvas").first.bounding_box()
        x, y = find_end(page, box)
        page.mouse.down()
        for dx, dy in PULLED:
            x, y = x + dx, y + dy
            page.mouse.move(x, y)
            shoot()
        page.mouse.up()
        page.mouse.move(box["x"] + box["width"] - 20, box["y"] + 60)
        shoot(30)
        browser.close()
    frames[0].save(
        TARGET.with_name("film.webp"),
        save_all=True,
        append_images=frames[1:],
        duration=1000 // FRAMES_PER_SECOND,
        loop=0,
        quality=40,
        method=6,
    )


def find_end(page, box: dict) -> tuple[float, float]:
    """Where the lowest end of a leg is; the mouse is there."""
    near = "document.querySelector('#playground canvas').classList.contains('near')"
    for down in range(88, 40, -3):
        for right in range(22, 50, 2):
            x, y = box["x"] + box["width"] * right / 100, box["y"] + box["height"] * down / 100
            page.mouse.move(x, y)
            if page.evaluate(near):
                return x, y
    raise SystemExit("there is no leg in the picture")


if __name__ == "__main__":
    main()

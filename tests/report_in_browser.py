"""Opens the page that `vorofit fit --report` writes in headless Chromium, as its user would from the disk, and holds it to its own JSON.

pip install playwright pillow numpy; Chromium as `chromium` on the path, or as the second argument
cargo run --release -- demo && python tests/report_in_browser.py vorofit-demo/report
"""

import base64
import contextlib
import io
import json
import pathlib
import shutil
import sys

import numpy
from PIL import Image
from playwright.sync_api import sync_playwright

page_file = pathlib.Path(sys.argv[1]).resolve() / "index.html"
chromium = sys.argv[2] if len(sys.argv) > 2 else shutil.which("chromium")
SOFTWARE_GL = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def pixels(page):
    """The view without what lies over it."""
    page.evaluate("for (const id of ['tools', 'legend', 'hint']) { const e = document.getElementById(id); if (e) e.style.visibility = 'hidden'; }")
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return numpy.asarray(Image.open(io.BytesIO(page.locator("#canvas").screenshot())).convert("RGB"), int)


def drawn(image):
    """The share of the pixels that are not background, which there is near the corner."""
    return (abs(image - image[20, 20]).max(2) > 12).mean()


def check_view(page):
    scene = json.loads(page.locator("#scene").text_content())
    counts = {name: layer["triangles"] for name, layer in scene["layers"].items()}
    shown = lambda: int(page.locator("#canvas").get_attribute("data-triangles"))
    first = pixels(page)
    assert shown() == counts["surface"], (shown(), counts)
    assert 0.08 < drawn(first) < 0.9, drawn(first)
    assert len(numpy.unique(first.reshape(-1, 3), axis=0)) > 200, "shaded and coloured"

    box = page.locator("#canvas").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(*middle)
    page.mouse.down()
    page.mouse.move(middle[0] + 150, middle[1] + 40, steps=4)
    page.mouse.up()
    turned = pixels(page)
    assert (abs(turned - first).max(2) > 12).mean() > 0.03, "it turns"
    page.mouse.wheel(0, -400)
    assert drawn(pixels(page)) > 1.2 * drawn(turned), "it zooms"
    page.evaluate("document.getElementById('reset').click()")
    assert abs(pixels(page) - first).max() <= 2, "it comes back"

    layers = {"surface": True, "cage": True, "target": False}
    sets = [("target",), ("cage",), ("surface",), ()]
    pictures = []
    for wanted in sets:
        for name in layers:
            page.evaluate("([id, on]) => { const box = document.getElementById(id); if (box.checked !== on) box.click(); }",
                          [f"show-{name}", name in wanted])
        pictures.append(pixels(page))
        assert shown() == sum(counts[name] for name in wanted), wanted
        assert (drawn(pictures[-1]) > 0.05) == bool(wanted), wanted
    for a, b in zip(pictures, pictures[1:]):
        assert (abs(a - b).max(2) > 12).mean() > 0.03, "the layers differ"


def check_features(page):
    sorts = json.loads(page.locator("#scene").text_content())["features"]
    counts = [sum(len(base64.b64decode(lines["ends"])) // 16 for lines in sort["lines"]) for sort in sorts]
    assert len(counts) == 6 and sum(counts) > 20, counts
    drawn_lines = lambda: int(page.locator("#canvas").get_attribute("data-features"))
    tick = lambda box: page.evaluate("(box) => box.click()", box.element_handle())
    everything, boxes = page.locator("#show-features"), page.locator("#features input")
    only_scan = page.locator("#show-target")
    tick(only_scan)
    without = pixels(page)
    assert drawn_lines() == 0 and page.locator("#features").get_attribute("hidden") is not None
    tick(everything)
    everywhere = pixels(page)
    assert drawn_lines() == sum(counts) and boxes.count() == len(sorts)
    assert (abs(everywhere - without).max(2) > 60).mean() > 0.001, "lines on the scan"
    for k, sort in enumerate(sorts):
        shown = (abs(everywhere - numpy.array(sort["color"])).max(2) <= 2).sum()
        hidden = (abs(without - numpy.array(sort["color"])).max(2) <= 2).sum()
        assert counts[k] == 0 or shown >= hidden, sort["name"]
        tick(boxes.nth(k))
        assert drawn_lines() == sum(counts[k + 1:]), sort["name"]
        pixels(page)
    tick(everything)
    tick(only_scan)


def check_numbers(page):
    report = json.loads(page.locator("#report").text_content())
    cells = page.locator("[data-key]").all()
    for cell in cells:
        value = report
        for key in cell.get_attribute("data-key").split("."):
            value = value[key]
        shown = float(cell.inner_text().replace(",", ""))
        digits = int(cell.get_attribute("data-digits") or 3)
        exact = shown == value if isinstance(value, int) else abs(shown - value) <= 0.51 * 10.0 ** (1 - digits) * abs(value)
        assert exact, (cell.get_attribute("data-key"), shown, value)
    assert len(cells) > 15
    print(f"{len(cells)} numbers, largest error {report['error']['max_percent']:.3f} %")


@contextlib.contextmanager
def opened(browser, **options):
    """The page in a window of its own, which must not complain, nor ask for anything outside, nor be wider than the window."""
    context = browser.new_context(**options)
    page = context.new_page()
    complaints, requests = [], []
    page.on("console", lambda message: complaints.append(message.text) if message.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(page_file.as_uri())
    page.wait_for_timeout(500)
    yield page
    # Reading pixels back is what the screenshots here cost; the driver says so.
    complaints = [text for text in complaints if "ReadPixels" not in text]
    assert not complaints, complaints
    outside = [url for url in requests if not url.startswith(("data:", page_file.as_uri()))]
    assert not outside, outside
    wide = page.locator("html").evaluate("page => page.scrollWidth - page.clientWidth")
    assert wide <= 0, f"{wide} pixels stick out"
    context.close()


def picture(page, name):
    page.screenshot(path=page_file.parent.parent / f"screenshot-{name}.png", full_page=True)


def check_pictures(page):
    assert page.locator("#pictures").is_visible() and not page.locator("#canvas").is_visible()
    assert page.locator("#pictures img").count() == 3
    for image in page.locator("#pictures img").all():
        assert image.bounding_box()["width"] > 200


with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=chromium, args=SOFTWARE_GL)
    for scheme in ["light", "dark"]:
        with opened(browser, color_scheme=scheme, viewport={"width": 1280, "height": 900}) as page:
            picture(page, scheme)
            check_view(page)
            check_features(page)
            check_numbers(page)
    with opened(browser, viewport={"width": 390, "height": 800}, has_touch=True) as page:
        picture(page, "telephone")
    with opened(browser, java_script_enabled=False) as page:
        check_pictures(page)
    browser.close()
    browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu", "--disable-3d-apis"])
    with opened(browser) as page:
        check_pictures(page)
        picture(page, "without-webgl")
    browser.close()
print("the page holds")

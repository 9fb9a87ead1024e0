"""The guide at /docs and the reference that follows it. Every example of the guide runs: the shell
and Python files in a folder of their own, the JavaScript by the page's Run buttons. Neither page
sends requests to other hosts."""

import html
import io
import json
import re
import subprocess
import sys
import time
from pathlib import Path

import httpx
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from PIL import Image

from support import KEPT, Server, crossed

KEY = "a-key-of-the-tests-0123456789"
ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "src/web/docs/examples"
WRITTEN = "http://127.0.0.1:8080"


@pytest.fixture(scope="module")
def locked():
    server = Server("--keys", f"ann {KEY}")
    yield server
    server.stop()


@pytest.fixture
def docs(browser):
    """Opens a page; at the end there must be no browser errors and no requests to other hosts."""
    contexts, trouble = [], []

    def opened(server, path="/docs", ready='body[data-state="ready"]', **options):
        context = browser.new_context(**{"viewport": {"width": 1280, "height": 900}, **options})
        contexts.append(context)
        own = (f"{server.address}/", f"ws{server.address[4:]}/")
        context.on(
            "request",
            lambda request: (
                request.url.startswith((*own, "data:", "blob:"))
                or trouble.append(f"asked for {request.url}")
            ),
        )
        page = context.new_page()
        # The example of an error is answered 422, which the browser reports.
        page.on(
            "console",
            lambda said: (
                said.type in ("error", "warning")
                and "422" not in said.text
                and trouble.append(said.text)
            ),
        )
        page.on("pageerror", lambda error: trouble.append(str(error)))
        answer = page.goto(f"{server.address}{path}")
        policy = answer.headers["content-security-policy"]
        assert (
            policy.startswith("default-src 'none'; script-src 'self'; style-src 'self'")
            and "://" not in policy
        )
        page.wait_for_selector(ready)
        return page

    yield opened
    for context in contexts:
        context.close()
    assert not trouble, "\n".join(trouble)


def names():
    return sorted(file.stem for file in EXAMPLES.glob("*.js") if file.stem != "here")


@pytest.mark.parametrize("language", ["sh", "py"])
def test_the_examples_run_as_they_are_shown(server, language, tmp_path):
    files = sorted(
        EXAMPLES.glob(f"*.{language}"), key=lambda file: (file.stem != "warp", file.stem)
    )
    assert len(files) >= 8
    for file in files:
        text = file.read_text()
        assert WRITTEN in text, file.name
        copy = tmp_path / file.name
        copy.write_text(text.replace(WRITTEN, server.address))
        command = ["bash", "-euo", "pipefail", copy] if language == "sh" else [sys.executable, copy]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, f"{file.name}: {done.stdout}{done.stderr}"
        if file.stem == "errors":
            assert "unknown_field" in done.stdout and "method" in done.stdout, done.stdout
        if file.stem == "plan":
            assert 0 < float(done.stdout.rsplit(" ", 1)[1]) < 1e-4, done.stdout
    heads = {
        file.name: file.read_bytes()[:2]
        for file in tmp_path.glob("*.[pj][np]g")
        if file.name != "cat.jpg"
    }
    assert set(heads) >= {"warped.png", "lines.png", "rigid.jpg", "small.jpg", "drag-130.png"}, (
        heads
    )
    assert all(
        head == (b"\x89P" if name.endswith("png") else b"\xff\xd8") for name, head in heads.items()
    ), heads


@pytest.mark.parametrize(
    "recipe, result, most", [("cv2", "remapped.png", 2), ("scipy", "mapped.png", 2)]
)
def test_the_recipes_for_maps_give_the_picture_of_a_warp(server, recipe, result, most, tmp_path):
    """The warp enlarges, because these functions do not average over what a pixel shows."""
    page = (EXAMPLES.parent / "index.html").read_text()
    [text] = re.findall(rf'<pre id="recipe-{recipe}"[^>]*>(.*?)</pre>', page, re.S)
    # Decoders of JPEG differ from each other.
    picture = ROOT / "tests/images/chelsea.png"
    [warp] = re.findall(r"^warp = (.*)$", text, re.M)
    output = {"canvas": {"x": -30, "y": -20, "width": 511, "height": 340}, "width": 1022}
    code = (
        html.unescape(text)
        .replace("cat.jpg", str(picture))
        .replace('"extent"', f'**{output}, "extent"')
    )
    code = f"server = '{server.address}'\n{code}"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stdout + done.stderr
    warp = {**json.loads(html.unescape(warp)), "output": output}
    answer = httpx.post(
        f"{server.address}/warp",
        files={"image": picture.read_bytes(), "warp": (None, json.dumps(warp))},
    )
    ours = np.asarray(
        Image.open(io.BytesIO(answer.raise_for_status().content)).convert("RGBA")
    ).astype(int)
    theirs = np.asarray(Image.open(tmp_path / result).convert("RGB")).astype(int)
    assert ours.shape[:2] == theirs.shape[:2] == (680, 1022)
    is_drawn, ours = ours[..., 3] == 255, ours[..., :3]
    assert 0.7 < is_drawn.mean() < 1 and (theirs[~is_drawn] == 0).all()
    around = np.stack([np.roll(ours, (y, x), (0, 1)) for y in (-1, 0, 1) for x in (-1, 0, 1)])
    is_smooth = is_drawn & ((around.max(0) - around.min(0)).max(-1) <= 16)
    near = (np.abs(ours - theirs).max(-1) <= most)[is_smooth]
    print(f"{recipe}: {near.mean():.5f} of {near.size} smooth pixels within {most}/255")
    assert is_smooth.mean() > 0.4 and near.mean() >= 0.999, near.mean()


def test_every_run_button_shows_a_result(docs, server):
    page = docs(server)
    assert page.locator(".example").count() == len(names())
    for name in names():
        example = page.locator(f'.example[data-name="{name}"]')
        example.get_by_role("button", name="Run").click()
        example.locator("figure").first.wait_for()
        page.wait_for_function(
            "name => !document.querySelector(`.example[data-name='${name}'] .run`).disabled",
            arg=name,
        )
        text = example.locator(".results").inner_text()
        assert '"error": "' not in text, f"{name}: {text}"
        pictures = {
            "batch": 1,
            "lines": 1,
            "methods": 3,
            "output": 1,
            "session": 3,
            "drag": 1,
            "warp": 1,
            "caricature": 2,
            "landmarks": 1,
            "layers": 3,
        }.get(name, 0)
        assert example.locator("figure img").count() == pictures, f"{name}: {text}"
        if name == "errors":
            assert "unknown_field" in text, text
        if name == "plan":
            assert 0 < float(re.search(r'Server": ([-\d.e]+)', text)[1]) < 1e-4, text
    page.screenshot(path=KEPT / "docs-results.png", full_page=True)


def test_the_examples_use_the_key_of_the_page(docs, locked):
    page = docs(locked)
    page.evaluate(f"sessionStorage.setItem('mlswarp.key', '{KEY}')")
    page.reload()
    page.wait_for_selector('body[data-state="ready"]')
    for name in ("points", "drag"):
        example = page.locator(f'.example[data-name="{name}"]')
        example.get_by_role("button", name="Run").click()
        page.wait_for_function(
            "name => !document.querySelector(`.example[data-name='${name}'] .run`).disabled",
            arg=name,
        )
        text = example.locator(".results").inner_text()
        assert "unauthorized" not in text and '"error"' not in text and text, text


def test_the_notebook_of_the_recipes_shows_a_drag(server):
    [cell] = re.findall(
        r"^```python\n(.*?)^```$", (ROOT / "api/README.md").read_text(), re.M | re.S
    )
    assert WRITTEN in cell
    # A notebook has `display`.
    shown = "\nshown = []\ndisplay = lambda image: shown.append(image.tobytes())\n"
    script = f"{shown}{cell.replace(WRITTEN, server.address)}\nassert len(set(shown)) == 5"
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_language_is_chosen_for_all_examples_by_keyboard_and_remembered(docs, server):
    page = docs(server)
    tab = page.locator('.example[data-name="warp"]').get_by_role("tab", name="curl")
    tab.click()
    assert page.locator("#lines-sh").is_visible() and page.locator("#lines-py").is_hidden()
    page.keyboard.press("ArrowRight")
    assert page.evaluate("document.activeElement.id") == "warp-py-tab"
    assert page.locator("#lines-py").is_visible() and page.locator("#drag-py").is_visible()
    assert (
        server.address in page.locator("#warp-py").inner_text()
        and WRITTEN not in page.locator("main").inner_text()
    )
    page.reload()
    page.wait_for_selector('body[data-state="ready"]')
    assert page.locator("#lines-py").is_visible()


@pytest.mark.parametrize("width, scheme", crossed([1280, 360], ["light", "dark"]))
def test_the_guide_is_read_in_any_light_and_width(docs, server, scheme, width):
    page = docs(server, viewport={"width": width, "height": 900}, color_scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), (
        "the page never scrolls sideways"
    )
    found = Axe().run(page).response["violations"]
    assert not found, json.dumps(
        [(one["id"], [node["target"] for node in one["nodes"]]) for one in found]
    )
    page.screenshot(path=KEPT / f"docs-{scheme}-{width}.png", full_page=True)
    links = page.eval_on_selector_all("a[href]", "all => all.map((a) => a.href)")
    assert all(link.startswith(f"{server.address}/") for link in links), links
    for link in links:
        assert "#" not in link or page.locator(f"#{link.split('#')[1]}").count() == 1, link


@pytest.mark.parametrize("width, scheme", crossed([1280, 360], ["light", "dark"]))
def test_the_reference_shows_every_operation(docs, server, scheme, width):
    page = docs(
        server,
        "/docs/reference",
        "#reference h1",
        viewport={"width": width, "height": 900},
        color_scheme=scheme,
    )
    document = json.loads(server.ask("GET", "/openapi.json").body)
    summaries = [
        one["summary"]
        for item in document["paths"].values()
        for method, one in item.items()
        if method in ("get", "put", "post", "delete")
    ]
    assert len(summaries) > 15
    page.get_by_text("mlswarp", exact=True).first.wait_for()
    missing, until = summaries, time.monotonic() + 60
    while missing and time.monotonic() < until:
        # Sections are drawn when they come into view.
        page.mouse.move(width / 2, 450)
        page.mouse.wheel(0, 1500)
        page.wait_for_timeout(100)
        text = page.evaluate("document.body.textContent")
        missing = [summary for summary in missing if summary not in text]
    assert not missing, missing
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), (
        "the page never scrolls sideways"
    )
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.evaluate("scrollTo(0, 0)")
    page.screenshot(path=KEPT / f"reference-{scheme}-{width}.png")
    shown = page.eval_on_selector_all(
        "a[href]", "all => all.filter((a) => a.checkVisibility()).map((a) => a.href)"
    )
    assert all(link.startswith((f"{server.address}/", "blob:")) for link in shown), (shown, dark)


def test_the_page_at_the_root_leads_there(visit):
    visit.page.click("#help-open")
    with visit.page.expect_popup() as opened:
        visit.page.get_by_role("link", name="the API").click()
    opened.value.wait_for_selector('body[data-state="ready"]')
    assert opened.value.url == f"{visit.server.address}/docs"

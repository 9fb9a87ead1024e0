"""The API reference page: it shows every operation of `/openapi.json`, sends no requests to other hosts, and can send requests."""

import json
import re

import pytest

from support import KEPT, Server

KEY = "a-key-of-the-tests-0123456789"


@pytest.fixture(scope="module")
def locked():
    server = Server("--keys", f"ann {KEY}")
    yield server
    server.stop()


@pytest.fixture
def docs(browser):
    """Opens the page; at the end there must be no browser errors and no requests to other hosts."""
    contexts, trouble = [], []

    def opened(server, **options):
        context = browser.new_context(**{"viewport": {"width": 1280, "height": 900}, **options})
        contexts.append(context)
        own = f"{server.address}/"
        context.on("request", lambda request: request.url.startswith((own, "data:", "blob:")) or trouble.append(f"asked for {request.url}"))
        page = context.new_page()
        page.on("console", lambda said: said.type in ("error", "warning") and trouble.append(said.text))
        page.on("pageerror", lambda error: trouble.append(str(error)))
        answer = page.goto(f"{server.address}/docs")
        assert answer.headers["content-security-policy"].startswith("default-src 'none'; script-src 'self'; style-src 'self';")
        page.wait_for_selector(".opblock")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert not trouble, "\n".join(trouble)


def operations(server):
    document = json.loads(server.ask("GET", "/openapi.json").body)
    return [(method.upper(), path, operation) for path, item in document["paths"].items()
            for method, operation in item.items() if method in ("get", "put", "post", "delete")]


def test_every_operation_is_seen_and_opens(docs, server):
    page = docs(server)
    seen = [(block.locator(".opblock-summary-method").inner_text(), block.locator(".opblock-summary-path").inner_text().replace("\u200b", ""))
            for block in page.locator(".opblock").all()]
    listed = operations(server)
    assert len(listed) > 15
    assert {(method, path) for method, path, _ in listed} == set(seen)
    # Parameters, bodies, answers and their schemas of the largest one.
    block = page.locator(".opblock", has_text="Warp a picture").first
    block.locator(".opblock-summary-control").click()
    block.locator(".opblock-body").wait_for()
    text = block.inner_text()
    for word in ("session", "multipart/form-data", "200", "413", "422"):
        assert word in text, word


def test_a_request_is_tried_with_the_key_that_is_given(docs, locked):
    page = docs(locked)
    page.get_by_role("button", name="Authorize").click()
    page.locator(".auth-container input").fill(KEY)
    page.locator(".auth-container button[type=submit]").click()
    page.locator(".btn-done").click()
    block = page.locator(".opblock", has_text="/metrics").first
    block.locator(".opblock-summary-control").click()
    block.get_by_role("button", name="Try it out").click()
    with page.expect_response("**/metrics") as answered:
        block.get_by_role("button", name="Execute").click()
    assert answered.value.status == 200
    assert answered.value.request.headers["authorization"] == f"Bearer {KEY}"
    page.reload()
    page.wait_for_selector(".opblock")
    assert KEY not in page.evaluate("JSON.stringify([localStorage, sessionStorage])"), "it is not kept"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 360])
def test_it_is_read_in_any_light_and_width(docs, server, scheme, width):
    page = docs(server, viewport={"width": width, "height": 900}, color_scheme=scheme)
    paper = page.evaluate("getComputedStyle(document.documentElement.classList.contains('dark-mode') ? document.documentElement : document.body).backgroundColor")
    ink = page.evaluate("getComputedStyle(document.querySelector('.info .title')).color")
    light = [sum(int(c) for c in re.findall(r"\d+", colour)[:3]) / 3 for colour in (paper, ink)]
    assert (light[0] < 60 and light[1] > 180) if scheme == "dark" else light[1] < 100, (paper, ink)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), "the page never scrolls sideways"
    page.locator(".opblock", has_text="One step of a drag").first.locator(".opblock-summary-control").click()
    page.locator(".opblock-body").wait_for()
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), "nor when something is opened"
    page.screenshot(path=KEPT / f"docs-{scheme}-{width}.png", full_page=True)


def test_the_page_at_the_root_leads_there(visit):
    visit.page.click("#help-open")
    with visit.page.expect_popup() as opened:
        visit.page.get_by_role("link", name="the API").click()
    opened.value.wait_for_selector(".opblock")
    assert opened.value.url == f"{visit.server.address}/docs"

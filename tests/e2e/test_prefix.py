"""The service behind a proxy that removes a path prefix, with the configurations of `deploy`."""

import io
import json
import subprocess
from urllib.parse import urljoin
from urllib.request import Request, urlopen

import pytest
from PIL import Image

from proxies import PREFIX, PROXIES, published
from support import KEPT


@pytest.fixture(scope="module", params=PROXIES)
def proxied(request, tmp_path_factory):
    with published(request.param, tmp_path_factory.mktemp(request.param)) as proxied:
        yield proxied


def fetch(address, **headers):
    with urlopen(Request(address, headers=headers), timeout=60) as response:
        return response.url, response.headers.get_content_type(), response.read()


def test_the_page_works_by_socket_and_exports(proxied, visits, tmp_path):
    # A visit fails if the page sends a request to an address outside the prefix.
    page = visits(of=proxied).sample("cat")
    page.body("[data-live=socket]")
    x, y = page.posed(0)
    page.press((x, y), (x + 30, y + 20))
    page.body("[data-moving=true][data-live=socket]")
    page.page.mouse.up()
    page.ready()
    name, png = page.saved("download")
    assert name == "cat-warped.png" and Image.open(io.BytesIO(png)).size == (451, 300)
    assert page.of_server().body == png
    page.keep(f"prefix-{proxied.port}")

    command = page.copied("copy-curl")
    assert f"{proxied.address}/warp" in command, command
    subprocess.run(["bash", "-o", "pipefail", "-c", command], cwd=tmp_path, check=True, timeout=60)
    assert (tmp_path / "cat-warped.png").read_bytes() == png

    link = page.copied("copy-link")
    assert link.startswith(f"{proxied.address}/#session="), link
    other = visits(of=proxied, path=link.removeprefix(f"{proxied.address}/"))
    assert other.ready()["session"] == page["session"]
    assert other.posed(0) == page.posed(0)


def test_the_address_without_a_slash_leads_to_the_page(proxied):
    address, kind, page = fetch(proxied.address)
    assert (address, kind) == (f"{proxied.address}/", "text/html") and b"<h1>" in page


def test_locations_and_problem_types_can_be_followed(proxied, picture):
    boundary = "parts"
    part = f'--{boundary}\r\nContent-Disposition: form-data; name="{{}}"; filename="a"\r\n\r\n'
    body = (
        part.format("image").encode()
        + picture.read_bytes()
        + b"\r\n"
        + part.format("warp").encode()
        + b'{"p": [[9, 9]], "q": [[9, 8]]}\r\n'
    )
    kind = f"multipart/form-data; boundary={boundary}"
    for path in ("/sessions", "/warp?session=true"):
        request = Request(
            proxied.address + path, body + f"--{boundary}--\r\n".encode(), {"Content-Type": kind}
        )
        with urlopen(request, timeout=60) as created:
            location = urljoin(created.url, created.headers["Location"])
        assert location.startswith(f"{proxied.address}/sessions/")
        assert json.loads(fetch(location)[2])["image"]["width"] == 400
    # The second one comes from the proxy itself.
    for path in ("/nothing", "/metrics"):
        answer = proxied.ask("GET", path)
        problem = json.loads(answer.body)
        assert (answer.status, problem["code"]) == (404, "not_found")
        _, kind, section = fetch(
            urljoin(f"{proxied.address}{path}", problem["type"]), Accept="application/json"
        )
        assert (
            kind == "application/json"
            and json.loads(section)["type"] == problem["type"] == f"{PREFIX}/problems/not_found"
        )
    servers = json.loads(proxied.ask("GET", "/openapi.json").body)["servers"]
    assert [urljoin(f"{proxied.address}/openapi.json", server["url"]) for server in servers] == [
        proxied.address
    ]


def test_the_reference_and_the_page_of_a_problem_stay_below_the_prefix(proxied, browser):
    context = browser.new_context()
    try:
        strange = []
        context.on(
            "response",
            lambda response: (
                response.url.startswith(("data:", "blob:", f"{proxied.address}/"))
                and response.status < 400
                or strange.append(response.url)
            ),
        )
        page = context.new_page()
        page.goto(f"{proxied.address}/problems/too_large")
        page.click("nav a >> text=API")
        page.wait_for_selector('body[data-state="ready"]')
        page.get_by_role("button", name='Run the example "warp"').click()
        page.wait_for_selector(".results img")
        page.click("header >> text=API reference")
        page.get_by_role("link", name="Liveness").first.click()
        page.locator("button", has_text="Test Request").filter(has_text="/healthz").click()
        with page.expect_response("**/healthz") as answered:
            page.get_by_role("button", name="Send get request").click()
        assert answered.value.url == f"{proxied.address}/healthz" and answered.value.status == 200
        page.screenshot(path=KEPT / f"prefix-docs-{proxied.port}.png")
        page.goto(f"{proxied.address}/docs")
        page.click("header >> text=openapi.json")
        page.goto(f"{proxied.address}/docs")
        page.click("header >> text=mlswarp")
        page.wait_for_selector("body[data-webgl]", state="attached")
        assert page.url == f"{proxied.address}/"
        assert not strange, strange
    finally:
        context.close()

"""Problems have a clear message with advice, and leave the open picture unchanged."""

import json

import pytest

from support import BLUE, BROKEN, GREEN, RED, Server, discs, near


def told(visit, code):
    """Waits for a problem and returns its texts, which are also announced to screen readers."""
    visit.body(f"[data-problem='{code}']")
    alert = visit.page.get_by_role("alert")
    assert alert.is_visible()
    title, detail, advice = (
        visit.text(f"problem-{part}") for part in ("title", "detail", "advice")
    )
    assert title and advice
    for words in (title, detail, advice):
        for jargon in (code if "_" in code else "{", "undefined", "null", "NaN", "Error:", "HTTP"):
            assert jargon not in words, words
    return title, detail, advice


def test_a_text_that_is_called_a_picture(visit, tmp_path):
    visit.expects("415")
    (tmp_path / "notes.png").write_text("Not a picture at all.\n" * 20)
    visit.page.set_input_files("#file", tmp_path / "notes.png")
    title, _, advice = told(visit, "unsupported_format")
    assert title == "Unsupported file format"
    assert all(format in advice for format in ("PNG", "JPEG", "WebP"))
    assert visit["state"] == "empty" and visit.page.locator("#pick").is_visible()
    visit.page.click("#problem-close")
    assert visit["problem"] == "" and not visit.page.get_by_role("alert").is_visible()


def test_a_file_of_another_kind_is_not_even_sent(visit, tmp_path):
    asked = []
    visit.page.on("request", lambda request: asked.append(request.url))
    (tmp_path / "notes.pdf").write_text("Not a picture.")
    visit.page.set_input_files("#file", tmp_path / "notes.pdf")
    told(visit, "not_a_picture")
    assert not [url for url in asked if "sessions" in url]


def test_a_picture_that_was_cut_off(opened, picture, tmp_path):
    opened.expects("422")
    opened.click(*RED)
    opened.ready()
    cut = tmp_path / "cut.png"
    cut.write_bytes(picture.read_bytes()[:600])
    opened.page.set_input_files("#file", cut)
    title, _, _ = told(opened, "bad_image")
    assert title == "The picture cannot be read"
    # The open picture is unchanged.
    assert (opened["handles"], opened["state"]) == ("1", "ready")
    opened.page.click("#problem-close")
    opened.drag(RED, (120, 120))
    opened.ready()
    assert near(opened.look().centre("red"), (120, 120), 1.5)


def test_a_picture_of_too_many_pixels(visits, picture, tmp_path):
    server = Server("--max-image-pixels", "100000")
    try:
        visit = visits(server)
        assert "0.1 megapixels" in visit.text("limits")
        visit.expects("413")
        visit.page.set_input_files("#file", picture)
        title, detail, _ = told(visit, "too_large")
        assert title == "Too large for this server" and "100000" in detail.replace(",", "").replace(
            " ", ""
        )
        visit.open(discs(tmp_path / "small.png", (330, 260)))
    finally:
        server.stop()


def test_a_file_of_too_many_bytes_is_not_even_sent(visits, picture, tmp_path):
    server = Server("--max-body-bytes", "1KiB")
    try:
        visit = visits(server)
        assert "1 KiB" in visit.text("limits")
        asked = []
        visit.page.on("request", lambda request: asked.append(request.url))
        visit.page.set_input_files("#file", picture)
        _, detail, _ = told(visit, "too_large")
        assert "1 KiB" in detail and not [url for url in asked if "sessions" in url]
    finally:
        server.stop()


@pytest.fixture
def pinned(opened):
    for place in (RED, GREEN, BLUE):
        opened.click(*place)
    opened.drag(GREEN, (300, 120))
    opened.ready()
    return opened


def type_number(visit, field, number):
    visit.page.fill(f"#{field}", str(number))
    visit.page.keyboard.press("Enter")


def test_two_handles_that_are_moved_apart(pinned):
    for axis, number in zip("xy", RED):
        type_number(pinned, f"p-1-0-{axis}", number)
        pinned.ready()
    assert "moved apart" in pinned.text("status")
    marked = pinned.page.locator("#handles [data-fault=warning]").evaluate_all(
        "(nodes) => nodes.map((node) => node.id)"
    )
    assert marked == ["handle-0", "handle-1"] and pinned.page.locator("tr[data-fault]").count() == 2
    pinned.keep("handles-apart")
    # The position moves by the mean: put the second handle where the first one is, and nothing is
    # wrong.
    for axis, number in zip("xy", RED):
        type_number(pinned, f"q-1-0-{axis}", number)
        pinned.ready()
    assert pinned.page.locator("[data-fault]").count() == 0 and "moved apart" not in pinned.text(
        "status"
    )


def test_a_problem_of_a_handle_is_marked_and_undone(opened):
    opened.expects("422")
    opened.page.click("label:has(#tool-line)")
    opened.drag((100, 150), (300, 150))
    opened.body("[data-handles='1']").ready()
    before = opened.look()
    type_number(opened, "p-0-1-x", 100)
    _, _, advice = told(opened, "degenerate_line")
    assert advice.endswith("Marked: 1.") and opened["state"] == "error"
    marked = opened.page.locator("#handles [data-fault]").evaluate_all(
        "(nodes) => nodes.map((node) => node.id)"
    )
    assert marked[0] == "handle-0" and opened.page.locator("tr[data-fault]").count() == 2
    # The last good picture is still shown, with an action.
    assert (
        opened["source"] == "png"
        and opened["shown"] != opened["revision"]
        and before.image.size == opened.look().image.size
    )
    opened.keep("problem-of-a-handle")
    assert opened.page.locator("#problem-action").inner_text() == "Undo"
    opened.page.click("#problem-action")
    opened.ready()
    assert (
        not opened.page.get_by_role("alert").is_visible()
        and opened.page.locator("[data-fault]").count() == 0
    )


def test_a_line_without_a_length(opened):
    opened.expects("422")
    opened.page.click("label:has(#tool-line)")
    opened.drag((100, 150), (300, 150))
    opened.body("[data-handles='1']").ready()
    type_number(opened, "p-0-1-x", 100)
    title, _, _ = told(opened, "degenerate_line")
    assert title == "A line has no length"
    opened.page.click("#remove")
    opened.body("[data-handles='0'][data-problem='']")


def test_a_problem_ends_with_what_mends_it(opened):
    opened.expects("422")
    opened.page.click("label:has(#tool-line)")
    opened.drag((100, 150), (300, 150))
    opened.body("[data-handles='1']").ready()
    type_number(opened, "p-0-1-x", 100)
    told(opened, "degenerate_line")
    type_number(opened, "p-0-1-x", 250)
    opened.ready()
    assert not opened.page.get_by_role("alert").is_visible()


def test_a_server_that_goes_away_and_comes_back(visits, picture):
    server = Server()
    try:
        visit = visits(server).open(picture)
        visit.expects("404", *BROKEN)
        for place in (RED, GREEN, BLUE):
            visit.click(*place)
        visit.ready()
        first = visit["session"]
        server.kill()
        visit.drag(RED, (140, 130))
        title, _, advice = told(visit, "network")
        assert title == "The server does not respond" and "safe" in advice
        visit.keep("problem-network")
        # Editing continues; nothing is lost.
        visit.drag(BLUE, (220, 240))
        assert near(visit.posed(2), (220, 240), 0.6)
        server.start()
        # Automatically, without a click. The store is empty, so the picture is uploaded again.
        visit.ready()
        assert visit["session"] != first and visit["handles"] == "3"
        assert near(visit.look().centre("red"), (140, 130), 2.5) and near(
            visit.look().centre("blue"), (220, 240), 2.5
        )
        assert visit.saved("download")[1] == visit.of_server().body
    finally:
        server.stop()


def test_trying_again_can_be_asked_for(visits, picture):
    server = Server()
    try:
        visit = visits(server)
        visit.expects("404", *BROKEN)
        visit.open(picture)
        server.kill()
        visit.click(*RED)
        told(visit, "network")
        assert visit.page.locator("#problem-action").inner_text() == "Try again"
        server.start()
        visit.page.click("#problem-action")
        visit.ready()
    finally:
        server.stop()


def test_a_server_that_is_full(visits, picture):
    server = Server("--max-sessions", "1")
    try:
        taken = visits(server).open(picture)
        visit = visits(server)
        visit.expects("503")
        visit.page.set_input_files("#file", picture)
        title, _, _ = told(visit, "overloaded")
        assert title == "The server is busy"
        # The first client is not affected.
        taken.click(*RED)
        taken.ready()
    finally:
        server.stop()


@pytest.mark.parametrize(
    "fragment, code, refusal",
    [
        ("session=00000000-0000-4000-8000-000000000000&warp=e30", "no_such_session", "404"),
        ("session=00000000-0000-4000-8000-000000000000&warp=%25%25", "bad_link", "404"),
    ],
)
def test_a_link_that_leads_nowhere(visits, picture, fragment, code, refusal):
    visit = visits(path=f"#{fragment}", expects=[refusal])
    told(visit, code)
    assert visit["state"] == "empty"
    visit.open(picture)
    assert visit["problem"] == ""


def test_every_code_of_the_contract_has_words(visit):
    """Every code of the served OpenAPI document has texts in the page."""
    document = json.loads(visit.server.ask("GET", "/openapi.json").body)
    codes = set(find_codes(document))
    assert len(codes) > 15, codes
    visit.page.evaluate("""async () => { globalThis.words = await import("/page/words.js"); }""")
    silent = []
    for code in sorted(codes):
        said = visit.page.evaluate(
            "(code) => words.problemWords({ code, title: '', detail: '' })", code
        )
        if not said["title"] or not said["advice"] or said["title"] == "Request rejected":
            silent.append(code)
    # Codes that the requests of this page never cause need no texts.
    assert not set(silent) - {
        "malformed_request",
        "method_not_allowed",
        "not_acceptable",
        "not_found",
        "not_supported",
        "unknown_field",
        "superseded",
        "folded",
        "unsupported_media_type",
        "upgrade_required",
        "no_table",
    }, silent


def find_codes(value):
    if isinstance(value, dict):
        if isinstance(value.get("code"), dict):
            yield from value["code"].get("enum", [])
        for inner in value.values():
            yield from find_codes(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from find_codes(inner)

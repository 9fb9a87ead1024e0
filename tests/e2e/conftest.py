"""Fixtures: one browser for each of the two processes of the run, one server for a module, one
visit for a test."""

import os

# Set before the import of Playwright: no download, the browser is Debian's.
os.environ["PLAYWRIGHT_SKIP_BROWSER_DOWNLOAD"] = "1"

import pytest
from playwright.sync_api import sync_playwright

from support import CHROMIUM, FLAGS, Server, Visit, discs


@pytest.fixture(scope="session")
def playwright():
    with sync_playwright() as started:
        yield started


@pytest.fixture(scope="session")
def browser(playwright):
    assert CHROMIUM, "install Debian's package chromium-headless-shell"
    # Without a graphics card, GPU rasterization of the page takes several times as long as the
    # CPU's.
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def server():
    server = Server()
    yield server
    server.stop()


@pytest.fixture
def visits(browser, server):
    """Creates visits; at the end none may have errors."""
    made = []

    def visit(of=server, browser=browser, **options):
        made.append(Visit(browser, of, **options))
        return made[-1]

    yield visit
    for one in made:
        one.close()
    trouble = [line for one in made for line in one.trouble]
    assert not trouble, "\n".join(trouble)


@pytest.fixture
def visit(visits):
    return visits()


@pytest.fixture(scope="session")
def picture(tmp_path_factory):
    return discs(tmp_path_factory.mktemp("pictures") / "discs.png")


@pytest.fixture
def opened(visit, picture):
    """The page with three discs and no handles."""
    return visit.open(picture)

"""The widget in JupyterLab itself, with a kernel that is free, busy and gone."""

import os
import re
import subprocess
import sys
import time

import nbformat
import pytest
from playwright.sync_api import sync_playwright

from conftest import CHROMIUM, FLAGS, PICTURES

CELLS = [
    """from mlswarp.widget import WarpWidget
widget = WarpWidget("cat.png", [[168, 112], [316, 136], [262, 240]], height=300)
widget""",
    "print('q is', widget.q[2], widget.result().shape)",
    "import time; time.sleep(600)",
]


@pytest.fixture
def lab(tmp_path, cat):
    (tmp_path / "cat.png").write_bytes(cat)
    cells = [nbformat.v4.new_code_cell(cell) for cell in CELLS]
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3"}}
    notebook = nbformat.v4.new_notebook(cells=cells, metadata=kernel)
    nbformat.write(notebook, tmp_path / "cat.ipynb")
    log = tmp_path / "log"
    command = [sys.executable, "-m", "jupyter", "lab", "--allow-root", "--no-browser", "--port=0"]
    options = [
        "--ip=127.0.0.1",
        f"--ServerApp.root_dir={tmp_path}",
        "--LabApp.extension_manager=readonly",
    ]
    own = {f"JUPYTER_{name}_DIR": str(tmp_path / name) for name in ("CONFIG", "DATA", "RUNTIME")}
    with log.open("wb") as out:
        process = subprocess.Popen(
            [*command, *options], stdout=out, stderr=out, env={**os.environ, **own}
        )
    while not (found := re.search(r"(http://127\.0\.0\.1:\d+)/lab\?(token=\w+)", log.read_text())):
        assert process.poll() is None, log.read_text()
        time.sleep(0.1)
    yield found.groups()
    process.terminate()
    process.wait()


def test_a_drag_in_jupyterlab(lab):
    address, token = lab
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page(viewport={"width": 1100, "height": 800})
        page.set_default_timeout(20_000)
        page.goto(f"{address}/lab/tree/cat.ipynb?{token}")
        page.locator(".jp-CodeCell .cm-content").first.click()
        page.get_by_text("Idle", exact=False).first.wait_for(state="attached")
        page.keyboard.press("Shift+Enter")

        def shown():
            page.wait_for_function("document.querySelector('mls-warp')?.state === 'ready'")
            return page.evaluate("document.querySelector('mls-warp').q[2]")

        def drag():
            box = page.locator("#handle-2").bounding_box()
            x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
            page.mouse.move(x, y)
            page.mouse.down()
            page.mouse.move(x + 20, y + 10, steps=8)
            page.mouse.up()
            page.wait_for_timeout(100)
            return shown()

        before = shown()
        free = drag()
        assert free[0] > before[0] + 10
        page.locator(".jp-CodeCell .cm-content").nth(1).click()
        page.keyboard.press("Shift+Enter")
        said = page.get_by_text("q is").last
        said.wait_for()
        said = page.locator(".jp-OutputArea-output pre").last.inner_text()
        assert said.strip() == f"q is ({free[0]}, {free[1]}) (300, 451, 3)"
        page.screenshot(path=PICTURES / "jupyterlab.png")
        # The third cell keeps the kernel busy; then it is gone.
        page.keyboard.press("Shift+Enter")
        busy = drag()
        assert busy[0] > free[0] + 10
        kernels = "async (key) => (await (await fetch(`/api/kernels?${key}`)).json())[0].id"
        kernel = page.evaluate(kernels, token)
        restart = f"/api/kernels/{kernel}/restart?{token}"
        assert page.request.post(address + restart).ok
        assert drag()[0] > busy[0] + 10
        browser.close()

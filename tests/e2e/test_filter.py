"""The filter: what the server draws, taken along like the content outside."""

import json
import shutil

from support import RED
from test_output import run


def test_each_filter_is_drawn_undone_and_taken_along(opened, picture, tmp_path):
    opened.click(*RED)
    opened.drag(RED, (130.4, 110.3))
    opened.ready()
    assert opened.page.input_value("#filter") == "bilinear" and "output" not in opened.warp()
    pngs = {"bilinear": opened.saved("download")[1]}
    notes = {opened.text("filter-note")}
    for filter in ("nearest", "bicubic"):
        opened.page.select_option("#filter", filter)
        opened.ready()
        pngs[filter] = opened.saved("download")[1]
        assert opened.warp()["output"] == {"filter": filter}
        notes.add(opened.text("filter-note"))
    assert len(notes) == len(set(pngs.values())) == 3
    shutil.copy(picture, tmp_path)
    run(opened.copied("copy-curl"), tmp_path)
    assert (tmp_path / "discs-warped.png").read_bytes() == pngs["bicubic"]
    opened.page.reload()
    opened.ready()
    assert opened.page.input_value("#filter") == "bicubic"
    for filter in ("nearest", "bilinear"):
        opened.page.click("#undo")
        opened.ready()
        assert (
            opened.page.input_value("#filter") == filter
            and opened.saved("download")[1] == pngs[filter]
        )
    saved = tmp_path / "handles.json"
    saved.write_text(
        json.dumps({"p": [RED], "q": [[130.4, 110.3]], "output": {"filter": "nearest"}})
    )
    opened.page.set_input_files("#file", saved)
    opened.page.wait_for_selector("#filter-note:text-matches('nearest pixel')")
    opened.ready()
    assert (
        opened.page.input_value("#filter") == "nearest"
        and opened.saved("download")[1] == pngs["nearest"]
    )

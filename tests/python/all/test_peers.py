"""The comparison with peers, in a small form: all of them run. Its times are a benchmark's."""

import runpy

import numpy as np
from PIL import Image

from conftest import ROOT

PICTURE = ROOT / "tests/images/astronaut.png"


def test_all_peers_run(capsys):
    peers = runpy.run_path(str(ROOT / "tests/bench/python/peers.py"))
    image = np.asarray(Image.open(PICTURE).convert("RGB").resize((120, 90)))
    assert peers["table"]("120 x 90", image, 1, set(), rounds=1) == {}
    peers["overhead"](rounds=3)
    shown = capsys.readouterr().out
    for name in (
        "mlswarp: pose and warp",
        "cv2.remap",
        "NumPy",
        "ThinPlate",
        "Piecewise",
        "molesq",
    ):
        assert name in shown
    assert "overhead of Python" in shown

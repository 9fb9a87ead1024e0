"""Landmark files of other programs, under the names and in the form in which these write them."""

import json

import pytest

from support import near
from test_files import drop

WIDTH, HEIGHT = 400, 300
PLACES = [(60, 50), (250, 60), (70, 190), (240, 180), (150, 120)]
NAMES = ["nose tip", "left eye", "right eye", "tail", "middle"]
# Whole numbers are the centres of pixels in most formats.
CENTRES = [(x - 0.5, y - 0.5) for x, y in PLACES]


def lines(head, row, places=CENTRES, end="\n"):
    rows = [row.format(k=k, x=x, y=y, name=NAMES[k]) for k, (x, y) in enumerate(places)]
    return end.join([*head, *rows, ""])


def series(row, places=CENTRES, between=","):
    return between.join(row.format(x=x, y=y) for x, y in places)


def deeplabcut(index, columns):
    bodies = ",".join(name for name in NAMES for _ in columns)
    return "\n".join(
        [
            f"scorer{index},{','.join(['Anna'] * len(columns) * len(NAMES))}",
            f"bodyparts{index},{bodies}",
            f"coords{index},{','.join(columns * len(NAMES))}",
        ]
    )


UP = [(x, HEIGHT - y) for x, y in PLACES]
FILES = {
    "wing.TPS": lines(["LM=5"], "{x:.5f} {y:.5f}", UP, "\r\n")
    + "CURVES=0\r\nIMAGE=C:\\wings\\wing.jpg\r\nID=0\r\nSCALE=0.012345\r\n",
    "points.csv": lines(["index,axis-0,axis-1"], "{k}.0,{y},{x}"),
    "landmarks.json": json.dumps(
        {
            "type": "BigWarpLandmarks",
            "numDimensions": 2,
            "numPoints": 5,
            "movingPoints": CENTRES,
            "fixedPoints": CENTRES,
            "active": [True] * 5,
            "names": [f"Pt-{k}" for k in range(5)],
        }
    ),
    "bigwarp.csv": lines([], '"Pt-{k}","true","{x}","{y}","{x}","{y}"'),
    "person_keypoints_default.json": json.dumps(
        {
            "info": {"year": 2024},
            "licenses": [{"id": 1, "name": "", "url": ""}],
            "images": [{"id": 7, "width": WIDTH, "height": HEIGHT, "file_name": "discs.png"}],
            "categories": [{"id": 1, "name": "fish", "keypoints": NAMES, "skeleton": [[1, 2]]}],
            "annotations": [
                {
                    "id": 1,
                    "image_id": 7,
                    "category_id": 1,
                    "iscrowd": 0,
                    "bbox": [1, 2, 3, 4],
                    "keypoints": [c for x, y in CENTRES for c in (x, y, 2)],
                    "num_keypoints": 5,
                }
            ],
        }
    ),
    "CollectedData_Anna.csv": deeplabcut(",,", ["x", "y"])
    + "\nlabeled-data,video1,img0001.png,"
    + series("{x},{y}")
    + "\n",
    "video1DLC_resnet50.csv": deeplabcut("", ["x", "y", "likelihood"])
    + "\n0,"
    + series("{x},{y},0.99")
    + "\n",
    "training.xml": "<?xml version='1.0' encoding='ISO-8859-1'?>\n<?xml-stylesheet type='text/xsl'"
    " href='image_metadata_stylesheet.xsl'?>\n<dataset>\n<name>imglab dataset</name>\n<images>\n"
    "<image file='discs.png'>\n<box top='40' left='50' width='210' height='170'>\n"
    + lines([], "<part name='{k:02}' x='{x:.0f}' y='{y:.0f}'/>", [(x, y) for x, y in PLACES])
    + "</box>\n</image>\n</images>\n</dataset>\n",
    "annotations.xml": '<?xml version="1.0" encoding="utf-8"?>\n<annotations>\n'
    "<version>1.1</version>\n"
    f'<image id="0" name="discs.png" width="{WIDTH}" height="{HEIGHT}">\n'
    '<points label="fish" source="manual" occluded="0" z_order="0" '
    f'points="{series("{x:.2f},{y:.2f}", PLACES, ";")}">\n</points>\n</image>\n</annotations>\n',
    "fixed.txt": lines(["index", "5"], "{x} {y}"),
    "F.fcsv": lines(
        ["# Markups fiducial file version = 4.11", "# CoordinateSystem = IJK"],
        "{k},{x},{y},0,0,0,0,1,1,1,0,F-{k},,",
    ),
    "F.mrk.json": json.dumps(
        {
            "markups": [
                {
                    "type": "Fiducial",
                    "coordinateSystem": "IJK",
                    "controlPoints": [
                        {"id": str(k), "label": f"F-{k}", "position": [x, y, 0.0]}
                        for k, (x, y) in enumerate(CENTRES)
                    ],
                }
            ]
        }
    ),
    "map.tif.points": lines(
        ['#CRS: GEOGCRS["WGS 84"]', "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual"],
        "7.{k},46.{k},{x},-{y},1,0,0,0",
        PLACES,
    ),
    "face.pts": lines(["version: 1", "n_points: 5", "{"], "{x} {y}", PLACES) + "}\n",
    "Results.csv": lines([" ,X,Y,Slice,Counter,Count"], "{k},{x},{y},0,0,5", PLACES),
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_of_another_program_is_opened(opened, name):
    # The height of the picture is asked for where y is up.
    opened.expects("422")
    drop(opened, (name, "", FILES[name].encode()))
    opened.body("[data-handles='5']").ready()
    assert opened.text("toast") == f"5 handles from {name}"
    for k, place in enumerate(PLACES):
        assert near(opened.posed(k), place, 0.6), (k, opened.posed(k))
    # And what this page writes of it.
    saved = opened.saved("save-landmarks")[1]
    drop(opened, ("again.csv", "text/csv", saved))
    opened.page.wait_for_selector("#toast.seen:text-matches('again.csv')")
    assert near(opened.ready() and opened.posed(4), PLACES[4], 0.6)


@pytest.mark.parametrize(
    "name, text, words",
    [
        (
            "world.txt",
            lines(["point", "5"], "{x} {y}"),
            "subtract the origin of the image, divide by its spacing",
        ),
        (
            "RAS.fcsv",
            lines(
                ["# Markups fiducial file version = 4.11", "# CoordinateSystem = RAS"],
                "{k},{x},{y},0,0,0,0,1,1,1,0,F-{k},,",
            ),
            "origin and spacing of the image",
        ),
    ],
)
def test_a_file_in_other_units_says_how_to_convert_it(opened, name, text, words):
    opened.expects("422")
    drop(opened, (name, "", text.encode()))
    opened.body("[data-problem=bad_landmarks]")
    assert opened.text("problem-detail").startswith(f"In {name}, ")
    assert words in opened.text("problem-detail")

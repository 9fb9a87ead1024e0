#!/usr/bin/env python3
"""What a hostile landmark file of each format costs the program.

    tests/bench/hostile_files.py PROGRAM [MEGABYTES]

Each file begins as its format does and is full of what costs a reader most: as many landmarks,
names, nested values or lines as fit. Prints its size, the status, the seconds until the answer, and
by how much the peak of the program's memory grew. A table without a row that stands out is what we
want: no cost may grow faster than the file.
"""

import http.client
import itertools
import subprocess
import sys
import time
import uuid

PORT = 7910
HEADS = {
    "tpsDig, one specimen": (b"LM=1000000\n", b"1 2\n", b""),
    "tpsDig, many specimens": (b"", b"LM=1\n1 2\nIMAGE=a.jpg\nID=0\n", b""),
    "napari": (b"index,axis-0,axis-1\n", b"0,1,2\n", b""),
    "BigWarp JSON": (
        b'{"type":"BigWarpLandmarks","numDimensions":2,"movingPoints":[',
        b"[1,2],",
        b"[1,2]]}",
    ),
    "BigWarp JSON, nested": (b'{"type":"BigWarpLandmarks","movingPoints":', b"[", b""),
    "COCO": (
        b'{"images":[],"categories":[],"annotations":[',
        b'{"image_id":1,"category_id":1,"keypoints":[1,2,2]},',
        b'{"image_id":1,"category_id":1,"keypoints":[1,2,2]}]}',
    ),
    "COCO, one person": (
        b'{"annotations":[{"image_id":1,"keypoints":[',
        b"1,2,2,",
        b"1,2,2]}]}",
    ),
    "DeepLabCut, columns": (b"scorer", b",s", b"\n"),
    "DeepLabCut, rows": (
        b"scorer,a,a\nbodyparts,nose,nose\ncoords,x,y\n",
        b"img.png,1,2\n",
        b"",
    ),
    "dlib XML, parts": (
        b"<?xml version='1.0'?><dataset><images><image file='a'><box>",
        b"<part name='0' x='1' y='2'/>",
        b"</box></image></images></dataset>",
    ),
    "dlib XML, nested": (b"<dataset>", b"<images>", b""),
    "dlib XML, attributes": (b"<dataset><images><image ", b"a='1' ", b"/></images></dataset>"),
    "dlib XML, entities": (b"<dataset><name>", b"&amp;", b"</name></dataset>"),
    "elastix": (b"point\n1000000\n", b"1 2\n", b""),
    "CVAT": (
        b"<annotations><image id='0' name='a' width='9' height='9'>",
        b"<points label='n' points='1,2'/>",
        b"</image></annotations>",
    ),
    "CVAT, one list": (
        b"<annotations><image id='0' name='a' width='9' height='9'><points label='n' points='",
        b"1,2;",
        b"1,2'/></image></annotations>",
    ),
    "IIIF": (
        b'{"type":"Annotation","body":{"features":[',
        b'{"properties":{"resourceCoords":[1,2]}},',
        b'{"properties":{"resourceCoords":[1,2]}}]}}',
    ),
    "3D Slicer": (
        b'{"markups":[{"type":"Fiducial","coordinateSystem":"LPS","controlPoints":[',
        b'{"label":"a","position":[1,2,3]},',
        b'{"label":"a","position":[1,2,3]}]}]}',
    ),
    "ImageJ, long names": (b"Name,X,Y\n" + b"a" * 1000, b"a" * 1000, b",1,2\n"),
    "lines without end": (b"", b"1 ", b""),
    "empty lines": (b"", b"\n", b""),
    "names that are equal": (b"", b"same 1 2\n", b""),
}


def file(head, each, tail, size):
    room = size - len(head) - len(tail)
    return head + b"".join(itertools.repeat(each, room // len(each))) + tail


def ask(body):
    boundary = uuid.uuid4().hex
    head = (
        f'--{boundary}\r\nContent-Disposition: form-data; name="landmarks_p"; filename="a"\r\n\r\n'
    )
    body = head.encode() + body + f"\r\n--{boundary}--\r\n".encode()
    connection = http.client.HTTPConnection("127.0.0.1", PORT, timeout=300)
    began = time.perf_counter()
    headers = {"Content-Type": f"multipart/form-data; boundary={boundary}"}
    connection.request("POST", "/landmarks", body, headers)
    response = connection.getresponse()
    text = response.read()
    return time.perf_counter() - began, response.status, text


def peak(process):
    with open(f"/proc/{process.pid}/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) / 1024


def main():
    program, *rest = sys.argv[1:]
    size = int(float(rest[0]) * 1e6) if rest else 10_000_000
    print("| file | status | s | MB of memory |\n|---|---:|---:|---:|")
    for name, (head, each, tail) in HEADS.items():
        process = subprocess.Popen([program, "--listen", f"127.0.0.1:{PORT}", "--log", "off"])
        try:
            for _ in range(200):
                try:
                    ask(b"1 2\n")
                    break
                except OSError:
                    time.sleep(0.02)
            before = peak(process)
            seconds, status, _ = ask(file(head, each, tail, size))
            print(
                f"| {name} | {status} | {seconds:.2f} | {peak(process) - before:.0f} |", flush=True
            )
        finally:
            process.terminate()
            process.wait()


if __name__ == "__main__":
    main()

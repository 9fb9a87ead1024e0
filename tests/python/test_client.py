"""The client against the program, and against answers that a program gives seldom."""

import asyncio
import io
import threading
import zipfile

import httpx2
import mlswarp
import numpy as np
import pytest
from mlswarp import _calls

from conftest import CAT_SIZE, P, Q

POINTS = [[10.5, 20.25], [np.nan, 3], [262, 240]]


@pytest.fixture
def client(server):
    with mlswarp.Client(server.address) as client:
        yield client


def test_a_program_changes_one_line(client, cat):
    """What is computed here and there is the same."""
    pose = mlswarp.Plan(P, size=CAT_SIZE).pose(Q)
    rendered = client.warp(cat, {"p": np.array(P[:3]), "q": np.array(Q[:3])})
    assert rendered.content == mlswarp.warp_file(cat, {"p": P[:3], "q": Q[:3]})
    with client.open(cat, P) as session:
        drawn = session.warp(Q)
        assert drawn.content == mlswarp.warp_file(cat, {"p": P, "q": Q})
        assert (drawn.folds, drawn.warnings) == (pose.folds, pose.warnings)
        assert drawn.residual == pytest.approx(pose.residual, abs=1e-3)
        assert drawn.array().shape[:2] == CAT_SIZE[::-1] and drawn.timing
        np.testing.assert_array_equal(session.points(POINTS, q=Q), pose.points(POINTS))
        boxes = [[10, 10, 60, 40], [np.nan, 0, 1, 1]]
        np.testing.assert_array_equal(session.boxes(boxes, q=Q), pose.boxes(boxes))
        np.testing.assert_array_equal(session.map(Q), pose.map())
        forward = session.map(Q, direction="forward")
        np.testing.assert_array_equal(forward, pose.map(direction="forward"))
        assert session.report(Q).residuals == pose.report().residuals
        session.put_layer("mask", cat, kind="labels")
        assert "mask" in session.info["layers"]
        assert session.warp(Q, layer="mask").content != drawn.content
        half = session.warp(Q, strength=0.5, output={"width": 100})
        assert half.array().shape[1] == 100
        with pytest.raises(mlswarp.InvalidWarp) as caught:
            session.warp(Q[:1])
        assert (caught.value.code, caught.value.status) == ("shape_mismatch", 422)
        assert caught.value.request_id
    with pytest.raises(mlswarp.SessionNotFound):
        session.warp(Q)


def test_a_batch_is_streamed_to_a_file(client, cat, tmp_path):
    with client.open(cat, P) as session:
        jitter = {"seed": 7, "count": 3, "sigma": 6}
        with session.batch(Q, jitter=jitter) as batch:
            batch.to_file(tmp_path / "batch.zip")
        poses = list(mlswarp.Plan(P, size=CAT_SIZE).jitter(q=Q, **jitter))
        archive = zipfile.ZipFile(tmp_path / "batch.zip")
        images = sorted(name for name in archive.namelist() if name.endswith(".png"))
        for name, pose in zip(images, poses, strict=True):
            assert archive.read(name) == mlswarp.warp_file(cat, {"p": P, "q": pose.q})
        with session.batch(Q, steps=3, accept="image/gif") as batch:
            assert b"".join(batch).startswith(b"GIF")
        with pytest.raises(mlswarp.InvalidWarp), session.batch(Q, steps=1):
            pass


def moved(k):
    return [[Q[0][0] + k, Q[0][1]], *Q[1:]]


def test_a_drag_ends_with_the_last_pose(client, cat):
    with client.open(cat, P) as session, session.drag(frames="png") as drag:
        for k in range(30):
            last = drag.pose(moved(k))
        seen = []
        for frame in drag:
            seen.append(frame.seq)
            if frame.seq == last and frame.full:
                break
        assert frame.content == session.warp(moved(29)).content
        assert seen == sorted(seen) and "folds" in frame.report
        drag.pose(Q[:1])
        with pytest.raises(mlswarp.InvalidWarp):
            next(drag)


def test_a_drag_outlives_a_server(program, cat):
    """The server closes with 1012, and the next one knows no session: it is opened again."""
    with (
        mlswarp.Client(program.address) as client,
        client.open(cat, P, reopen=True) as session,
        session.drag(frames="png") as drag,
    ):
        drag.pose(Q)
        first = next(drag)
        program.stop()
        program.start()
        last = drag.pose(moved(9))
        for frame in drag:
            if frame.seq == last and frame.full:
                break
        assert frame.content == session.warp(moved(9)).content != first.content
        # So are requests.
        program.stop()
        program.start()
        assert session.warp(Q).content == mlswarp.warp_file(cat, {"p": P, "q": Q})


def test_a_slow_link_that_breaks(link, cat):
    """A request whose connection ends before its answer is repeated; a drag connects again, and its
    last pose comes back."""
    with (
        mlswarp.Client(link.address) as client,
        client.open(cat, P) as session,
        session.drag(frames="png") as drag,
    ):
        # The answer takes at least 60 ms.
        cut = threading.Timer(0.04, link.cut)
        cut.start()
        assert session.warp(Q).content == mlswarp.warp_file(cat, {"p": P, "q": Q})
        cut.join()
        for k in range(10):
            last = drag.pose(moved(k))
        assert next(drag).seq <= last
        link.cut()
        for frame in drag:
            if frame.seq == last and frame.full:
                break
        assert frame.content == session.warp(moved(9)).content


def test_a_drag_without_its_session_ends(program, cat):
    with mlswarp.Client(program.address) as client:
        session = client.open(cat, P)
        with session.drag() as drag:
            drag.pose(Q)
            next(drag)
            program.stop()
            program.start()
            with pytest.raises(mlswarp.SessionNotFound):
                for _ in drag:
                    pass


def test_the_client_without_threads(server, cat, tmp_path):
    async def use():
        async with mlswarp.AsyncClient(server.address) as client:
            once = await client.warp(cat, {"p": P, "q": Q})
            async with await client.open(cat, P) as session:
                drawn = await session.warp(Q)
                assert drawn.content == once.content == mlswarp.warp_file(cat, {"p": P, "q": Q})
                points = await session.points(POINTS, q=Q)
                pose = mlswarp.Plan(P, size=CAT_SIZE).pose(Q)
                np.testing.assert_array_equal(points, pose.points(POINTS))
                np.testing.assert_array_equal(await session.map(Q), pose.map())
                boxes = [[1, 2, 30, 40]]
                np.testing.assert_array_equal(await session.boxes(boxes, q=Q), pose.boxes(boxes))
                assert (await session.report(Q)).folds == pose.report().folds
                await session.put_layer("mask", cat)
                async with session.batch(Q, steps=2) as batch:
                    await batch.to_file(tmp_path / "batch.zip")
                assert zipfile.ZipFile(tmp_path / "batch.zip").testzip() is None
                async with session.drag(frames="png") as drag:
                    last = drag.pose(Q)
                    async for frame in drag:
                        if frame.seq == last and frame.full:
                            break
                assert frame.content == drawn.content
                with pytest.raises(mlswarp.InvalidWarp):
                    await session.warp(Q[:1])

    asyncio.run(use())


PROBLEM = {"code": "overloaded", "detail": "too much to do", "status": 503}


def answering(*answers):
    """A client whose server gives these answers, and the requests that it has had."""
    left, requests = list(answers), []

    def handle(request):
        requests.append(request)
        answer = left.pop(0)
        if isinstance(answer, Exception):
            raise answer
        status, body, headers = answer
        return httpx2.Response(status, json=body, headers=headers)

    http = httpx2.Client(transport=httpx2.MockTransport(handle))
    return mlswarp.Client("http://test/sub", api_key="k", http_client=http), requests


FINE = (200, {}, {})


@pytest.mark.parametrize(
    ("first", "kind", "is_repeated"),
    [
        ((408, PROBLEM, {}), mlswarp.ApiError, True),
        ((429, PROBLEM, {}), mlswarp.RateLimited, True),
        ((502, {}, {}), mlswarp.ApiError, True),
        ((503, PROBLEM, {}), mlswarp.Overloaded, True),
        ((504, {}, {}), mlswarp.ApiError, True),
        (httpx2.ConnectError("gone"), mlswarp.ConnectionFailed, True),
        (httpx2.ReadTimeout("slow"), mlswarp.RequestTimeout, True),
        ((400, PROBLEM, {}), mlswarp.ApiError, False),
        ((401, PROBLEM, {}), mlswarp.AuthenticationError, False),
        ((403, PROBLEM, {}), mlswarp.PermissionDenied, False),
        ((404, PROBLEM, {}), mlswarp.SessionNotFound, False),
        ((409, PROBLEM, {}), mlswarp.Superseded, False),
        ((410, PROBLEM, {}), mlswarp.SessionExpired, False),
        ((413, {**PROBLEM, "code": "too_large"}, {}), mlswarp.TooLarge, False),
        ((422, {**PROBLEM, "code": "folded"}, {}), mlswarp.FoldedError, False),
        ((500, PROBLEM, {}), mlswarp.InternalError, False),
        ((503, PROBLEM, {"Retry-After": "3600"}), mlswarp.Overloaded, False),
    ],
    ids=str,
)
def test_what_is_repeated(monkeypatch, first, kind, is_repeated):
    monkeypatch.setattr("time.sleep", lambda _: None)
    client, requests = answering(first, FINE)
    if is_repeated:
        client.warp(b"", {"p": [], "q": []})
        assert len(requests) == 2
        client, requests = answering(first, first, first)
    with pytest.raises(kind):
        client.warp(b"", {"p": [], "q": []})
    assert len(requests) == (3 if is_repeated else 1)
    with pytest.raises(kind):
        answering(first)[0].with_options(max_retries=0).warp(b"", {})
    assert requests[0].headers["authorization"] == "Bearer k"
    assert str(requests[0].url) == "http://test/sub/warp"


def test_how_long_it_waits():
    response = httpx2.Response(503, headers={"Retry-After": "7"})
    assert _calls.delay_before(0, response) == 7
    delays = [_calls.delay_before(k, None) for k in range(9)]
    assert 0.25 <= delays[0] <= 0.5 and max(delays) <= 8


def test_an_image_is_read_once_and_pillow_shows_it(client, cat, tmp_path):
    path = tmp_path / "cat.png"
    path.write_bytes(cat)
    drawn = client.warp(path, '{"p": [], "q": []}')
    drawn.save(tmp_path / "out.png")
    assert drawn.image().size == CAT_SIZE
    assert io.BytesIO((tmp_path / "out.png").read_bytes()).read(4) == b"\x89PNG"

"""The client of openapi-python-client: every step of the conversation in `run`."""

import sys
from io import BytesIO
from pathlib import Path

from mlswarp_client import AuthenticatedClient, Client
from mlswarp_client.api.pictures import warp
from mlswarp_client.api.points import map_points
from mlswarp_client.api.sessions import (
    create_session,
    delete_session,
    get_session,
    map_session_points,
    warp_session,
)
from mlswarp_client.models import (
    CreateSessionBody,
    Drag,
    Output,
    Points,
    PointsAnswer,
    PosedPoints,
    Problem,
    ProblemCode,
    Session,
    WarpBody,
    WarpObject,
)
from mlswarp_client.types import File

server, key, picture, folder = sys.argv[1:]
P = [[120, 80], [[40, 200], [300, 210]]]
Q = [[130, 60], [[40, 220], [300, 190]]]
SMALL = Output(width=200)


def image():
    return File(payload=BytesIO(Path(picture).read_bytes()), file_name=Path(picture).name)


def save(name, answer):
    assert isinstance(answer, File), answer
    Path(folder, name).write_bytes(answer.payload.read())


client = AuthenticatedClient(base_url=server, token=key)
save(
    "warped.png",
    warp.sync(client=client, body=WarpBody(image=image(), warp=WarpObject(p=P, q=Q, output=SMALL))),
)

session = create_session.sync(
    client=client, body=CreateSessionBody(image=image(), warp=WarpObject(p=P))
)
assert isinstance(session, Session), session
assert (session.image.width, session.image.height, session.p, session.seq) == (451, 300, P, None)
save(
    "dragged.png", warp_session.sync(session.id, client=client, body=Drag(q=Q, seq=1, output=SMALL))
)
again = get_session.sync(session.id, client=client)
assert isinstance(again, Session) and again.seq == 1 and again.id == session.id

points = Points(
    p=[[120, 80], [200, 160]], q=[[130, 60], [200, 160]], extent=[640, 480], points=[[0, 0]]
)
mapped = map_points.sync(client=client, body=points)
assert isinstance(mapped, PointsAnswer) and [round(x, 2) for x in mapped.points[0]] == [
    26.96,
    -37.88,
], mapped
mapped = map_session_points.sync(
    session.id, client=client, body=PosedPoints(q=Q, points=[[0, 0], [320.5, 240.5]])
)
assert isinstance(mapped, PointsAnswer) and len(mapped.points) == 2, mapped

problem = warp_session.sync(session.id, client=client, body=Drag(q=Q[:1]))
assert (
    isinstance(problem, Problem) and problem.code is ProblemCode.SHAPE_MISMATCH and problem.detail
), problem
problem = map_points.sync(client=Client(base_url=server), body=Points(extent=[640, 480]))
assert (
    isinstance(problem, Problem)
    and problem.code is ProblemCode.UNAUTHORIZED
    and problem.status == 401
), problem

assert delete_session.sync_detailed(session.id, client=client).status_code == 204

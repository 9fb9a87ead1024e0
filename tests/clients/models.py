"""The models of datamodel-code-generator, with httpx: every step of the conversation in `run`.

Each request is sent in every form that a model can be written in, with its nulls and without; each
response must be a valid model.
"""

import sys
from pathlib import Path

import httpx
from mlswarp_models import (
    Code,
    Drag,
    Output,
    Points,
    PointsAnswer,
    PosedPoints,
    Problem,
    Session,
    WarpObject,
)

server, key, picture, folder = sys.argv[1:]
P = [(120, 80), [(40, 200), (300, 210)]]
Q = [(130, 60), [(40, 220), (300, 190)]]
SMALL = Output(width=200)
http = httpx.Client(base_url=server, headers={"Authorization": f"Bearer {key}"}, timeout=60)


def forms(model):
    """The JSON of a model: with every null and default, without nulls, and with the fields that
    were set."""
    assert None in model.model_dump().values(), "the model has no null: this would test nothing"
    return [
        model.model_dump_json(),
        model.model_dump_json(exclude_none=True),
        model.model_dump_json(exclude_unset=True),
    ]


def upload(path, model):
    return [
        http.post(path, files={"image": Path(picture).read_bytes()}, data={"warp": form})
        for form in forms(model)
    ]


def post(path, model):
    return [
        http.post(path, content=form, headers={"Content-Type": "application/json"})
        for form in forms(model)
    ]


def one(answers, status=200):
    """The answer, which is the same for every form."""
    for answer in answers:
        assert answer.status_code == status, answer.text
    return answers[0]


def same(answers):
    answer = one(answers)
    assert len({answer.content for answer in answers}) == 1, (
        "the forms of one model have different answers"
    )
    return answer


Path(folder, "warped.png").write_bytes(
    same(upload("/warp", WarpObject(p=P, q=Q, output=SMALL))).content
)

session = Session.model_validate_json(one(upload("/sessions", WarpObject(p=P)), 201).content)
assert (session.image.width, session.image.height, session.seq) == (451, 300, None)
route = f"/sessions/{session.id}"
Path(folder, "dragged.png").write_bytes(
    same(post(f"{route}/warp", Drag(q=Q, output=SMALL))).content
)
one(post(f"{route}/warp", Drag(q=Q, seq=1)))
assert Session.model_validate_json(http.get(route).content).seq == 1
# Writing what was read changes nothing.
changed = http.put(
    f"{route}/handles",
    content=WarpObject(p=P).model_dump_json(),
    headers={"Content-Type": "application/json"},
)
assert changed.status_code == 200 and Session.model_validate_json(changed.content).p == session.p, (
    changed.text
)

points = Points(
    p=[(120, 80), (200, 160)], q=[(130, 60), (200, 160)], extent=(640, 480), points=[(0, 0)]
)
mapped = PointsAnswer.model_validate_json(same(post("/points", points)).content)
assert [round(x, 2) for x in mapped.points[0].root] == [26.96, -37.88], mapped
answer = http.post(
    f"{route}/points", json=PosedPoints(q=Q, points=[(0, 0)]).model_dump(mode="json")
)
mapped = PointsAnswer.model_validate_json(one([answer]).content)
assert len(mapped.points) == 1

problem = Problem.model_validate_json(one(post(f"{route}/warp", Drag(q=Q[:1])), 422).content)
assert problem.code is Code.shape_mismatch and problem.detail, problem
problem = Problem.model_validate_json(httpx.post(f"{server}/points").content)
assert problem.code is Code.unauthorized and problem.status == 401, problem

assert http.delete(route).status_code == 204

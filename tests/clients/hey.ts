// The client of @hey-api/openapi-ts: every step of the conversation in `run`.

import assert from "node:assert/strict";
import { openAsBlob } from "node:fs";
import { writeFile } from "node:fs/promises";
import { client } from "./mlswarp/client.gen.js";
import {
  createSession,
  deleteSession,
  getSession,
  mapPoints,
  mapSessionPoints,
  warp,
  warpSession,
} from "./mlswarp/index.js";
import type { PosedHandles, Session } from "./mlswarp/index.js";

const [server, key, picture, folder] = process.argv.slice(2) as [string, string, string, string];
const p: PosedHandles = [
  [120, 80],
  [
    [40, 200],
    [300, 210],
  ],
];
const q: PosedHandles = [
  [130, 60],
  [
    [40, 220],
    [300, 190],
  ],
];
const output = { width: 200 };
const image = await openAsBlob(picture);
const save = async (name: string, file: Blob | undefined) =>
  writeFile(`${folder}/${name}`, Buffer.from(await file!.arrayBuffer()));

client.setConfig({ baseUrl: server, auth: key });
await save("warped.png", (await warp({ body: { image, warp: { p, q, output } } })).data);

const session: Session = (await createSession({ body: { image, warp: { p } } })).data!;
assert.deepEqual(
  [session.image.width, session.image.height, session.p, session.seq],
  [451, 300, p, null],
);
const path = { id: session.id };
await save("dragged.png", (await warpSession({ path, body: { q, seq: 1, output } })).data);
assert.equal((await getSession({ path })).data?.seq, 1);

const mapped = await mapPoints({
  body: {
    p: [
      [120, 80],
      [200, 160],
    ],
    q: [
      [130, 60],
      [200, 160],
    ],
    extent: [640, 480],
    points: [[0, 0]],
  },
});
const [x, y]: [number, number] = mapped.data!.points![0]!;
assert.deepEqual([x.toFixed(2), y.toFixed(2)], ["26.96", "-37.88"]);
assert.equal(
  (
    await mapSessionPoints({
      path,
      body: {
        q,
        points: [
          [0, 0],
          [320.5, 240.5],
        ],
      },
    })
  ).data?.points?.length,
  2,
);
// @ts-expect-error: a place has two numbers.
const wrong: PosedHandles = [[1, 2, 3]];
const problem = (await warpSession({ path, body: { q: wrong } })).error;
assert.deepEqual(
  [problem?.code, problem?.status, typeof problem?.detail],
  ["bad_value", 422, "string"],
);
// @ts-expect-error: the codes are known.
assert(!(problem?.code === "no_such_code"));
assert.equal((await getSession({ path, auth: undefined })).error?.code, "unauthorized");

assert.equal((await deleteSession({ path })).response?.status, 204);

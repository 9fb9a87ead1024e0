// The types of openapi-typescript, with openapi-fetch: every step of the conversation in `run`.

import assert from "node:assert/strict";
import { openAsBlob } from "node:fs";
import { writeFile } from "node:fs/promises";
import createClient from "openapi-fetch";
import type { components, paths } from "./mlswarp.js";

type Handles = components["schemas"]["PosedHandles"];
const [server, key, picture, folder] = process.argv.slice(2) as [string, string, string, string];
const p: Handles = [
  [120, 80],
  [
    [40, 200],
    [300, 210],
  ],
];
const q: Handles = [
  [130, 60],
  [
    [40, 220],
    [300, 190],
  ],
];
const output = { width: 200 };
const image = await openAsBlob(picture);

// The two parts of an upload.
const bodySerializer = ({ image, warp }: { image: Blob; warp: object }) => {
  const form = new FormData();
  form.set("image", image);
  form.set("warp", JSON.stringify(warp));
  return form;
};
const save = async (name: string, file: Blob | undefined) =>
  writeFile(`${folder}/${name}`, Buffer.from(await file!.arrayBuffer()));

const client = createClient<paths>({
  baseUrl: server,
  headers: { Authorization: `Bearer ${key}` },
});
const warped = await client.POST("/warp", {
  body: { image, warp: { p, q, output } },
  bodySerializer,
  parseAs: "blob",
});
await save("warped.png", warped.data);

const opened = await client.POST("/sessions", { body: { image, warp: { p } }, bodySerializer });
const session: components["schemas"]["Session"] = opened.data!;
assert.deepEqual(
  [session.image.width, session.image.height, session.p, session.seq],
  [451, 300, p, null],
);
const params = { path: { id: session.id } };
const dragged = await client.POST("/sessions/{id}/warp", {
  params,
  body: { q, seq: 1, output },
  parseAs: "blob",
});
await save("dragged.png", dragged.data);
const again = await client.GET("/sessions/{id}", { params });
assert.equal(again.data?.seq, 1);

const mapped = await client.POST("/points", {
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
const placed = await client.POST("/sessions/{id}/points", {
  params,
  body: {
    q,
    points: [
      [0, 0],
      [320.5, 240.5],
    ],
  },
});
assert.equal(placed.data?.points?.length, 2);
// @ts-expect-error: a place has two numbers.
const wrong: Handles = [[1, 2, 3]];
const problem = (await client.POST("/sessions/{id}/warp", { params, body: { q: wrong } })).error;
assert.deepEqual(
  [problem?.code, problem?.status, typeof problem?.detail],
  ["bad_value", 422, "string"],
);
// @ts-expect-error: the codes are known.
assert(!(problem?.code === "no_such_code"));
const stranger = createClient<paths>({ baseUrl: server });
assert.equal((await stranger.GET("/sessions/{id}", { params })).error?.code, "unauthorized");

assert.equal((await client.DELETE("/sessions/{id}", { params })).response.status, 204);

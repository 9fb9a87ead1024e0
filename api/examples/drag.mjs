// Drags one handle of an image along a circle, as a user would, and saves the last frame.
//
//     npm install ws
//     node drag.mjs IMAGE OUT.png [http://127.0.0.1:8080] [--key KEY]
//
// A server with keys needs one: --key, or the variable MLSWARP_KEY, which no other user of the
// machine can see.
//
// A browser needs no package: use its WebSocket with `socket.binaryType = "arraybuffer"`, and show
// a frame with URL.createObjectURL(new Blob([picture])). It cannot set headers; the key goes into
// the subprotocols:
// new WebSocket(url, ["mlswarp", `mlswarp.bearer.${key in base64url without padding}`]).

import { readFile, writeFile } from "node:fs/promises";
import { setTimeout as pause } from "node:timers/promises";
import { parseArgs } from "node:util";
import WebSocket from "ws";

const STEPS = 120;
const PATIENCE = 5000; // ms without a message, after which the socket is given up
let newest = 0; // the last pose sent

const { values, positionals } = parseArgs({
  allowPositionals: true,
  options: { key: { type: "string" } },
});
const key = values.key ?? process.env.MLSWARP_KEY;
const [picture, out, given = "http://127.0.0.1:8080"] = positionals;
if (!out) fail("usage: node drag.mjs IMAGE OUT.png [SERVER] [--key KEY]");
const server = given.replace(/\/+$/, "");
const headers = key ? { Authorization: `Bearer ${key}` } : {};

function fail(message) {
  console.error(message);
  process.exit(1);
}

// What the server says about a request that failed: a problem document (RFC 9457).
function failure(status, body) {
  try {
    const { code, detail } = JSON.parse(body);
    if (code) return `${code}: ${detail}`;
  } catch {} // something else is there, for example a proxy
  return `the server answered ${status}: ${String(body).slice(0, 200)}`;
}

async function request(address, options) {
  const unreachable = ({ message, cause }) =>
    fail(`cannot reach ${server}: ${cause?.message || cause?.code || message}`);
  const answer = await fetch(address, { ...options, headers }).catch(unreachable);
  return answer.ok ? answer : fail(failure(answer.status, await answer.text()));
}

// The first handle moves on a circle (60 px wide), the others stay.
function pose([[x, y], ...others], step) {
  const angle = (2 * Math.PI * step) / STEPS;
  return [[x + 30 * Math.sin(angle), y + 30 - 30 * Math.cos(angle)], ...others];
}

// Sends 125 poses per second without waiting for frames: the server keeps only the newest pose.
async function move(socket, rest) {
  for (let seq = newest; seq < STEPS && socket.readyState === WebSocket.OPEN; seq++) {
    newest = seq;
    socket.send(JSON.stringify({ seq, q: pose(rest, seq) }));
    await pause(8);
  }
}

// Acknowledges each frame; the server then sends the next one. The last frame has the last pose, at
// full size.
function watch(socket) {
  return new Promise((resolve) => {
    let report; // the report of the next frame; the first message is the grid
    const silent = setTimeout(() => resolve(socket.terminate()), PATIENCE);
    socket.on("unexpected-response", async (_, answer) =>
      fail(failure(answer.statusCode, Buffer.concat(await answer.toArray()))),
    );
    socket.on("error", () => {}); // it closes then
    socket.on("close", () => resolve(clearTimeout(silent)));
    socket.on("message", (message, isBinary) => {
      silent.refresh();
      if (!isBinary) {
        report = JSON.parse(message);
        if (report.code) fail(failure(null, message));
        return;
      }
      const seq = Number(message.readBigUInt64LE(0));
      socket.send(JSON.stringify({ ack: seq }));
      if (seq === STEPS - 1 && report.full) {
        console.log(`${STEPS} poses; the last frame is ${report.width} x ${report.height}`);
        resolve(message.subarray(8));
        socket.close();
      }
    });
  });
}

// If the socket closes or is silent, opens another one, which begins with the last pose sent.
async function drag(session, rest) {
  for (let tries = 0; tries < 20; tries++) {
    const socket = new WebSocket(
      `${session.replace("http", "ws")}/drag?frames=png&width=auto&report=true`,
      { headers },
    );
    socket.on("open", () => move(socket, rest));
    const last = await watch(socket);
    if (last) return last;
    console.log("reconnecting");
    await pause(200);
  }
  return fail("the server does not answer any more");
}

// Upload the image once, with the handles at rest.
const rest = [
  [150, 120],
  [60, 60],
  [240, 60],
  [60, 240],
  [240, 240],
];
const form = new FormData();
form.set("image", new Blob([await readFile(picture).catch((error) => fail(error.message))]));
form.set("warp", JSON.stringify({ p: rest }));
const answer = await request(`${server}/sessions`, { method: "POST", body: form });
const session = new URL(answer.headers.get("Location"), answer.url).href;
// From here on, only q is sent.
await writeFile(out, await drag(session, rest));
await request(session, { method: "DELETE" });

// Drags one handle of an image along a circle, as a user would, and saves the last frame.
//
//     npm install ws
//     node drag.mjs IMAGE OUT.png [http://127.0.0.1:8080]
//
// A browser needs no package: use its WebSocket with `socket.binaryType = "arraybuffer"`, and show a frame with
// URL.createObjectURL(new Blob([picture])).

import { readFile, writeFile } from "node:fs/promises";
import { setTimeout as pause } from "node:timers/promises";
import WebSocket from "ws";

const STEPS = 120;
const PATIENCE = 5000; // ms without a message, after which the socket is given up
let newest = 0; // the last pose sent
const [picture, out, server = "http://127.0.0.1:8080"] = process.argv.slice(2);

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

// Acknowledges each frame; the server then sends the next one. The last frame has the last pose, at full size.
function watch(socket) {
  return new Promise((resolve, reject) => {
    let report; // the report of the next frame; the first message is the grid
    const silent = setTimeout(() => resolve(socket.terminate()), PATIENCE);
    socket.on("error", reject);
    socket.on("close", () => resolve(clearTimeout(silent)));
    socket.on("message", (message, isBinary) => {
      silent.refresh();
      if (!isBinary) {
        report = JSON.parse(message);
        if (report.code) reject(new Error(`${report.code}: ${report.detail}`));
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

// Upload the image once, with the handles at rest.
const rest = [[150, 120], [60, 60], [240, 60], [60, 240], [240, 240]];
const form = new FormData();
form.set("image", new Blob([await readFile(picture)]));
form.set("warp", JSON.stringify({ p: rest }));
const answer = await fetch(`${server}/sessions`, { method: "POST", body: form });
if (!answer.ok) throw new Error(await answer.text());
const session = new URL(answer.headers.get("Location"), answer.url).href;

// From here on, only q is sent. If the socket closes or is silent, opens another one, which begins with the last pose sent.
async function drag() {
  for (;;) {
    const socket = new WebSocket(`${session.replace("http", "ws")}/drag?frames=png&width=auto&report=true`);
    socket.on("open", () => move(socket, rest));
    const last = await watch(socket);
    if (last) return last;
    console.log("reconnecting");
    await pause(200);
  }
}
await writeFile(out, await drag());
await fetch(session, { method: "DELETE" });

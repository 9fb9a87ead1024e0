// Drags one handle of a picture along a circle, as a hand would, and keeps the last frame.
//
//     npm install ws
//     node drag.mjs PICTURE OUT.png [http://127.0.0.1:8080]
//
// In a browser nothing has to be installed: WebSocket is there, `socket.binaryType = "arraybuffer"`, and a frame is shown as
// URL.createObjectURL(new Blob([picture])).

import { readFile, writeFile } from "node:fs/promises";
import { setTimeout as pause } from "node:timers/promises";
import WebSocket from "ws";

const STEPS = 120;
const PATIENCE = 5000; // ms: whoever answers nothing for so long is gone, whatever the connection says
let newest = 0; // the pose that was sent last
const [picture, out, server = "http://127.0.0.1:8080"] = process.argv.slice(2);

// The first handle circles (60 px wide), the others stay.
function pose([[x, y], ...others], step) {
  const angle = (2 * Math.PI * step) / STEPS;
  return [[x + 30 * Math.sin(angle), y + 30 - 30 * Math.cos(angle)], ...others];
}

// Says where the handles are, 125 times a second. Nobody waits for a frame: the server keeps the newest pose alone.
async function move(socket, rest) {
  for (let seq = newest; seq < STEPS && socket.readyState === WebSocket.OPEN; seq++) {
    newest = seq;
    socket.send(JSON.stringify({ seq, q: pose(rest, seq) }));
    await pause(8);
  }
}

// Shows the frames and acknowledges each; the next comes after that. The last one is of the last pose, at full size.
function watch(socket) {
  return new Promise((resolve, reject) => {
    let report; // of the frame that follows; the first one tells the grid
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

// The picture is uploaded once, with the handles at rest.
const rest = [[150, 120], [60, 60], [240, 60], [60, 240], [240, 240]];
const form = new FormData();
form.set("image", new Blob([await readFile(picture)]));
form.set("warp", JSON.stringify({ p: rest }));
const answer = await fetch(`${server}/sessions`, { method: "POST", body: form });
if (!answer.ok) throw new Error(await answer.text());
const session = answer.headers.get("Location");

// From here on nothing but q travels. A socket that ends, or answers nothing, is given up; the next one begins with the pose that was sent last.
async function drag() {
  for (;;) {
    const socket = new WebSocket(`${server.replace("http", "ws")}${session}/drag?frames=png&width=auto&report=true`);
    socket.on("open", () => move(socket, rest));
    const last = await watch(socket);
    if (last) return last;
    console.log("another socket, as this one is gone");
    await pause(200);
  }
}
await writeFile(out, await drag());
await fetch(`${server}${session}`, { method: "DELETE" });

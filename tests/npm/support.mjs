// A real server, a way to it that can be cut, and a server that answers by a script.

import { spawn } from "node:child_process";
import { once } from "node:events";
import { readFileSync } from "node:fs";
import { createServer as createHttp } from "node:http";
import { createRequire } from "node:module";
import { connect, createServer } from "node:net";
import { createInterface } from "node:readline";
import { fileURLToPath } from "node:url";

export const ROOT = fileURLToPath(new URL("../../", import.meta.url));
const PROGRAM = process.env.MLSWARP_PROGRAM ?? `${ROOT}target/debug/mlswarp`;

/** A package that tests/npm/run has installed. */
export const packaged = createRequire(`${ROOT}tests/artefacts/npm/`);

/** A file of the repository. */
export const file = (path) => readFileSync(`${ROOT}${path}`);

/** A photograph of 451 x 300 px, its handles, and a pose. */
export const CAT = file("tests/images/chelsea.png");
export const P = [
  [168, 112],
  [316, 136],
  [262, 240],
];
export const Q = [
  [150, 104],
  [338, 126],
  [262, 262],
];

/** Starts the program; `port` 0 chooses one. */
export async function serve({ port = 0, options = [] } = {}) {
  const process = spawn(PROGRAM, ["serve", "--listen", `127.0.0.1:${port}`, ...options], {
    stdio: ["ignore", "ignore", "pipe"],
  });
  const lines = createInterface({ input: process.stderr });
  const address = await new Promise((resolve, reject) => {
    lines.on("line", (line) => {
      const found = /http:\/\/127\.0\.0\.1:\d+/.exec(line);
      if (found) resolve(found[0]);
    });
    process.on("exit", (code) => reject(new Error(`the server does not start: ${code}`)));
  });
  return {
    address,
    port: Number(new URL(address).port),
    /** Ends it: with SIGTERM it says so to its sockets (1012). */
    async stop(signal = "SIGTERM") {
      if (process.exitCode !== null || process.signalCode) return;
      process.kill(signal);
      await once(process, "exit");
    },
  };
}

/** A way to a server on which connections can be cut, or refused. */
export async function cuttable(port) {
  const sockets = new Set();
  const way = { refuses: false, opened: 0 };
  const relay = createServer((near) => {
    if (way.refuses) return near.destroy();
    way.opened += 1;
    const far = connect(port, "127.0.0.1");
    for (const [from, to] of [
      [near, far],
      [far, near],
    ]) {
      sockets.add(from);
      from.pipe(to);
      from.on("error", () => to.destroy());
      from.on("close", () => {
        sockets.delete(from);
        to.destroy();
      });
    }
  });
  relay.listen(0, "127.0.0.1");
  await once(relay, "listening");
  return Object.assign(way, {
    address: `http://127.0.0.1:${relay.address().port}`,
    cut() {
      for (const socket of sockets) socket.destroy();
    },
    close() {
      this.cut();
      relay.close();
    },
  });
}

/**
 * A server that answers each request by the next function of a list, and keeps what it was asked.
 */
export async function scripted(answers) {
  const asked = [];
  const server = createHttp((request, response) => {
    asked.push({ method: request.method, url: request.url, headers: request.headers });
    request.resume();
    const answer = answers[Math.min(asked.length, answers.length) - 1];
    answer(response, request);
  });
  server.listen(0, "127.0.0.1");
  await once(server, "listening");
  return {
    asked,
    address: `http://127.0.0.1:${server.address().port}`,
    server,
    close() {
      server.closeAllConnections();
      server.close();
    },
  };
}

/** An answer with a problem document. */
export const problem =
  (status, code, headers = {}) =>
  (response) => {
    response.writeHead(status, { "Content-Type": "application/problem+json", ...headers });
    response.end(
      JSON.stringify({ type: `/problems/${code}`, title: code, status, code, detail: code }),
    );
  };

/** An answer with JSON. */
export const answer = (object) => (response) => {
  response.writeHead(200, { "Content-Type": "application/json" });
  response.end(JSON.stringify(object));
};

/** Waits until something is so, at most 10 s. */
export async function until(is, what) {
  for (let tries = 0; tries < 500; tries++) {
    const found = await is();
    if (found) return found;
    await new Promise((resolve) => setTimeout(resolve, 20));
  }
  throw new Error(`not within 10 s: ${what}`);
}

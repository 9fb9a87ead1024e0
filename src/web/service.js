// Who answers the page: the server that it came from or, on a static host, the engine in workers of
// this browser. No other module asks which of them it is.

import { named } from "./dom.js";

/** Where a server writes its limits into the page. A static host sends the page as it lies there. */
const PLACE = "{limits}";

const told = named("limits");
/** Whether a server answers. */
const isServed = told !== PLACE;

/** Those of the engine: see `Limits` in src/engine/warp/spec.rs; its memory ends before 4 GiB. */
const OF_ENGINE = "body=268435456 pixels=50000000 side=16384 idle=0 memory=1";

export const limits = /** @type {Page.Limits} */ (
  Object.fromEntries(
    (isServed ? told : OF_ENGINE)
      .split(" ")
      .map((pair) => pair.split("="))
      .map(([name, value]) => [name, Number(value)]),
  )
);

/** What it does besides sessions, meshes, pictures and landmark files; `static/controls.js`. */
export const does = {
  /** Answers over sockets, sends coefficients, and reports the progress of an upload. */
  transport: isServed,
  /** Maps annotations. */
  annotations: isServed,
  /** Keeps sessions that others can open. */
  links: isServed,
};

/** As `fetch`. @type {(path: string, request: RequestInit) => Promise<Response>} */
export const send = isServed
  ? (path, request) => fetch(path, request)
  : async (path, request) => (await import("./static/engine.js")).answer(path, request);

/** Gets the engine, and switches off what needs a server. The controls are there. */
export const prepare = isServed
  ? async () => {}
  : async () => (await import("./static/controls.js")).prepare();

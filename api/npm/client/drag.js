// A drag over the socket of a session: the newest pose wins, and a connection that breaks is opened
// again. The rules of the page (`src/web/live.js`) hold here too.

import { jsonOf } from "../engine/json.js";
import { ApiError, ConnectionFailed, GONE } from "./errors.js";
import { floats } from "./rendered.js";

/** @typedef {import("./contract.js").Handle} Handle */

/**
 * What frames are: files of a format, chosen by the server (`auto`), or posed grids. `width`: of
 * the previews, px, or `auto`. `compact`: meshes of at most 20 kB. Without `report` a frame has no
 * figures.
 *
 * @typedef {{
 *   frames?: "auto" | "png" | "jpeg" | "webp" | "tiff" | "mesh",
 *   width?: number | "auto",
 *   compact?: boolean,
 *   tolerance?: number,
 *   window?: number | "auto",
 *   report?: boolean,
 *   signal?: AbortSignal,
 * }} DragOptions
 */

/**
 * The grid of the meshes, px of the source.
 *
 * @typedef {{ columns: number, rows: number, width: number, height: number, cell: [number, number] }} Grid
 */

/**
 * What the server says of a frame; the description of the socket has every member.
 *
 * @typedef {{
 *   seq: number,
 *   full: boolean,
 *   width?: number,
 *   height?: number,
 *   format?: string,
 *   folds?: number,
 *   residual?: number,
 *   warnings?: string[],
 *   canvas?: import("./rendered.js").Box,
 *   timing: Record<string, number>,
 * }} FrameReport
 */

/** Pauses before the socket is opened again, ms: at a random time below, doubled with each. */
const [SHORTEST, LONGEST] = [200, 5000];
/** Buffered bytes beyond which newer poses wait here. */
const BACKLOG = 1 << 16;
/** A pose that waits this much longer than the quickest frame took says that poses queue, ms. */
const QUEUE = 300;
/** Without an answer for this time, the socket is given up, ms. */
const PATIENCE = 5000;
/** Close codes: the session has ended; a rule was broken, or access has ended; a message is too large. */
const [ENDED, POLICY, TOO_LARGE] = [1000, 1008, 1009];

/** One frame of a drag. */
export class Frame {
  /** @type {() => void} */
  #shown;

  /**
   * @param {number} pose
   * @param {ArrayBuffer} bytes
   * @param {Grid | null} grid the grid, if frames are meshes
   * @param {boolean} compact
   * @param {FrameReport | null} report
   * @param {() => void} shown
   */
  constructor(pose, bytes, grid, compact, report, shown) {
    /** The number that `drag.pose` returned. */
    this.pose = pose;
    this.report = report;
    /** Whether it has the full size of the picture: the last frame of a pose has. */
    this.full = report?.full ?? false;
    /** The file of the picture; without one, frames are meshes. */
    this.blob = grid ? null : new Blob([new Uint8Array(bytes, 8)], mediaOf(report));
    /** The posed grid, as of `session.mesh`. */
    this.mesh = grid && { ...grid, xy: compact ? unpacked(grid, bytes) : floats(bytes, 8) };
    this.#shown = shown;
  }

  /** Tells the server that the frame is shown. Iteration does it when it goes on. */
  ack() {
    this.#shown();
    this.#shown = () => {};
  }
}

/** @param {FrameReport | null} report */
const mediaOf = (report) => (report?.format ? { type: `image/${report.format}` } : {});

/**
 * A compact mesh: a scale, and the displacement of each vertex as 16-bit integers.
 *
 * @param {Grid} grid
 * @param {ArrayBuffer} bytes
 */
function unpacked({ columns, rows, width, height, cell }, bytes) {
  const data = new DataView(bytes);
  const scale = data.getFloat32(8, true);
  const xy = new Float32Array(2 * columns * rows);
  for (let j = 0, k = 0; j < rows; j++) {
    const y = j === rows - 1 ? height : j * cell[1];
    for (let i = 0; i < columns; i++, k += 2) {
      const x = i === columns - 1 ? width : i * cell[0];
      xy[k] = x + scale * data.getInt16(12 + 2 * k, true);
      xy[k + 1] = y + scale * data.getInt16(14 + 2 * k, true);
    }
  }
  return xy;
}

/**
 * Events: `frame` (`event.frame`; it is acknowledged after the listeners, unless one has called
 * `preventDefault` and acknowledges it when it is drawn), `problem` (`event.error`: of a pose that
 * cannot be warped; the drag goes on) and `state`.
 */
export class Drag extends EventTarget {
  /** @type {import("./http.js").Http} */
  #http;
  /** @type {import("./session.js").Session} */
  #session;
  #query;
  #compact;
  /** @type {WebSocket | null} */
  #socket = null;
  /** @type {"connecting" | "open" | "reconnecting" | "closed"} */
  #state = "connecting";
  #tries = 0;
  #reopening = /** @type {ReturnType<typeof setTimeout> | undefined} */ (undefined);
  #overdue = /** @type {ReturnType<typeof setTimeout> | undefined} */ (undefined);
  /** Aborts what prepares the next socket. */
  #end = new AbortController();

  #pose = 0;
  /** The newest pose, and whether it has been sent on this socket. @type {object | null} */
  #newest = null;
  #isSent = true;
  /** Poses that the socket has not answered, and when they were sent. @type {Map<number, number>} */
  #unanswered = new Map();
  #quickest = Infinity;
  /** @type {FrameReport | null} */
  #report = null;
  /** Frames that have not been acknowledged. */
  #shownLater = 0;

  /** The newest frame that the iterator has not taken. @type {Frame | null} */
  #waiting = null;
  /** @type {{ resolve: () => void } | null} */
  #taker = null;
  #iterates = false;

  /**
   * The grid of the meshes, when the first message of the server is here.
   *
   * @type {Grid | null}
   */
  grid = null;
  /**
   * Why the drag ended, unless `close` was called; the iterator throws it.
   *
   * @type {unknown}
   */
  error = null;

  /**
   * @param {import("./http.js").Http} http
   * @param {import("./session.js").Session} session
   * @param {DragOptions} [options]
   */
  constructor(http, session, { signal, compact = false, report = true, ...options } = {}) {
    super();
    this.#http = http;
    this.#session = session;
    this.#compact = compact;
    const query = { report, ...options, ...(compact && { frames: "mesh", mesh: "compact" }) };
    const given = Object.entries(query).filter(([, value]) => value !== undefined);
    this.#query = String(new URLSearchParams(given.map(([name, value]) => [name, `${value}`])));
    this.isMesh = compact || options.frames === "mesh";
    if (signal?.aborted) this.#finish(signal.reason);
    else {
      signal?.addEventListener("abort", () => this.#finish(signal.reason), {
        once: true,
        signal: this.#end.signal,
      });
      this.#connect();
      globalThis.addEventListener?.("online", () => this.#hurry(), { signal: this.#end.signal });
    }
  }

  /** `connecting` at first, then `open`, `reconnecting` or `closed`. */
  get state() {
    return this.#state;
  }

  /**
   * Poses the handles. Never waits: a pose that has not been sent is replaced. Returns its number.
   *
   * @param {Handle[]} q
   * @param {{ strength?: number }} [options]
   */
  pose(q, { strength } = {}) {
    this.#pose += 1;
    this.#newest = { seq: this.#pose, q, strength };
    this.#isSent = false;
    this.#flush();
    return this.#pose;
  }

  /** Ends the drag. */
  close() {
    this.#finish(null);
  }

  [Symbol.dispose]() {
    this.close();
  }

  /**
   * The frames, the newest whenever the loop is ready for one. Going on acknowledges the one
   * before; leaving the loop closes the drag.
   *
   * @returns {AsyncGenerator<Frame, void, void>}
   */
  async *[Symbol.asyncIterator]() {
    this.#iterates = true;
    try {
      for (;;) {
        while (!this.#waiting && this.#state !== "closed")
          await new Promise((resolve) => (this.#taker = { resolve: () => resolve(undefined) }));
        const frame = this.#waiting;
        this.#waiting = null;
        if (!frame) break;
        yield frame;
        frame.ack();
      }
    } finally {
      this.close();
    }
    if (this.error) throw this.error;
  }

  // The connection

  /** @param {typeof this.state} state */
  #become(state) {
    if (state === this.#state) return;
    this.#state = state;
    this.dispatchEvent(new Event("state"));
  }

  async #connect() {
    try {
      const path = `sessions/${encodeURIComponent(this.#session.id)}/drag?${this.#query}`;
      const socket = await this.#http.socket(path);
      if (this.#state === "closed") return shut(socket);
      this.#socket = socket;
      /** @type {<E>(then: (event: E) => void) => (event: E) => void} */
      const current = (then) => (event) => socket === this.#socket && then(event);
      let wasOpen = false;
      socket.onopen = current(() => {
        wasOpen = true;
        this.#opened();
      });
      socket.onmessage = current(({ data }) =>
        typeof data === "string" ? this.#text(JSON.parse(data)) : this.#binary(data),
      );
      // What went wrong is in `onclose`, which follows. `ws` throws without a listener.
      socket.onerror = () => {};
      socket.onclose = current(({ code, reason }) => this.#closed(code, reason, wasOpen));
    } catch (error) {
      // The function that gets tokens has failed, or there is no WebSocket.
      if (error instanceof TypeError) this.#finish(error);
      else this.#again();
    }
  }

  #opened() {
    this.#unanswered.clear();
    this.#shownLater = 0;
    this.#report = null;
    this.#isSent = this.#newest === null;
    this.#become("open");
    this.#flush();
  }

  /**
   * @param {number} code
   * @param {string} reason
   * @param {boolean} wasOpen
   */
  async #closed(code, reason, wasOpen) {
    clearTimeout(this.#overdue);
    this.#overdue = undefined;
    this.#socket = null;
    const isExpired = reason === "token_expired" && this.#http.forget();
    if (wasOpen && code === TOO_LARGE)
      return this.#finish(
        new ConnectionFailed("closed", "the pose is larger than the server reads"),
      );
    if (wasOpen && code === POLICY && !isExpired)
      return this.#finish(
        new ConnectionFailed("closed", `the server has closed the drag: ${reason}`),
      );
    this.#become(this.#state === "connecting" ? "connecting" : "reconnecting");
    // A socket that does not open gives no reason; nor does one that ends with its session.
    if ((!wasOpen || code === ENDED) && !(await this.#isThere())) return;
    if (isExpired) this.#connect();
    else this.#again();
  }

  /** Whether the session is there, perhaps again. Otherwise the drag ends. */
  async #isThere() {
    try {
      await this.#session.refresh({ signal: this.#end.signal, maxRetries: 0 });
      return true;
    } catch (error) {
      if (this.#state === "closed") return false;
      if (!(error instanceof ApiError) || error.status >= 429) return true;
      // A token need not be for the session object. But the server is there, and the socket is not.
      if (error.status === 403 && this.#tries < 2) return true;
      try {
        if (GONE.has(error.code) && (await this.#session.reopened())) return true;
      } catch (failure) {
        if (!(failure instanceof ApiError) || failure.status >= 429) return true;
      }
      this.#finish(error);
      return false;
    }
  }

  #again() {
    if (this.#state === "closed") return;
    const longest = Math.min(LONGEST, SHORTEST * 2 ** this.#tries++);
    clearTimeout(this.#reopening);
    this.#reopening = setTimeout(() => this.#hurry(), Math.random() * longest);
  }

  /** Opens the socket now, if none is open or opening. */
  #hurry() {
    clearTimeout(this.#reopening);
    if (!this.#socket && this.#state !== "closed") this.#connect();
  }

  /** @param {unknown} error */
  #finish(error) {
    if (this.#state === "closed") return;
    this.error = error;
    clearTimeout(this.#reopening);
    clearTimeout(this.#overdue);
    const socket = this.#socket;
    this.#socket = null;
    if (socket) shut(socket);
    this.#become("closed");
    this.#end.abort();
    if (error) this.#waiting = null;
    this.#wake();
  }

  #wake() {
    this.#taker?.resolve();
    this.#taker = null;
  }

  // Messages

  #flush() {
    const socket = this.#socket;
    if (this.#isSent || !socket || this.#state !== "open") return;
    // An unanswered pose is overdue, unless the frames of others wait to be shown.
    this.#overdue ??= setTimeout(() => this.#giveUp(), PATIENCE);
    const [oldest = Infinity] = this.#unanswered.values();
    const late = (Number.isFinite(this.#quickest) ? this.#quickest : QUEUE) + QUEUE;
    if (performance.now() - oldest > late || socket.bufferedAmount > BACKLOG) return;
    this.#isSent = true;
    this.#unanswered.set(this.#pose, performance.now());
    socket.send(jsonOf(this.#newest));
  }

  #giveUp() {
    this.#overdue = undefined;
    const socket = this.#socket;
    if (!socket || !(this.#unanswered.size || !this.#isSent)) return;
    if (this.#shownLater) return void (this.#overdue = setTimeout(() => this.#giveUp(), PATIENCE));
    this.#socket = null;
    shut(socket);
    this.#become("reconnecting");
    this.#again();
  }

  /**
   * The answer to a pose is also that to all older ones.
   *
   * @param {number} seq
   */
  #answered(seq) {
    clearTimeout(this.#overdue);
    this.#overdue = undefined;
    this.#tries = 0;
    const sent = this.#unanswered.get(seq);
    if (sent !== undefined) this.#quickest = Math.min(this.#quickest, performance.now() - sent);
    for (const old of this.#unanswered.keys()) if (old <= seq) this.#unanswered.delete(old);
    if (this.#unanswered.size) this.#overdue = setTimeout(() => this.#giveUp(), PATIENCE);
  }

  /** @param {any} message */
  #text(message) {
    if (message.columns) this.grid = message;
    else if (message.code) {
      this.#answered(message.seq ?? this.#pose);
      const error = new ApiError(message, message.status ?? 0, null);
      this.dispatchEvent(Object.assign(new Event("problem"), { error }));
      this.#flush();
    } else if (message.timing) this.#report = message;
  }

  /** @param {ArrayBuffer} bytes */
  #binary(bytes) {
    const seq = Number(new DataView(bytes).getBigUint64(0, true));
    this.#answered(seq);
    const socket = this.#socket;
    const shown = () => {
      if (socket !== this.#socket || !socket) return;
      this.#shownLater = 0;
      socket.send(JSON.stringify({ ack: seq }));
      this.#flush();
    };
    const report = this.#report?.seq === seq ? this.#report : null;
    const grid = this.isMesh ? this.grid : null;
    this.#shownLater += 1;
    const frame = new Frame(seq, bytes, grid, this.#compact, report, shown);
    const event = Object.assign(new Event("frame", { cancelable: true }), { frame });
    if (this.dispatchEvent(event) && !this.#iterates) frame.ack();
    if (this.#iterates) {
      this.#waiting = frame;
      this.#wake();
    }
    this.#flush();
  }
}

/**
 * Closes a socket. One that is not open yet is closed when it is: otherwise browsers log an error.
 *
 * @param {WebSocket} socket
 */
function shut(socket) {
  socket.onmessage = socket.onclose = null;
  if (socket.readyState === 0) socket.onopen = () => socket.close(1000);
  else socket.close(1000);
}

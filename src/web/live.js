// Live poses during a drag: the newest wins. By the drag socket, on which several poses may be
// unanswered, or by POST, one at a time, if the socket does not open. Responses are posed grids, or
// pictures without WebGL.

import { keyProtocols } from "./access.js";
import * as api from "./api.js";
import { boxFrom } from "./canvas.js";
import { known } from "./dom.js";
import { askForToken } from "./frame.js";
import { Mesh } from "./mesh.js";

/** Consecutive failures to open the socket before the session uses POST. */
const TRIES = 3;
/**
 * Time without a response, ms, after which the socket is given up, even if the connection looks
 * open.
 */
const PATIENCE = 5000;
/** Buffered bytes of the socket beyond which newer poses wait here. */
const BACKLOG = 1 << 16;
/**
 * A pose that is unanswered for this much longer than the quickest response took, ms, means that
 * the connection queues: newer poses wait here. Before the first response, the quickest is assumed
 * to take this long.
 */
const QUEUE = 300;
/**
 * Time, ms, after which a socket that has closed by itself is opened again. It doubles with each
 * attempt, which is made at a random time of its second half. After the last attempt, the next
 * response to a request opens the socket.
 */
const AGAIN = 1000;
const ATTEMPTS = 8;
/** Close code of a session that has ended. */
const ENDED = 1000;

/** @typedef {{ q: Page.WireHandle[], revision: number }} LivePose */

/**
 * Whom it tells. `done` is called when a response is shown: it acknowledges the frame.
 *
 * @typedef {{
 *   mesh: (
 *     mesh: Page.Mesh,
 *     isCompact: boolean,
 *     revision: number,
 *     report: Page.FrameReport | null,
 *     done: () => void,
 *   ) => void,
 *   frame: (
 *     blob: Blob,
 *     revision: number,
 *     report: Page.FrameReport | null,
 *     done: () => void,
 *   ) => void,
 *   problem: (problem: Page.Problem, revision: number | undefined) => void,
 *   way: () => void,
 * }} Told
 */

export class Live {
  /** @type {string | null} */
  #id = null;
  /** @type {WebSocket | null} */
  #socket = null;
  #failures = 0;
  #open = false;
  /** @type {Page.MeshGrid | null} */
  #grid = null;
  /**
   * Of the compact meshes of the socket.
   *
   * @type {Page.MeshGrid | null}
   */
  #lattice = null;
  #seq = 0;
  /**
   * Sequence number of the socket to revision of the document.
   *
   * @type {Map<number, number>}
   */
  #revisions = new Map();
  /**
   * Sequence number of the socket to the time when it was sent, oldest first.
   *
   * @type {Map<number, number>}
   */
  #unanswered = new Map();
  /** @type {number | null} */
  #quickest = null; // time of the quickest response, ms
  /** @type {LivePose | null} */
  #waiting = null; // the newest pose that has not been sent
  /** @type {LivePose | null} */
  #sent = null; // the newest pose that the socket has not answered
  #overdue = 0;
  /** @type {AbortController | null} */
  #asking = null; // AbortController of the outstanding POST
  /** @type {Page.FrameReport | null} */
  #report = null;
  #lost = false; // an open socket was closed or given up, and no later request has been answered
  #closedAt = 0;
  // A socket that had answered was closed by the other side or the network, and none has opened
  // since.
  #broken = false;
  #reopening = 0;
  #attempts = 0;

  /**
   * `kind`: mesh or png. `told`: callbacks mesh(mesh, isCompact, revision, report, done),
   * frame(blob, revision, report, done), problem(problem, revision), way(). Call done() when a
   * response is shown: it acknowledges the frame.
   * @param {"mesh" | "png"} kind
   * @param {boolean} allowSocket
   * @param {Told} told
   */
  constructor(kind, allowSocket, told) {
    this.kind = kind;
    this.allowSocket = allowSocket;
    this.told = told;
    /** @type {() => number} */
    this.nextSeq = () => 0;
  }

  get way() {
    return this.#id === null ? "off" : this.#open ? "socket" : "http";
  }

  /**
   * Whether the socket has closed by itself, and the server has not answered a request that was
   * made since.
   */
  get lost() {
    return this.#lost;
  }

  /**
   * The server has responded to a request that was made at this time. A response to an earlier one
   * may have been under way when the server stopped.
   * @param {number} asked
   */
  found(asked) {
    if (asked < this.#closedAt) return;
    const wasLost = this.#lost;
    this.#lost = false;
    if (!wasLost || !this.#broken) return;
    // The socket may open again, whatever its failures meanwhile. One that is opening may have
    // begun while the server was away: it fails, and another one follows, because the socket counts
    // as broken until one is open.
    this.#failures = this.#attempts = 0;
    clearTimeout(this.#reopening);
    if (!this.#socket) this.#connect();
  }

  /**
   * `grid` and `nextSeq` are for POST: the session's grid, and the page-wide sequence numbers.
   * @param {string} id
   * @param {Page.MeshGrid} grid
   * @param {() => number} nextSeq
   */
  open(id, grid, nextSeq) {
    this.nextSeq = nextSeq;
    this.#grid = grid;
    if (id === this.#id) return;
    this.close();
    this.#id = id;
    this.#failures = 0;
    this.#connect();
  }

  /** Call after the key has changed: a rejected socket may open now. */
  again() {
    this.#failures = 0;
  }

  close() {
    clearTimeout(this.#reopening);
    this.#asking?.abort();
    this.#id = null;
    this.#waiting = null;
    this.#answered();
    this.#open = this.#lost = this.#broken = false;
    const socket = this.#socket;
    this.#socket = null;
    // Closing a socket that is not open yet would log an error.
    if (socket?.readyState === WebSocket.CONNECTING) socket.onopen = () => socket.close(1000);
    else socket?.close(1000);
    this.told.way();
  }

  /**
   * Sends a pose; drops older poses that have not been sent.
   * @param {Page.WireHandle[]} q
   * @param {number} revision
   */
  send(q, revision) {
    if (this.#id === null) return;
    this.#waiting = { q, revision };
    if (!this.#socket) this.#connect();
    this.#flush();
  }

  /** The drag pauses: sends nothing more, and does not wait for the outstanding response. */
  rest() {
    this.#waiting = null;
    // Still check whether the socket responds.
    this.#sent = null;
    this.#asking?.abort();
    this.#asking = null;
  }

  /**
   * `again`: whatever the failures, because an earlier socket had lived.
   * @param {boolean} [again]
   */
  #connect(again = false) {
    if (!this.allowSocket || (this.#failures >= TRIES && !again)) return this.told.way();
    const query = `frames=${this.kind}&report=true${this.kind === "mesh" ? "&mesh=compact" : "&width=auto"}`;
    const socket = new WebSocket(api.socketAddress(known(this.#id), query), keyProtocols());
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    /** @type {<E>(then: (event: E) => void) => (event: E) => void} */
    const current = (then) => (event) => socket === this.#socket && then(event);
    socket.onopen = current(() => {
      this.#open = true;
      this.#lost = this.#broken = false;
      this.#seq = 0;
      this.#revisions.clear();
      this.#unanswered.clear();
      this.#quickest = null;
      this.told.way();
      this.#flush();
    });
    socket.onmessage = current((event) =>
      typeof event.data === "string"
        ? this.#text(JSON.parse(event.data))
        : this.#binary(event.data),
    );
    socket.onclose = current(({ code, reason }) => {
      // Requests still have a grace; the next socket needs another token.
      if (reason === "token_expired") askForToken();
      // A socket that answers nothing has failed, unless it was asked for nothing.
      const hasLived = this.#open && (this.#quickest !== null || this.#seq === 0);
      if (code === ENDED) this.#open = false;
      this.#broken ||= hasLived && this.#open;
      this.#closed(hasLived ? 0 : this.#failures + 1);
    });
  }

  /**
   * Sends the unanswered pose again, by another transport if necessary.
   * @param {number} failures
   */
  #closed(failures) {
    this.#waiting ??= this.#sent;
    this.#answered();
    this.#failures = failures;
    if (this.#open) this.#closedAt = performance.now();
    this.#lost ||= this.#open;
    this.#open = false;
    this.#socket = null;
    clearTimeout(this.#reopening);
    if (this.#lost || this.#broken) this.#reopen();
    this.told.way();
    this.#flush();
  }

  /**
   * Without this, the page would learn that the server responds again only from its next request.
   */
  #reopen() {
    if (this.#attempts >= ATTEMPTS) return;
    const pause = (AGAIN * 2 ** this.#attempts++ * (1 + Math.random())) / 2;
    this.#reopening = setTimeout(
      () => (this.#lost || this.#broken) && !this.#socket && this.#connect(this.#broken),
      pause,
    );
  }

  /**
   * The response to a pose is also that to all older ones.
   * @param {number} seq
   */
  #trip(seq) {
    const sent = this.#unanswered.get(seq);
    if (sent === undefined) return;
    this.#quickest = Math.min(this.#quickest ?? Infinity, performance.now() - sent);
    this.#attempts = 0;
    for (const old of this.#unanswered.keys()) if (old <= seq) this.#unanswered.delete(old);
  }

  /** Whether a newer pose would only queue behind those that the server has not answered. */
  get #congested() {
    const [oldest = Infinity] = this.#unanswered.values();
    return (
      performance.now() - oldest > (this.#quickest ?? QUEUE) + QUEUE ||
      known(this.#socket).bufferedAmount > BACKLOG
    );
  }

  #answered() {
    clearTimeout(this.#overdue);
    this.#overdue = 0;
    this.#sent = null;
  }

  #giveUp() {
    const socket = known(this.#socket);
    this.#closed(this.#failures + 1);
    socket.close();
  }

  /** @param {Page.Json} message */
  #text(message) {
    if (message.columns) this.#lattice = message;
    else if (message.code) {
      this.#answered();
      this.#trip(message.seq ?? this.#seq);
      this.told.problem(new api.Problem(message, message.status), this.#revisions.get(message.seq));
      this.#flush();
    } else if (message.timing) this.#report = { ...message, canvas: boxFrom(message.canvas) };
  }

  /** @param {ArrayBuffer} bytes */
  #binary(bytes) {
    const seq = Number(new DataView(bytes).getBigUint64(0, true));
    this.#answered();
    this.#trip(seq);
    const revision = this.#revisions.get(seq);
    for (const old of this.#revisions.keys()) if (old < seq) this.#revisions.delete(old);
    const report = this.#report?.seq === seq ? { ...this.#report, size: bytes.byteLength } : null;
    const shown = () =>
      this.#socket?.readyState === WebSocket.OPEN &&
      this.#socket.send(JSON.stringify({ ack: seq }));
    if (revision === undefined) return shown();
    if (this.kind === "mesh")
      this.told.mesh(Mesh.ofCompact(known(this.#lattice), bytes), true, revision, report, shown);
    else
      this.told.frame(
        new Blob([new Uint8Array(bytes, 8)], { type: "image/png" }),
        revision,
        report,
        shown,
      );
    this.#flush();
  }

  #flush() {
    if (!this.#waiting || this.#id === null) return;
    if (this.#open) {
      this.#overdue ||= setTimeout(() => this.#giveUp(), PATIENCE);
      if (this.#congested) return;
      const { q, revision } = this.#waiting;
      this.#sent = this.#waiting;
      this.#waiting = null;
      this.#revisions.set(++this.#seq, revision);
      this.#unanswered.set(this.#seq, performance.now());
      known(this.#socket).send(JSON.stringify({ seq: this.#seq, q }));
    } else if (!this.#asking) {
      this.#post();
    }
  }

  async #post() {
    const { q, revision } = known(this.#waiting);
    const [id, grid] = [known(this.#id), known(this.#grid)];
    this.#waiting = null;
    const asking = new AbortController();
    this.#asking = asking;
    const asked = performance.now();
    try {
      const body = { q, seq: this.nextSeq() };
      if (this.kind === "mesh") {
        const { places, report } = await api.mesh(id, body, asking.signal);
        this.found(asked);
        if (!asking.signal.aborted)
          this.told.mesh(new Mesh(grid, places), false, revision, report, () => {});
      } else {
        const output = { width: Math.min(1024, grid.width) };
        const { blob, report } = await api.picture(id, { ...body, output }, asking.signal);
        this.found(asked);
        if (!asking.signal.aborted) this.told.frame(blob, revision, report, () => {});
      }
    } catch (error) {
      if (!api.wasAborted(error)) {
        const problem = api.asProblem(error);
        if (problem.code !== "network") this.found(asked);
        this.told.problem(problem, revision);
      }
    } finally {
      if (this.#asking === asking) this.#asking = null;
    }
    this.#flush();
  }
}

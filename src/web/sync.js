// Synchronises document, server and picture. During a drag, `plans` poses the grid here; until it
// has the coefficients, `live` sends the poses and its responses are drawn at once. When the
// pointer rests, the server's PNG is fetched. A single loop decides the next step, so that an
// outdated response is never shown.

import { aligned } from "./align.js";
import * as api from "./api.js";
import { depthsOf } from "./depth.js";
import { known } from "./dom.js";
import { infoOf, isOutlined, movedApart, ownIn, restOf, wire } from "./edits.js";
import { Live } from "./live.js";
import { Mesh } from "./mesh.js";
import { insideOf } from "./outline.js";
import { Plans } from "./plan.js";
import { maskFile, regionOf, sameRegion } from "./region.js";

/** Time without movement, ms, after which the pointer counts as resting. */
const REST = 150;
/**
 * Age of the oldest pose that is newer than the shown one, and delay of the server's picture of a
 * resting pose, ms, after which the page says that it is behind.
 */
const LATE = 1000;
const TRANSIENT = new Set([
  "network",
  "overloaded",
  "unavailable",
  "stored_by_another_version",
  "rate_limited",
  "timeout",
]);
const LOST = new Set(["no_such_session", "session_expired"]);

/**
 * The region of a session without a mask.
 * @type {Page.Region}
 */
const WHOLE = { parts: [], feather: 0 };

/**
 * What is shown before the first response.
 * @type {Page.Shown}
 */
const NOTHING = {
  revision: null,
  source: "none",
  folds: 0,
  residual: null,
  report: null,
  rate: 0,
  warnings: [],
};

export class Sync {
  /**
   * The session: { id, grid, revision (of the rest handles), rest (JSON that it was created with),
   * region (as in the document; null: unknown), setup (the server's form), borrowed (from a link of
   * another user) }.
   * @type {Page.Session | null}
   */
  session = null;
  /**
   * The picture as a file: { blob, name }.
   * @type {Page.Source | null}
   */
  file = null;
  /** @type {Page.Mesh | null} */
  mesh = null;
  /**
   * The shown PNG of the server: { blob, revision }.
   * @type {{ blob: Blob, revision: number, canvas: Page.Box | null } | null}
   */
  png = null;
  /** @type {Page.Shown} */
  shown = { ...NOTHING };

  #running = false;
  #again = false; // changed since the last step began
  /** @type {AbortController | null} */
  #cancel = null;
  #refused = -1;
  #stalled = false;
  #settled = -1;
  #sent = -1;
  /** @type {{ of: string, depths: Float32Array | null }} */
  #depths = { of: "", depths: null };
  #meshRevision = -1;
  #seq = 0;
  #asked = 0; // when the current step began, which makes the requests
  #changed = 0;
  /**
   * Those newer than the shown one, oldest first.
   *
   * @type {{ revision: number, time: number }[]}
   */
  #poses = [];
  #plans = new Plans((id, columns, rows, signal) =>
    api.plan(id, columns, rows, signal).catch((error) => {
      if (error instanceof api.Problem || api.wasAborted(error)) return null;
      throw error;
    }),
  );
  #late = 0;
  #burst = false;
  #timer = 0;
  #retries = 0;
  #reopens = 0;
  /** @type {number[]} */
  #frames = [];
  /** @type {Set<() => void>} */
  #views = new Set();

  /**
   * @param {Page.Store} store
   * @param {Page.View} view
   * @param {boolean} allowSocket
   * @param {boolean} allowPlan
   */
  constructor(store, view, allowSocket, allowPlan) {
    this.store = store;
    this.view = view;
    this.allowPlan = allowPlan && view.webgl !== "none";
    this.live = new Live(view.webgl === "none" ? "png" : "mesh", allowSocket, {
      mesh: (mesh, isCompact, revision, report, done) =>
        this.#liveMesh(mesh, isCompact, revision, report, done),
      frame: (blob, revision, report, done) => this.#liveFrame(blob, revision, report, done),
      problem: (problem, revision) => this.#liveProblem(problem, revision),
      way: () => this.#tell(),
    });
    store.subscribe((state, previous) => this.#follow(state, previous));
  }

  /** @param {() => void} view */
  subscribe(view) {
    this.#views.add(view);
  }

  #tell() {
    for (const view of this.#views) view();
  }

  /** The value of `data-state`. */
  get condition() {
    const { phase, revision, before } = this.store.state;
    if (phase !== "open") return phase;
    if (this.#refused === revision || this.#stalled) return "error";
    return this.#settled === revision && !before ? "ready" : "busy";
  }

  /** Vertices of the coefficients that poses are drawn by, or null. */
  get lattice() {
    return this.#plans.of(this.session)?.grid ?? null;
  }

  /**
   * What is missing: `server` if it does not respond; `picture` if a pose has not been shown for a
   * second or the server's picture is late; otherwise empty.
   */
  get behind() {
    const { phase, revision } = this.store.state;
    if (phase !== "open" || this.condition === "ready" || this.#refused === revision) return "";
    if (this.live.lost) return "server";
    if (this.condition !== "busy" || this.shown.source === "none") return "";
    const now = performance.now();
    const outdated = this.#poses.length > 0 && now - this.#poses[0].time >= LATE;
    const late = this.#settled !== revision && now - this.#changed >= REST + LATE;
    return outdated || late ? "picture" : "";
  }

  /**
   * Sets the session and its picture, before the document is set in the store.
   * @param {Page.SessionObject} object
   * @param {Page.Rest | null} rest
   * @param {Page.Source} file
   * @param {Page.Region | null} region
   * @param {boolean} [borrowed]
   */
  begin(object, rest, file, region, borrowed = false) {
    this.#cancel?.abort();
    this.file = file;
    this.mesh = Mesh.identity(object.image.width, object.image.height);
    this.png = null;
    this.shown = { ...NOTHING };
    this.#settled = this.#sent = this.#meshRevision = this.#refused = -1;
    this.#poses = [];
    this.#stalled = false;
    this.#adopt(object, rest, region, borrowed);
  }

  /**
   * Ends the work on the picture, before it is closed in the store. The session stays on the
   * server, so that undo is quick.
   */
  end() {
    this.#cancel?.abort();
    this.session = this.file = this.mesh = this.png = null;
    this.shown = { ...NOTHING };
    this.#plans.drop();
    this.live.close();
    this.#tell();
  }

  /**
   * @param {Page.SessionObject} object
   * @param {Page.Rest | null} rest
   * @param {Page.Region | null} region
   * @param {boolean} [borrowed]
   */
  #adopt(object, rest, region, borrowed = false) {
    this.live.found(this.#asked);
    this.session = {
      id: object.id,
      grid: gridOf(object),
      revision: object.rest_revision,
      rest: JSON.stringify(rest),
      region,
      setup: setupOf(object),
      borrowed,
    };
    this.view.isCut = isOutlined(object);
    // Numbers beyond 2^53 are inexact: if the session rejects them, the page opens its own session
    // (`#after`).
    const seq = object.seq ?? 0;
    if (Number.isSafeInteger(seq)) this.#seq = Math.max(this.#seq, seq);
    this.live.open(object.id, this.session.grid, () => this.#nextSeq());
    if (this.allowPlan) this.#plans.want(this.session, () => this.#run());
    this.#tell();
  }

  /**
   * Sequence numbers that increase across tabs and reloads: the clock, or the last number plus one.
   */
  #nextSeq() {
    this.#seq = Math.max(this.#seq + 1, Date.now());
    return this.#seq;
  }

  /**
   * @param {Page.State} state
   * @param {Page.State} previous
   */
  #follow(state, previous) {
    if (state.revision !== previous.revision) {
      const now = performance.now();
      this.#burst = !state.before && now - this.#changed < REST && state.phase === previous.phase;
      this.#changed = now;
      this.#stalled = false;
      this.#cancel?.abort();
      clearTimeout(this.#timer);
      this.#timer = setTimeout(() => this.#run(), REST + 1);
      this.#poses.push({ revision: state.revision, time: now });
      this.#remind();
    }
    if (state.before && !previous.before) this.#frames = [];
    if (!state.before && previous.before) this.#burst = false;
    this.#tell();
    this.#run();
  }

  /** Tells the views when `behind` may have changed by time alone. */
  #remind() {
    clearTimeout(this.#late);
    const left = LATE - performance.now();
    const due = [this.#poses[0]?.time ?? -Infinity, this.#changed + REST]
      .map((time) => time + left)
      .filter((time) => time > 0);
    if (!due.length) return;
    this.#late = setTimeout(
      () => {
        this.#tell();
        this.#remind();
      },
      Math.min(...due) + 1,
    );
  }

  /**
   * The document with its pose aligned by the best map of a class (align.js); null, with a problem,
   * if the server refuses.
   * @param {Page.Document} document
   * @param {Page.AlignClass} by
   * @param {Page.Picture} picture
   */
  async aligned(document, by, picture) {
    try {
      return await aligned(document, by, picture);
    } catch (error) {
      this.store.do("problem", { problem: api.asProblem(error) });
      return null;
    }
  }

  /** Retries after a problem. */
  retry() {
    this.live.again();
    this.#refused = -1;
    this.#stalled = false;
    this.store.do("problem", { problem: null });
    this.#tell();
    this.#run();
  }

  async #run() {
    this.#again = true;
    if (this.#running) return;
    this.#running = true;
    try {
      while (this.#again) {
        this.#again = false;
        try {
          if (!(await this.#step())) continue;
          this.#again = true;
          this.#retries = this.#reopens = 0;
        } catch (error) {
          if (await this.#after(error)) this.#again = true;
        }
      }
    } finally {
      this.#running = false;
      this.#tell();
    }
  }

  async #step() {
    this.#asked = performance.now();
    const { phase, document, revision, before } = this.store.state;
    if (phase !== "open" || !this.session || this.#refused === revision || this.#stalled)
      return false;
    const rest = restOf(document);
    const region = regionOf(document);
    /** @type {(rest: Page.Rest) => boolean} */
    const isRest = (rest) => JSON.stringify(rest) === this.session?.rest;
    const hasRegion = this.session.region && sameRegion(region, this.session.region);
    if (!isRest(rest) || !hasRegion) {
      // The server wants handles inside of the region that it has: without handles, any one will do.
      const bare = restOf({ ...document, handles: [] });
      const bothDiffer = !isRest(rest) && !hasRegion && isOutlined(document);
      if (bothDiffer && !isRest(bare)) await this.#putRest(bare);
      else if (bothDiffer || isRest(rest)) await this.#putRegion(region, rest);
      else await this.#putRest(rest);
      return true;
    }
    const moving = before || this.#burst;
    if (moving && performance.now() - this.#changed < REST) {
      if (!this.#poseHere(document, revision) && this.#sent !== revision)
        this.live.send(wire(document, "q"), revision);
      this.#sent = revision;
      return false;
    }
    if (this.#settled === revision) return false;
    await this.#settle(document, revision);
    return true;
  }

  /** @param {Page.Rest} rest */
  async #putRest(rest) {
    const session = known(this.session);
    if (session.borrowed) return this.#reopen(rest);
    session.rest = null; // unknown until the response arrives
    this.#tell();
    const object = await api.putHandles(session.id, rest);
    if (this.session === session) this.#adopt(object, rest, session.region);
  }

  /**
   * @param {Page.Region} region
   * @param {Page.Rest} rest
   */
  async #putRegion(region, rest) {
    const session = known(this.session);
    if (session.borrowed) return this.#reopen(rest);
    session.region = null; // unknown until the response arrives
    const { width, height } = known(this.store.state.picture);
    const has = region.parts.length > 0;
    const object = await (has
      ? api.putRegion(session.id, await maskFile(region, [width, height]))
      : api.deleteRegion(session.id));
    if (this.session === session)
      Object.assign(session, { region, revision: object.rest_revision, setup: setupOf(object) });
  }

  /**
   * Opens a new session with the same picture: the old one has expired, or belongs to another user.
   * @param {Page.Rest} rest
   */
  async #reopen(rest) {
    if (!this.file)
      throw new api.Problem(
        { code: "no_such_session", title: "The session has ended", detail: "" },
        404,
      );
    const { session } = this;
    const object = await api.openSession(this.file.blob, this.file.name, rest, {});
    if (this.session !== session) return; // another picture was opened meanwhile
    this.#adopt(object, rest, WHOLE);
    this.#meshRevision = -1;
  }

  /**
   * @param {Page.Document} document
   * @param {number} revision
   */
  async #settle(document, revision) {
    this.live.rest();
    const cancel = new AbortController();
    this.#cancel = cancel;
    // The link first carries the coefficients, which are smaller than the picture.
    await Promise.race([
      this.#plans.arrived,
      new Promise((stop) => cancel.signal.addEventListener("abort", stop)),
    ]);
    if (cancel.signal.aborted) return;
    if (this.png?.revision !== revision) this.#poseHere(document, revision);
    const { id, grid } = known(this.session);
    const body = { q: wire(document, "q"), seq: this.#nextSeq() };
    const meshing =
      this.#meshRevision === revision
        ? null
        : this.#fetchMesh(id, grid, body, revision, cancel.signal);
    const [{ blob, report }, object] = await Promise.all([
      api.picture(id, body, cancel.signal),
      api.readSession(id),
      meshing,
    ]);
    if (cancel.signal.aborted) return;
    // Another tab, or another user of the link, may have replaced the handles: then this page opens
    // its own session.
    if (setupOf(object) !== known(this.session).setup) return this.#reopen(restOf(document));
    if (!(await this.view.showPng(blob, report.canvas, cancel.signal)) || cancel.signal.aborted)
      return;
    this.png = { blob, revision, canvas: report.canvas };
    this.live.found(this.#asked);
    this.#settled = revision;
    const apart = movedApart(document, object.coincident ?? []);
    if (apart.length) this.store.do("apart", { handles: apart });
    this.#show(revision, "png", {
      folds: report.folds,
      residual: report.residual,
      report,
      warnings: report.warnings,
    });
  }

  /**
   * Draws the pose by the coefficients, if they are here.
   * @param {Page.Document} document
   * @param {number} revision
   */
  #poseHere(document, revision) {
    const plan = this.#plans.of(this.session);
    if (!plan) return false;
    const { revision: shown, plan: by } = this.shown;
    if (shown === revision && by === plan) return true;
    const [p, q] = [wire(document, "p"), wire(document, "q")];
    const mesh = this.#inDepth(plan.pose(p, q));
    this.mesh = mesh;
    this.view.showMesh(mesh, () => {});
    const residual = meetsHandles(document) ? plan.residual(mesh, p, q) : null;
    this.#show(revision, "mesh", { plan, folds: this.view.folds, residual, rate: this.#rate() });
    return true;
  }

  /**
   * @param {string} id
   * @param {Page.MeshGrid} grid
   * @param {Page.Pose} body
   * @param {number} revision
   * @param {AbortSignal} signal
   */
  async #fetchMesh(id, grid, body, revision, signal) {
    const { places, report } = await api.mesh(id, body, signal);
    if (signal.aborted) return;
    const mesh = this.#inDepth(new Mesh(grid, places));
    this.#takeMesh(mesh, revision);
    if (this.view.webgl !== "none" && this.png?.revision !== revision) {
      this.view.showMesh(mesh, () => {});
      this.#show(revision, "mesh", { folds: this.view.folds, residual: report.residual });
    }
  }

  /**
   * The mesh, with what is in front of what; that changes with the handles at rest only.
   * @param {Page.Mesh} mesh
   */
  #inDepth(mesh) {
    const { columns, rows } = mesh.grid;
    const of = `${columns} ${rows} ${this.session?.rest}`;
    if (of !== this.#depths.of)
      this.#depths = { of, depths: depthsOf(this.store.state.document, mesh) };
    mesh.depths = this.#depths.depths;
    return mesh;
  }

  /**
   * @param {Page.Mesh} mesh
   * @param {number} revision
   */
  #takeMesh(mesh, revision) {
    this.mesh = mesh;
    this.#meshRevision = revision;
    this.view.setMesh(mesh);
  }

  /**
   * @param {number} revision
   * @param {Page.Shown["source"]} source
   * @param {Partial<Page.Shown>} more
   */
  #show(revision, source, more) {
    this.#poses = this.#poses.filter((pose) => pose.revision > revision);
    this.shown = { ...this.shown, plan: null, revision, source, ...more };
    this.#remind();
    this.#tell();
  }

  /** @param {number} revision */
  #overtaken(revision) {
    return this.shown.revision !== null && revision < this.shown.revision;
  }

  /**
   * @param {Page.Mesh} mesh
   * @param {boolean} isCompact
   * @param {number} revision
   * @param {Page.FrameReport | null} report
   * @param {() => void} done
   */
  #liveMesh(mesh, isCompact, revision, report, done) {
    if (this.#overtaken(revision) || this.#settled === revision) return done();
    this.#inDepth(mesh);
    // -1: this mesh is only near that of the revision, so the full one is requested at rest.
    this.#takeMesh(mesh, isCompact ? -1 : revision);
    this.view.showMesh(mesh, done);
    this.#show(revision, "mesh", {
      folds: this.view.folds,
      ...figures(report ?? this.shown.report),
      rate: this.#rate(),
    });
  }

  /**
   * @param {Blob} blob
   * @param {number} revision
   * @param {Page.FrameReport | null} report
   * @param {() => void} done
   */
  async #liveFrame(blob, revision, report, done) {
    if (
      !this.#overtaken(revision) &&
      this.#settled !== revision &&
      (await this.view.showFrame(blob, report?.canvas ?? null)) &&
      this.#settled !== revision
    ) {
      this.#show(revision, "frame", {
        folds: report?.folds ?? 0,
        ...figures(report ?? this.shown.report),
        rate: this.#rate(),
      });
    }
    done();
  }

  /** Frames of the last second of this drag. */
  #rate() {
    const now = performance.now();
    this.#frames = [...this.#frames.filter((t) => now - t < 1000), now];
    const span = now - this.#frames[0];
    return span < 200 ? 0 : ((this.#frames.length - 1) * 1000) / span;
  }

  /**
   * Reports problems of the newest pose only. The loop handles lost sessions and sessions with
   * replaced handles (`#after`).
   * @param {Page.Problem} problem
   * @param {number | undefined} revision
   */
  #liveProblem(problem, revision) {
    if (
      problem.code === "superseded" ||
      problem.code === "shape_mismatch" ||
      TRANSIENT.has(problem.code) ||
      LOST.has(problem.code)
    )
      return;
    if (revision === this.store.state.revision) this.#refuse(problem);
  }

  /** @param {Page.Problem} problem */
  #refuse(problem) {
    const { document, revision } = this.store.state;
    this.#refused = revision;
    const inside = problem.code === "outside_mask" ? insideOf(this.view, document) : null;
    if (inside) {
      const { beside } = Object.assign(problem, { beside: inside.beside(document.handles) });
      problem.findMove = () => beside.length > 0 && inside.moved(document.handles) !== null;
    }
    this.store.do("problem", { problem });
    this.#tell();
  }

  /**
   * Resolves when the newest pose has its picture, or when none is expected.
   * @returns {Promise<void>}
   */
  settled() {
    const done = () => this.condition === "ready" || this.condition === "error";
    return new Promise((resolve) => {
      const look = () => {
        if (!done()) return;
        this.#views.delete(look);
        resolve();
      };
      this.#views.add(look);
      look();
    });
  }

  /**
   * Makes a request to the session of the newest pose. If the session has ended, it is opened again
   * and the request is repeated.
   * @template T
   * @param {(id: string) => Promise<T>} act
   * @returns {Promise<T>}
   */
  async ask(act) {
    await this.settled();
    try {
      return await act(known(this.session).id);
    } catch (error) {
      const isLost = error instanceof api.Problem && LOST.has(error.code);
      if (!isLost || !this.file) throw error;
    }
    this.#settled = -1;
    this.#run();
    await this.settled();
    return act(known(this.session).id);
  }

  /**
   * Whether to continue after an error.
   * @param {unknown} error
   * @returns {Promise<boolean>}
   */
  async #after(error) {
    if (api.wasAborted(error)) return true;
    const isUnreadable = error instanceof DOMException && error.name === "EncodingError";
    let problem = isUnreadable ? new api.Problem({ code: "unreadable" }, 0) : api.asProblem(error);
    const { phase, document } = this.store.state;
    if (phase !== "open" || !this.session) return false;
    try {
      if (problem.code === "superseded") {
        const seq = (await api.readSession(this.session.id)).seq ?? 0;
        if (Number.isSafeInteger(seq) && this.#reopens++ < 3) this.#seq = seq;
        else await this.#reopen(restOf(document));
        return true;
      }
      // The shapes do not match: another client has replaced the handles of the session.
      if (
        (LOST.has(problem.code) || problem.code === "shape_mismatch") &&
        this.file &&
        this.#reopens++ < 3
      ) {
        await this.#reopen(restOf(document));
        return true;
      }
    } catch (second) {
      problem = api.asProblem(second);
    }
    if (TRANSIENT.has(problem.code)) {
      this.#stalled = true;
      this.store.do("problem", { problem });
      const seconds = problem.retry_after ?? Math.min(15, 2 ** this.#retries++);
      setTimeout(() => this.#stalled && this.retry(), 1000 * seconds);
    } else {
      this.#refuse(problem);
    }
    return false;
  }
}

/**
 * A report, and the residual: of a compact mesh at most that of the full one and the distance
 * between both.
 * @type {(report: Page.FrameReport | Page.Report | null) => Pick<Page.Shown, "report" |
 * "residual">}
 */
const figures = (report) => ({
  report,
  residual: report?.residual == null ? null : report.residual + (report.error ?? 0),
});

/**
 * Whether a warp takes its handles to their posed positions, as far as its grid can follow them.
 * @type {(document: Page.Document) => boolean}
 */
const meetsHandles = (document) => {
  const { interpolates, name } = infoOf(document);
  if (typeof interpolates === "boolean") return interpolates;
  /** @type {Page.Json} */
  const given = { smoothing: document.smoothing, ...document.own?.[name] };
  const usual = infoOf(document).parameters.find((own) => own.name === interpolates)?.default;
  return (given[interpolates] ?? usual) === 0;
};

/**
 * The members of a session object that determine a picture, except q.
 * @param {Page.SessionObject} object
 */
function setupOf(object) {
  const {
    p,
    weights,
    depth,
    method,
    alpha,
    point_mass: mass,
    smoothing,
    metric,
    mask,
    coincident_policy: coincident,
    units,
    grid,
    folds,
    output,
    layers,
  } = object;
  return JSON.stringify([
    p,
    weights,
    depth,
    method,
    alpha,
    mass,
    smoothing,
    metric,
    mask,
    ownIn(object),
    coincident,
    units,
    grid,
    folds,
    output,
    layers?.region,
  ]);
}

/**
 * The grid of a session object, in the form of a mesh.
 * @param {Page.SessionObject} object
 * @returns {Page.MeshGrid}
 */
function gridOf({ grid, image }) {
  return {
    columns: grid.columns,
    rows: grid.rows,
    cell: grid.cell,
    width: image.width,
    height: image.height,
  };
}

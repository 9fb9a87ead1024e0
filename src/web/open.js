// Opens a picture: a file (dropped, pasted, picked), a sample, a link, or a kept one (undo,
// reload). Closes it.

import { aligned } from "./align.js";
import { readAnnotations } from "./annotations.js";
import * as api from "./api.js";
import { known } from "./dom.js";
import { alphaOf, hasFocus, ownIn, restOf, sameRest } from "./edits.js";
import { inMemory, sorted } from "./files.js";
import { documentOf, readBoth, readHandles, scaled } from "./handlesfile.js";
import { forgetFiles, keepFile, kept, keptAnnotations, keptFile } from "./keep.js";
import { NeedsPicture } from "./landmarks.js";
import { filesOf, replaced, stepped, without } from "./pictures.js";
import { readProject } from "./project.js";
import { maskPart, regionOf, sizeOfMask } from "./region.js";
import { SAMPLES } from "./samples.js";
import { does } from "./service.js";
import { readLink } from "./share.js";
import { emptyDocument } from "./state.js";
import { atStrength } from "./strength.js";
import { bytes, count, deadLinkWords } from "./words.js";

const LOST = new Set(["no_such_session", "session_expired"]);

/** @typedef {{ document: Page.Document, annotations?: Page.Annotations | null }} Completed */

/**
 * What a picture is opened with, besides its session, document and file; `history` makes the
 * history of pictures from the state and the picture that was open.
 *
 * @typedef {{
 *   picture: { name: string, sample?: string | null, linked?: boolean },
 *   past?: Page.Document[],
 *   future?: Page.Document[],
 *   annotations?: Page.Annotations | null,
 *   borrowed?: boolean,
 *   fileKey?: IDBValidKey | null,
 *   link?: string | null,
 *   history?: (now: Page.History, left: Page.Kept) => Page.History,
 * }} More
 */

/** @type {(error: unknown) => boolean} */
const isUnreadable = (error) => error instanceof DOMException && error.name === "EncodingError";

export class Opener {
  /**
   * Key of the file in IndexedDB, and the link that opened this tab.
   * @type {IDBValidKey | null}
   */
  fileKey = null;
  /** @type {string | null} */
  link = null;

  /** @type {AbortController | null} */
  #cancel = null;
  /** @type {(() => Promise<void>) | null} */
  #tried = null;
  /** Whether what is being opened, or was refused, has to come without its annotations. */
  #bare = false;

  /**
   * `told` is called when a file has been stored; `toast` shows a message for a short time.
   * @param {Page.Store} store
   * @param {Page.Sync} sync
   * @param {Page.View} view
   * @param {Page.UserActions} actions
   * @param {Page.Limits} limits
   * @param {() => void} told
   * @param {(words: string) => void} toast
   */
  constructor(store, sync, view, actions, limits, told, toast) {
    this.store = store;
    this.sync = sync;
    this.view = view;
    this.actions = actions;
    this.limits = limits;
    this.told = told;
    this.toast = toast;
    store.subscribe(({ annotations }, previous) => {
      if (annotations && annotations !== previous.annotations) this.#keep(annotations);
    });
  }

  /** The keys of the stored files that must stay. */
  get #needed() {
    const { state } = this.store;
    const open = [this.fileKey, state.annotations?.key];
    return [...filesOf(state), ...open.filter((key) => key !== null && key !== undefined)];
  }

  /**
   * Stores annotations beside their picture.
   * @param {Page.Annotations} annotations
   */
  async #keep(annotations) {
    if (annotations.key !== undefined) return;
    annotations.key = null; // not stored yet
    const blob = new Blob([JSON.stringify(annotations.geojson)], { type: "application/geo+json" });
    annotations.key = await keepFile(blob, annotations.name, this.#needed);
    this.told();
  }

  /** Forgets the annotations of all pictures, stored ones too. Whether there were any. */
  async forgetAnnotations() {
    this.#bare = true;
    const { annotations, waiting, earlier, later } = this.store.state;
    // What could not be restored is in the storage only.
    const stored = kept();
    const pictures = [stored, ...(stored?.earlier ?? []), ...(stored?.later ?? [])];
    const all = [...pictures, ...earlier, ...later, this.store.state, waiting].map(
      (one) => one?.annotations,
    );
    if (!all.some(Boolean)) return false;
    /** @type {(picture: Page.Kept) => Page.Kept} */
    const bare = (picture) => (picture.picture ? { ...picture, annotations: null } : picture);
    this.store.do("annotations", { annotations: null });
    this.store.do("waiting", { annotations: null });
    this.store.do("history", { earlier: earlier.map(bare), later: later.map(bare) });
    await forgetFiles(all.flatMap((one) => one?.key ?? []));
    return true;
  }

  cancel() {
    this.#cancel?.abort();
  }

  /**
   * The open picture with everything that is needed to show it again.
   * @returns {Page.Kept}
   */
  get current() {
    const { picture, document, before, past, future, annotations } = this.store.state;
    const { session, file } = this.sync;
    if (!picture) return { picture: null };
    const kept = { file: this.fileKey, source: file, link: this.link, annotations };
    return {
      picture,
      document: before ?? document,
      past,
      future,
      session: known(session).id,
      borrowed: known(session).borrowed,
      ...kept,
    };
  }

  /**
   * Opens dropped, pasted or picked files: a picture, handles, annotations, or all of them; or a
   * project.
   * @param {ArrayLike<File> & Iterable<File>} list
   */
  async files(list) {
    if (!list.length) return;
    let found;
    try {
      found = await sorted(list, 2 * this.limits.body);
    } catch (problem) {
      return this.#refuse(problem);
    }
    const { project, picture, handles, annotations, unused } = found;
    if (project) await this.#project(project);
    else {
      try {
        if (handles.length) {
          const { picture: open } = this.store.state;
          const read = await this.#read(handles, picture ? null : open);
          await this.#take({ handles: read }, Boolean(picture));
        }
        if (annotations) {
          const read = await readAnnotations(annotations, this.limits.body);
          await this.#take({ annotations: read }, Boolean(picture));
        }
      } catch (problem) {
        if (!api.wasAborted(problem)) this.#refuse(problem);
        return;
      }
      if (picture) await this.file(picture, picture.name || "pasted.png");
      else if (!handles.length && !annotations)
        return this.#refuse(new api.Problem({ code: "not_a_picture" }, 0));
    }
    if (!this.store.state.problem) this.store.do("unused", { names: unused });
  }

  /**
   * Uses what a file has: now if a picture is open, otherwise (or if one comes with it) on the next
   * picture.
   * @param {Page.Waiting} content
   * @param {boolean} waits
   */
  async #take(content, waits) {
    if (this.store.state.phase === "open" && !waits) await this.#useWaiting(content);
    else this.store.do("waiting", content);
  }

  /**
   * Uses what was read for the picture that is open now.
   * @param {Page.Waiting} waiting
   */
  async #useWaiting({ handles, annotations }) {
    if (annotations) this.store.do("annotations", { annotations });
    if (handles) await this.#useHandles(handles);
    else if (annotations) this.toast(`${annotations.name} follows the warp`);
  }

  /**
   * Reads the handles of one file or two; later, if only the picture tells what the server asks.
   * @param {File[]} files
   * @param {Page.Picture | null} picture
   * @returns {Promise<Page.HandlesFile>}
   */
  async #read(files, picture) {
    /** @type {import("./landmarks.js").OfPicture | null} */
    const of = picture && {
      name: picture.name,
      size: () => [picture.width, picture.height],
    };
    try {
      return await (files.length > 1 ? readBoth(files, of) : readHandles(files[0], of));
    } catch (error) {
      if (!(error instanceof NeedsPicture)) throw error;
      const name = files.map((file) => file.name).join(" and ");
      return { name, document: emptyDocument(), warp: null, missing: 0, later: files };
    }
  }

  /** @param {Page.HandlesFile} file */
  async #useHandles(file) {
    const picture = known(this.store.state.picture);
    const read = file.later ? await this.#read(file.later, picture) : file;
    const { name, document, warp, missing, isLandmarks } = read;
    const placed = warp ? scaled(warp, picture) : document;
    const own = placed.align ? await aligned(placed, placed.align.by, picture) : placed;
    const { picture: now, document: before } = this.store.state;
    if (now !== picture) return;
    const mask = (own.region ?? []).find((part) => part.kind === "mask");
    const size = mask && sizeOfMask(mask);
    if (size && (size[0] !== picture.width || size[1] !== picture.height)) {
      const detail = `The region in ${name} has ${size.join(" × ")} px, and the picture ${picture.width} × ${picture.height} px: it is for another picture.`;
      return this.#refuse(new api.Problem({ code: "bad_handles_file", detail }, 0));
    }
    // Landmarks act where handles of this picture do.
    const { metric, threshold } = isLandmarks ? before : own;
    // A file without a region keeps the region of the picture.
    const fitted = mask
      ? own
      : {
          ...own,
          metric,
          threshold,
          region: before.region,
          feather: before.feather,
          holes: own.holes ?? before.holes,
        };
    this.actions.edit(fitted, { select: [] });
    const without = missing ? `; ${count(missing, "handle")} without a position left out` : "";
    this.toast(`${count(fitted.handles.length, "handle")} from ${name}${without}`);
    this.store.do("show", { what: { sidesClosed: false } });
  }

  /**
   * @param {File} file
   * @param {string} name
   */
  file(file, name) {
    return this.#attempt(name, async (signal) => {
      if (file.size > this.limits.body) {
        const detail = `The file ${name} has ${bytes(file.size)}; the maximum is ${bytes(this.limits.body)}.`;
        throw new api.Problem({ code: "too_large", detail }, 0);
      }
      await this.#fresh(await inMemory(file), name, emptyDocument(), null, signal);
    });
  }

  /** @param {File} file */
  #project(file) {
    return this.#attempt(file.name, async (signal) => {
      const { name, blob, document, strength, annotations, animation } = await readProject(
        file,
        2 * this.limits.body,
      );
      signal.throwIfAborted();
      await this.#fresh(blob, name, document, null, signal, async ({ width, height }) => {
        const mask = (document.region ?? []).find((part) => part.kind === "mask");
        const size = mask && sizeOfMask(mask);
        if (size && (size[0] !== width || size[1] !== height)) {
          const detail = `In ${file.name}, the mask of the region has ${size.join(" × ")} px, and the picture ${width} × ${height} px.`;
          throw new api.Problem({ code: "bad_project", detail }, 0);
        }
        const placed = document.align
          ? await aligned(document, document.align.by, { width, height })
          : document;
        return { document: atStrength(placed, strength), annotations };
      });
      this.store.do("animation", { change: animation });
    });
  }

  /** @param {keyof typeof SAMPLES} which */
  sample(which) {
    const { file, name, warp } = SAMPLES[which];
    return this.#attempt(name, async (signal) => {
      const response = await fetch(file, { signal }).catch(() => null);
      if (!response?.ok) throw api.Problem.network();
      await this.#fresh(await response.blob(), name, known(documentOf(warp)), file, signal);
    });
  }

  /**
   * `complete`: makes what is opened with the picture from its size: { document, annotations }.
   * @param {Blob} blob
   * @param {string} name
   * @param {Page.Document} document
   * @param {string | null} sample
   * @param {AbortSignal} signal
   * @param {(image: { width: number, height: number }) => Completed | Promise<Completed>}
   * [complete]
   */
  async #fresh(blob, name, document, sample, signal, complete = () => ({ document })) {
    const object = await this.#upload(blob, name, document, signal);
    const opened = await complete(object.image);
    const { waiting } = this.store.state;
    const left = await this.#use(
      object,
      opened.document,
      { blob, name },
      { picture: { name, sample }, annotations: opened.annotations },
      signal,
    );
    if (waiting) await this.#useWaiting(waiting);
    else if (left.document?.handles.length)
      this.toast(`${name} opened. Undo brings back ${left.picture.name}`);
  }

  /**
   * @param {Blob} blob
   * @param {string} name
   * @param {Page.Document} document
   * @param {AbortSignal} signal
   */
  #upload(blob, name, document, signal) {
    /** @type {(percent: number) => void} */
    const progress = (percent) => this.store.do("progress", { percent });
    const rest = restOf(document);
    return api.openSession(blob, name, rest, { progress, signal }).catch((error) => {
      // The picture is shown with its handles all the same, and what is wrong with them is said.
      const isOfHandles =
        error instanceof api.Problem &&
        (error.handle !== undefined || error.code === "empty_mask") &&
        rest.p.length;
      if (!isOfHandles) throw error;
      return api.openSession(blob, name, restOf(emptyDocument()), { progress, signal });
    });
  }

  /** Repeats the last attempt that failed. */
  retry() {
    return this.#tried?.();
  }

  /**
   * Opens something; after a failure the page is unchanged and shows the problem.
   * @param {string} name
   * @param {(signal: AbortSignal) => Promise<void>} open
   * @param {boolean} [bare]
   */
  async #attempt(name, open, bare = false) {
    this.cancel();
    this.#bare = bare;
    this.#tried = () => this.#attempt(name, open, this.#bare);
    const cancel = new AbortController();
    this.#cancel = cancel;
    this.store.do("uploading", { name });
    try {
      await open(cancel.signal);
      this.#tried = null;
    } catch (error) {
      if (cancel !== this.#cancel) return;
      this.store.do("uploadEnded");
      if (!api.wasAborted(error)) this.#refuse(error);
    }
  }

  /** @param {unknown} error */
  #refuse(error) {
    const isUnread = isUnreadable(error);
    const problem =
      error instanceof api.Problem
        ? error
        : new api.Problem({ code: isUnread ? "unreadable" : "internal" }, 0);
    problem.opening = true;
    this.store.do("problem", { problem });
    if (problem !== error && !isUnread) throw error;
  }

  /**
   * Shows a session and its document; returns the picture that was open. If `file` is null, the
   * texture comes from the session. `history` makes the history of pictures from the state and the
   * picture that was open.
   * @param {Page.SessionObject} object
   * @param {Page.Document} document
   * @param {Page.Source | null} file
   * @param {More} more
   * @param {AbortSignal} signal
   */
  async #use(
    object,
    document,
    file,
    {
      picture,
      past,
      future,
      annotations = null,
      borrowed = false,
      fileKey,
      link = null,
      history = replaced,
    },
    signal,
  ) {
    const { width, height } = object.image;
    const source = file ?? { blob: await this.#identity(object, signal), name: picture.name };
    let isCutout;
    try {
      isCutout = await this.view.setPicture(source.blob, width, height, signal);
    } catch (error) {
      if (!isUnreadable(error)) throw error;
      // The browser cannot decode the file, but the server can: show the server's PNG.
      isCutout = await this.view.setPicture(
        await this.#identity(object, signal),
        width,
        height,
        signal,
      );
    }
    // What an outline separates stays apart, unless another choice was made.
    const isUsual = document.metric === undefined && !document.handles.length;
    if (isCutout && isUsual) document = { ...document, metric: "geodesic" };
    const left = this.current;
    // A session of another user keeps its region. Otherwise the session without one is known, and
    // one with a mask is given it again.
    const region = borrowed || !object.layers?.region ? regionOf(borrowed ? document : {}) : null;
    this.sync.begin(
      object,
      sameRest(object, document) ? restOf(document) : null,
      source,
      region,
      borrowed,
    );
    this.store.do("opened", {
      picture: { ...picture, width, height, isCutout },
      document,
      annotations: this.#bare ? null : annotations,
      past,
      future,
      ...history(this.store.state, left),
    });
    this.view.resized(); // only now the stage is visible and has a size
    this.#leaveLink(link);
    this.fileKey = fileKey ?? null;
    const stored = fileKey ?? (await keepFile(source.blob, source.name, this.#needed));
    // Meanwhile another picture may have been opened, or this one closed.
    if (this.sync.file === source) this.fileKey = stored;
    this.told();
    return left;
  }

  /**
   * A link in the address would open again at the next reload.
   * @param {string | null} link
   */
  #leaveLink(link) {
    this.link = link;
    if (!link && readLink(location.hash))
      globalThis.history.replaceState(null, "", location.pathname + location.search);
  }

  /**
   * The unchanged picture of the session: q = p.
   * @param {Page.SessionObject} object
   * @param {AbortSignal} signal
   */
  async #identity(object, signal) {
    return (await api.picture(object.id, { q: object.p }, signal)).blob;
  }

  /**
   * Opens a link: its session, with its handles.
   * @param {string} hash
   */
  openLink(hash) {
    const { session, warp, name } = known(readLink(hash));
    return this.#attempt(name, async (signal) => {
      if (warp === null) throw new api.Problem({ code: "bad_link" }, 0);
      const object = await api.readSession(session).catch((error) => {
        const isLost = error instanceof api.Problem && LOST.has(error.code);
        throw isLost ? this.#deadLink(name, warp, error) : error;
      });
      signal.throwIfAborted();
      const told = documentOf(warp ?? warpOfSession(object));
      if (!told) throw new api.Problem({ code: "bad_link" }, 0);
      const document = told.align ? await aligned(told, told.align.by, object.image) : told;
      if (object.layers?.region)
        document.region = [await maskPart(await api.readRegion(session, signal))];
      await this.#use(
        object,
        document,
        null,
        { picture: { name, linked: true }, borrowed: true, link: hash },
        signal,
      );
    });
  }

  /**
   * A link whose session has ended still has the handles: they wait for the picture.
   * @param {string} name
   * @param {Page.Json} warp
   * @param {Page.Problem} problem
   */
  #deadLink(name, warp, { code, status }) {
    const document = warp && documentOf(warp);
    if (document?.handles.length)
      this.store.do("waiting", { handles: { name: "The link", document, warp: null, missing: 0 } });
    return new api.Problem(
      { code, detail: deadLinkWords(name, does.links ? this.limits.idle : null), link: true },
      status,
    );
  }

  /** Closes the picture; undo brings it back. */
  close() {
    const { state } = this.store;
    if (state.phase !== "open") return;
    this.#showStart(replaced(state, this.current));
    this.toast(`${known(state.picture).name} closed. Undo brings it back`);
  }

  /** @param {Page.History} history */
  #showStart(history) {
    this.sync.end();
    this.view.clear();
    this.store.do("opened", { picture: null, ...history });
    this.#leaveLink(null);
    this.fileKey = null;
    this.told();
  }

  /**
   * Undo (`back`) or redo of opening or closing a picture.
   * @param {boolean} back
   */
  async step(back) {
    const { state } = this.store;
    const next = back ? state.earlier.at(-1) : state.later[0];
    if (!next || state.phase === "uploading") return;
    /** @type {(now: Page.History, left: Page.Kept) => Page.History} */
    const history = (now, left) => stepped(now, left, back);
    if (!next.picture) return this.#showStart(history(state, this.current));
    await this.#again(next, history);
    if (!this.store.state.problem) this.toast(`${next.picture.name} is open again`);
  }

  /**
   * Restores the stored state after a reload.
   * @param {Page.Json} kept
   */
  async restore(kept) {
    const history = { earlier: kept.earlier ?? [], later: kept.later ?? [] };
    if (kept.picture) await this.#again(kept, () => history);
    else if (history.earlier.length) this.store.do("opened", { picture: null, ...history });
  }

  /**
   * Shows a kept picture: with its session if it exists, otherwise with a new session from the kept
   * file.
   * @param {Page.KeptPicture} kept
   * @param {(now: Page.History, left: Page.Kept) => Page.History} history
   */
  #again(kept, history) {
    return this.#attempt(kept.picture.name, async (signal) => {
      const file = kept.source ?? (await keptFile(kept.file));
      let object = await api.readSession(kept.session).catch((error) => {
        if (error instanceof api.Problem && LOST.has(error.code)) return null;
        throw error;
      });
      if (!object && !file) {
        this.store.do("history", without(this.store.state, kept));
        throw new api.Problem({ code: "session_expired" }, 410);
      }
      const borrowed = kept.borrowed && Boolean(object);
      object ??= await this.#upload(known(file).blob, known(file).name, kept.document, signal);
      const annotations = await keptAnnotations(kept.annotations);
      await this.#use(
        object,
        kept.document,
        file,
        { ...kept, annotations, borrowed, fileKey: file ? kept.file : null, history },
        signal,
      );
      if (kept.annotations && !annotations)
        this.toast(`${kept.annotations.name} is not stored any more: open it again`);
    });
  }
}

/**
 * The warp object of a link without handles: those of the session, at rest. An alpha equal to the
 * default counts as automatic.
 * @param {Page.SessionObject} object
 */
function warpOfSession(object) {
  const {
    p,
    weights,
    depth,
    method,
    alpha,
    point_mass,
    smoothing,
    metric,
    mask,
    coincident_policy: coincident,
    units,
    grid,
    folds,
    output,
  } = object;
  const warp = {
    ...ownIn(object),
    p,
    weights,
    depth,
    method,
    point_mass,
    smoothing,
    metric,
    mask,
    coincident,
    units,
    grid: grid.requested,
    folds,
    output,
  };
  const usual = documentOf(warp);
  return usual && (!hasFocus(usual) || alphaOf(usual) === alpha) ? warp : { ...warp, alpha };
}

// Opens a picture: a file (dropped, pasted, picked), a sample, a link, or a kept one (undo, reload). Closes it.

import * as api from "./api.js";
import { alphaOf, restOf, sameRest } from "./edits.js";
import { documentOf, isHandles, readHandles, scaled } from "./handlesfile.js";
import { keepFile, keptFile } from "./keep.js";
import { filesOf, replaced, stepped, without } from "./pictures.js";
import { maskPart, regionOf, sizeOfMask } from "./region.js";
import { SAMPLES } from "./samples.js";
import { readLink } from "./share.js";
import { emptyDocument } from "./state.js";
import { bytes, count } from "./words.js";

const LOST = new Set(["no_such_session", "session_expired"]);

export class Opener {
  /** Key of the file in IndexedDB, and the link that opened this tab. */
  fileKey = null;
  link = null;

  #cancel = null;
  #tried = null;

  /** `told` is called when a file has been stored; `toast` shows a message for a short time. */
  constructor(store, sync, view, actions, limits, told, toast) {
    Object.assign(this, { store, sync, view, actions, limits, told, toast });
  }

  cancel() {
    this.#cancel?.abort();
  }

  /** The open picture with everything that is needed to show it again. */
  get current() {
    const { picture, document, before, past, future } = this.store.state;
    const { session, file } = this.sync;
    if (!picture) return { picture: null };
    const kept = { file: this.fileKey, source: file, link: this.link };
    return { picture, document: before ?? document, past, future, session: session.id, borrowed: session.borrowed, ...kept };
  }

  /** Opens dropped, pasted or picked files: a picture, handles, or both. */
  async files(list) {
    const files = [...list];
    const isPicture = (f) => f.type.startsWith("image/") || /\.(png|jpe?g|webp|gif|bmp)$/i.test(f.name);
    const picture = files.find(isPicture);
    const handles = files.find(isHandles);
    if (handles && !(await this.#takeHandles(handles, Boolean(picture)))) return;
    if (picture) await this.file(picture, picture.name || "pasted.png");
    else if (files.length && !handles) this.#refuse(new api.Problem({ code: "not_a_picture" }, 0));
  }

  /** Uses handles of a file: now if a picture is open, otherwise (or if one comes with them) on the next picture. */
  async #takeHandles(file, waits) {
    let handles;
    try {
      handles = await readHandles(file);
    } catch (problem) {
      this.#refuse(problem);
      return false;
    }
    if (this.store.state.phase === "open" && !waits) this.#useHandles(handles);
    else this.store.do("waiting", { handles });
    return true;
  }

  #useHandles({ name, document, warp, missing }) {
    const { picture, document: before } = this.store.state;
    const own = warp ? scaled(warp, picture) : document;
    const [mask] = own.region ?? [];
    const size = mask && sizeOfMask(mask);
    if (mask && (size[0] !== picture.width || size[1] !== picture.height)) {
      const detail = `The region in ${name} has ${size.join(" × ")} px, and the picture ${picture.width} × ${picture.height} px: it is for another picture.`;
      return this.#refuse(new api.Problem({ code: "bad_handles_file", detail }, 0));
    }
    // A file without a region keeps the region of the picture.
    const fitted = mask ? own : { ...own, region: before.region, feather: before.feather };
    this.actions.edit(fitted, { select: [] });
    const without = missing ? `; ${count(missing, "handle")} without a position left out` : "";
    this.toast(`${count(fitted.handles.length, "handle")} from ${name}${without}`);
  }

  file(file, name) {
    return this.#attempt(name, async (signal) => {
      if (file.size > this.limits.body) {
        const detail = `The file ${name} has ${bytes(file.size)}; the maximum is ${bytes(this.limits.body)}.`;
        throw new api.Problem({ code: "too_large", detail }, 0);
      }
      await this.#fresh(await copyOf(file), name, emptyDocument(), null, signal);
    });
  }

  sample(which) {
    const { file, name, warp } = SAMPLES[which];
    return this.#attempt(name, async (signal) => {
      const response = await fetch(file, { signal }).catch(() => null);
      if (!response?.ok) throw api.Problem.network();
      await this.#fresh(await response.blob(), name, documentOf(warp), file, signal);
    });
  }

  async #fresh(blob, name, document, sample, signal) {
    const object = await this.#upload(blob, name, document, signal);
    const { waiting } = this.store.state;
    const left = await this.#use(object, document, { blob, name }, { picture: { name, sample } }, signal);
    if (waiting) this.#useHandles(waiting);
    else if (left.document?.handles.length) this.toast(`${name} opened. Undo brings back ${left.picture.name}`);
  }

  #upload(blob, name, document, signal) {
    const progress = (percent) => this.store.do("progress", { percent });
    return api.openSession(blob, name, restOf(document), { progress, signal });
  }

  /** Repeats the last attempt that failed. */
  retry() {
    return this.#tried?.();
  }

  /** Opens something; after a failure the page is unchanged and shows the problem. */
  async #attempt(name, open) {
    this.cancel();
    this.#tried = () => this.#attempt(name, open);
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

  #refuse(error) {
    const problem = error instanceof api.Problem ? error : new api.Problem({ code: error?.name === "EncodingError" ? "unreadable" : "internal" }, 0);
    problem.opening = true;
    this.store.do("problem", { problem });
    if (!(error instanceof api.Problem) && error?.name !== "EncodingError") throw error;
  }

  /**
   * Shows a session and its document; returns the picture that was open. If `file` is null, the texture comes from the session. `history`
   * makes the history of pictures from the state and the picture that was open.
   */
  async #use(object, document, file, { picture, past, future, borrowed = false, fileKey, link = null, history = replaced }, signal) {
    const { width, height } = object.image;
    const source = file ?? { blob: await this.#identity(object, signal), name: picture.name };
    try {
      await this.view.setPicture(source.blob, width, height, signal);
    } catch (error) {
      if (error?.name !== "EncodingError") throw error;
      // The browser cannot decode the file, but the server can: show the server's PNG.
      await this.view.setPicture(await this.#identity(object, signal), width, height, signal);
    }
    const left = this.current;
    // A session of another user keeps its region. Otherwise the session without one is known, and one with a mask is given it again.
    const region = borrowed || !object.layers?.region ? regionOf(borrowed ? document : {}) : null;
    this.sync.begin(object, sameRest(object, document) ? restOf(document) : null, source, region, borrowed);
    this.store.do("opened", { picture: { ...picture, width, height }, document, past, future, ...history(this.store.state, left) });
    this.view.resized(); // only now the stage is visible and has a size
    this.#leaveLink(link);
    this.fileKey = fileKey ?? null;
    const stored = fileKey ?? (await keepFile(source.blob, source.name, filesOf(this.store.state)));
    // Meanwhile another picture may have been opened, or this one closed.
    if (this.sync.file === source) this.fileKey = stored;
    this.told();
    return left;
  }

  /** A link in the address would open again at the next reload. */
  #leaveLink(link) {
    this.link = link;
    if (!link && readLink(location.hash)) globalThis.history.replaceState(null, "", location.pathname + location.search);
  }

  /** The unchanged picture of the session: q = p. */
  async #identity(object, signal) {
    return (await api.picture(object.id, { q: object.p }, signal)).blob;
  }

  /** Opens a link: its session, with its handles. */
  openLink(hash) {
    const { session, warp, name } = readLink(hash);
    return this.#attempt(name, async (signal) => {
      if (warp === null) throw new api.Problem({ code: "bad_link" }, 0);
      const object = await api.readSession(session);
      signal.throwIfAborted();
      const document = documentOf(warp ?? warpOfSession(object));
      if (!document) throw new api.Problem({ code: "bad_link" }, 0);
      if (object.layers?.region) document.region = [await maskPart(await api.readRegion(session, signal))];
      await this.#use(object, document, null, { picture: { name, linked: true }, borrowed: true, link: hash }, signal);
    });
  }

  /** Closes the picture; undo brings it back. */
  close() {
    const { state } = this.store;
    if (state.phase !== "open") return;
    this.#showStart(replaced(state, this.current));
    this.toast(`${state.picture.name} closed. Undo brings it back`);
  }

  #showStart(history) {
    this.sync.end();
    this.view.clear();
    this.store.do("opened", { picture: null, ...history });
    this.#leaveLink(null);
    this.fileKey = null;
    this.told();
  }

  /** Undo (`back`) or redo of opening or closing a picture. */
  async step(back) {
    const { state } = this.store;
    const next = back ? state.earlier.at(-1) : state.later[0];
    if (!next || state.phase === "uploading") return;
    const history = (now, left) => stepped(now, left, back);
    if (!next.picture) return this.#showStart(history(state, this.current));
    await this.#again(next, history);
    if (!this.store.state.problem) this.toast(`${next.picture.name} is open again`);
  }

  /** Restores the stored state after a reload. */
  async restore(kept) {
    const history = { earlier: kept.earlier ?? [], later: kept.later ?? [] };
    if (kept.picture) await this.#again(kept, () => history);
    else if (history.earlier.length) this.store.do("opened", { picture: null, ...history });
  }

  /** Shows a kept picture: with its session if it exists, otherwise with a new session from the kept file. */
  #again(kept, history) {
    return this.#attempt(kept.picture.name, async (signal) => {
      const file = kept.source ?? (await keptFile(kept.file));
      let object = await api.readSession(kept.session).catch((problem) => {
        if (LOST.has(problem.code)) return null;
        throw problem;
      });
      if (!object && !file) {
        this.store.do("history", without(this.store.state, kept));
        throw new api.Problem({ code: "session_expired" }, 410);
      }
      const borrowed = kept.borrowed && Boolean(object);
      object ??= await this.#upload(file.blob, file.name, kept.document, signal);
      await this.#use(object, kept.document, file, { ...kept, borrowed, fileKey: file ? kept.file : null, history }, signal);
    });
  }
}

/** Copies a file to memory: the file on disk may change or disappear before it is needed again. */
async function copyOf(file) {
  try {
    return new Blob([await file.arrayBuffer()], { type: file.type });
  } catch {
    throw new api.Problem({ code: "unreadable_file" }, 0);
  }
}

/** The warp object of a link without handles: those of the session, at rest. An alpha equal to the default counts as automatic. */
function warpOfSession({ p, weights, method, alpha, point_mass, smoothing, coincident_policy: coincident, units, grid, output }) {
  const warp = { p, weights, method, point_mass, smoothing, coincident, units, grid: grid.requested, output };
  const usual = documentOf(warp);
  return usual && alphaOf(usual) === alpha ? warp : { ...warp, alpha };
}

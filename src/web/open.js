// Opens a picture: a file (dropped, pasted, picked), a sample, a link, or the state before a reload.

import * as api from "./api.js";
import { alphaOf, documentOf, restOf, sameRest } from "./edits.js";
import { keepFile, keptFile } from "./keep.js";
import { SAMPLES } from "./samples.js";
import { emptyDocument } from "./state.js";
import { readLink } from "./share.js";
import { bytes } from "./words.js";

export class Opener {
  /** Key of the file in IndexedDB, and the link that opened this tab. */
  fileKey = null;
  link = null;

  #cancel = null;
  #tried = null;

  /** `told` is called when a file has been stored. */
  constructor(store, sync, view, actions, limits, told) {
    Object.assign(this, { store, sync, view, actions, limits, told });
  }

  cancel() {
    this.#cancel?.abort();
  }

  /** Opens dropped, pasted or picked files. */
  async files(list) {
    const files = [...list];
    const isPicture = (f) => f.type.startsWith("image/") || /\.(png|jpe?g|webp)$/i.test(f.name);
    const picture = files.find(isPicture);
    const handles = files.find((f) => f.type === "application/json" || /\.json$/i.test(f.name));
    if (picture) return this.file(picture, picture.name || "pasted.png");
    if (handles && this.store.state.phase === "open") return this.#takeHandles(handles);
    if (files.length) this.#refuse(new api.Problem({ code: "not_a_picture" }, 0));
  }

  async #takeHandles(file) {
    let warp = null;
    try {
      warp = documentOf(JSON.parse(await file.text()));
    } catch {
      // Reported below, like every other invalid warp object.
    }
    if (warp) this.actions.edit(warp, { select: [] });
    else this.#refuse(new api.Problem({ code: "bad_value", detail: `the file ${file.name} has no handles that this page supports` }, 0));
  }

  file(file, name) {
    return this.#attempt(name, async (signal) => {
      if (file.size > this.limits.body) {
        throw new api.Problem({ code: "too_large", detail: `the file ${name} has ${bytes(file.size)}; the maximum is ${bytes(this.limits.body)}` }, 413);
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
    await this.#use(object, document, { blob, name }, { picture: { name, sample } }, signal);
    this.link = null;
    this.told();
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

  /** Shows a session and its document. If `file` is null, the texture comes from the session. */
  async #use(object, document, file, { picture, past, future, borrowed = false, fileKey }, signal) {
    const { width, height } = object.image;
    const source = file ?? { blob: await this.#identity(object, signal), name: picture.name };
    try {
      await this.view.setPicture(source.blob, width, height, signal);
    } catch (error) {
      if (error?.name !== "EncodingError") throw error;
      // The browser cannot decode the file, but the server can: show the server's PNG.
      await this.view.setPicture(await this.#identity(object, signal), width, height, signal);
    }
    this.sync.begin(object, sameRest(object, document) ? restOf(document) : null, source, borrowed);
    this.store.do("opened", { picture: { ...picture, width, height }, document, past, future });
    this.view.resized(); // only now the stage is visible and has a size
    this.fileKey = fileKey ?? null;
    this.fileKey ??= await keepFile(source.blob, source.name);
    this.told();
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
      await this.#use(object, document, null, { picture: { name, linked: true }, borrowed: true }, signal);
      this.link = hash;
      this.told();
    });
  }

  /** Restores the stored state: with its session if it exists, otherwise with a new session from the stored file. */
  restore(kept) {
    return this.#attempt(kept.picture.name, async (signal) => {
      const file = await keptFile(kept.file);
      let object = await api.readSession(kept.session).catch((problem) => {
        if (problem.code === "no_such_session" || problem.code === "session_expired") return null;
        throw problem;
      });
      if (!object && !file) throw new api.Problem({ code: "session_expired" }, 410);
      const borrowed = kept.borrowed && Boolean(object);
      object ??= await this.#upload(file.blob, file.name, kept.document, signal);
      await this.#use(object, kept.document, file, { ...kept, borrowed, fileKey: file ? kept.file : null }, signal);
      this.link = kept.link;
      this.told();
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
function warpOfSession({ p, weights, method, alpha, point_mass, units, grid, output }) {
  const warp = { p, weights, method, point_mass, units, grid: grid.requested, output };
  const usual = documentOf(warp);
  return usual && alphaOf(usual) === alpha ? warp : { ...warp, alpha };
}

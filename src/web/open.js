// How a picture comes in: a file (dropped, pasted, picked), a sample, a link, or what was kept before a reload.

import * as api from "./api.js";
import { alphaOf, documentOf, restOf, sameRest } from "./edits.js";
import { keepFile, keptFile } from "./keep.js";
import { SAMPLES } from "./samples.js";
import { emptyDocument } from "./state.js";
import { readLink } from "./share.js";
import { bytes } from "./words.js";

export class Opener {
  /** Key of the file in IndexedDB, and the link that this tab came by. */
  fileKey = null;
  link = null;

  #cancel = null;
  #tried = null;

  /** `told`: a file has been kept. */
  constructor(store, sync, view, actions, limits, told) {
    Object.assign(this, { store, sync, view, actions, limits, told });
  }

  cancel() {
    this.#cancel?.abort();
  }

  /** Whatever was dropped, pasted or picked. */
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
      // Told below, as everything else that is no warp object.
    }
    if (warp) this.actions.edit(warp, { select: [] });
    else this.#refuse(new api.Problem({ code: "bad_value", detail: `${file.name} holds no handles that can be shown here` }, 0));
  }

  file(file, name) {
    return this.#attempt(name, async (signal) => {
      if (file.size > this.limits.body) {
        throw new api.Problem({ code: "too_large", detail: `${name} has ${bytes(file.size)}; at most ${bytes(this.limits.body)} are taken` }, 413);
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

  /** Once more what was refused. */
  retry() {
    return this.#tried?.();
  }

  /** Opens something; what fails leaves the page as it was, and is told. */
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

  /** A session and its document become what is seen. `file` null: the texture comes from the session. */
  async #use(object, document, file, { picture, past, future, borrowed = false, fileKey }, signal) {
    const { width, height } = object.image;
    const source = file ?? { blob: await this.#identity(object, signal), name: picture.name };
    try {
      await this.view.setPicture(source.blob, width, height, signal);
    } catch (error) {
      if (error?.name !== "EncodingError") throw error;
      // The server reads what this browser does not: then its own copy is shown.
      await this.view.setPicture(await this.#identity(object, signal), width, height, signal);
    }
    this.sync.begin(object, sameRest(object, document) ? restOf(document) : null, source, borrowed);
    this.store.do("opened", { picture: { ...picture, width, height }, document, past, future });
    this.view.resized(); // only now the stage is seen, and has a size
    this.fileKey = fileKey ?? null;
    this.fileKey ??= await keepFile(source.blob, source.name);
    this.told();
  }

  /** The session's picture as it came: q = p. */
  async #identity(object, signal) {
    return (await api.picture(object.id, { q: object.p }, signal)).blob;
  }

  /** A link: the session it names, with the handles it carries. */
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

  /** What was kept: with the session if it lives, else with the file as a new one. */
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

/** A file as it is now: the one on disk may change or go before it is needed again. */
async function copyOf(file) {
  try {
    return new Blob([await file.arrayBuffer()], { type: file.type });
  } catch {
    throw new api.Problem({ code: "unreadable_file" }, 0);
  }
}

/** What a link without handles means: the session's own, put back. An alpha that is the usual one was not asked for. */
function warpOfSession({ p, weights, method, alpha, units, grid, output }) {
  const warp = { p, weights, method, units, grid: grid.requested, output };
  const usual = documentOf(warp);
  return usual && alphaOf(usual) === alpha ? warp : { ...warp, alpha };
}

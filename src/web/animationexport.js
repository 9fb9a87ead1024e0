// The export as an animation: its rows in the export dialog, the request, which is streamed, and
// its progress.

import * as api from "./api.js";
import { find, known, listen } from "./dom.js";
import { EASINGS, MOST_FRAMES, TIME } from "./player.js";
import { wire } from "./edits.js";
import { posesOf } from "./strength.js";
import { ANIMATION, bytes } from "./words.js";

/**
 * Media type, and the bytes with which each frame begins in the file: a chunk `fcTL`, a graphic
 * control, or the header of a zip entry.
 * @type {Record<Page.Animation["file"], { media: string, mark: string }>}
 */
const FILES = {
  apng: { media: "image/apng", mark: "fcTL" },
  gif: { media: "image/gif", mark: "!\xf9\x04" },
  zip: { media: "application/zip", mark: "PK\x03\x04" },
};
export const FORMATS = Object.keys(FILES);
/** The shortest display of a frame that browsers observe, ms. */
const LEAST_DELAY = 20;
/** Frames of the file by which the size is estimated. */
const FEW = 3;

/**
 * The body of the request. `frames` counts those from rest to the pose; the way back repeats
 * neither of the two.
 * @param {Page.Document} document
 * @param {Page.Animation} settings
 * @param {Page.Output} output
 */
function batchOf(document, { frames, easing, back, file }, output) {
  const { at } = posesOf(document);
  const delay =
    file !== "zip" ? { delay: Math.max(LEAST_DELAY, Math.round(TIME / (frames - 1))) } : {};
  const more = { ...delay, ...(Object.keys(output).length && { output }) };
  const q = wire(at(1), "q");
  const isTwisted = document.handles.some((handle) => handle.twist);
  if (!isTwisted) return { q, steps: frames, easing, ...(back && { and_back: true }), ...more };
  const there = Array.from({ length: frames }, (_, k) => EASINGS[easing](k / (frames - 1)));
  // A twisted pin turns by a share of its angle; to the server it is a segment, whose ends would
  // move along straight lines.
  return {
    frames: there.map((t) => ({ q: wire(at(t), "q") })),
    ...(back && { and_back: true }),
    ...more,
  };
}

/**
 * Counts a mark in the parts of a stream.
 * @param {string} mark
 * @returns {(part: Uint8Array) => number}
 */
function counter(mark) {
  const codes = Array.from(mark, (character) => character.charCodeAt(0));
  let [count, matched] = [0, 0];
  return (part) => {
    for (const byte of part) {
      matched = byte === codes[matched] ? matched + 1 : byte === codes[0] ? 1 : 0;
      if (matched === codes.length) [count, matched] = [count + 1, 0];
    }
    return count;
  };
}

export class AnimationExport {
  /** @type {{ key: string, size: number } | null} */
  #measured = null; // { key, size } of a file with FEW frames

  /**
   * `changed`: called after a change of a row; `cancel`: stops the download.
   * @param {Page.Store} store
   * @param {Page.Sync} sync
   * @param {() => void} changed
   * @param {() => void} cancel
   */
  constructor(store, sync, changed, cancel) {
    this.store = store;
    this.sync = sync;
    /** @type {(change: Partial<Page.Animation>) => void} */
    const set = (change) => {
      store.do("animation", { change });
      changed();
    };
    listen("export-file", "change", ({ value }) =>
      set({ file: /** @type {Page.Animation["file"]} */ (value) }),
    );
    listen("export-easing", "change", ({ value }) =>
      set({ easing: /** @type {Page.Animation["easing"]} */ (value) }),
    );
    listen("export-back", "change", ({ checked }) => set({ back: checked }));
    listen("export-frames", "input", (input) =>
      input.checkValidity() ? set({ frames: input.valueAsNumber }) : changed(),
    );
    find("export-cancel").addEventListener("click", cancel);
  }

  get #settings() {
    return this.store.state.animation;
  }

  get file() {
    return this.#settings.file;
  }

  /** The number of frames of the file. */
  get count() {
    const { frames, back } = this.#settings;
    return back ? Math.max(2, 2 * frames - 2) : frames;
  }

  get most() {
    return this.#settings.back ? MOST_FRAMES / 2 + 1 : MOST_FRAMES;
  }

  /** @param {boolean} isChosen */
  draw(isChosen) {
    const { frames, easing, back, file } = this.#settings;
    find("export-animation-rows").hidden = !isChosen;
    find("export-file").value = file;
    find("export-easing").value = easing;
    find("export-back").checked = back;
    find("export-frames").max = String(this.most);
    if (document.activeElement !== find("export-frames"))
      find("export-frames").value = String(frames);
    find("export-frames").setAttribute(
      "aria-invalid",
      String(!find("export-frames").checkValidity()),
    );
    find("export-frames-note").textContent = ANIMATION.notes[file](back);
  }

  /**
   * The size of the file, bytes, by that of a small one.
   * @param {Page.Output} output
   * @param {AbortSignal} signal
   */
  async estimate(output, signal) {
    const { document, revision } = this.store.state;
    const { file } = this;
    const key = JSON.stringify([revision, file, output]);
    if (this.#measured?.key !== key) {
      const body = batchOf(document, { file, frames: FEW, easing: "linear", back: false }, output);
      const response = await this.sync.ask((id) => api.batch(id, body, this.media, signal));
      let size = 0;
      for await (const part of api.stream(response)) size += part.length;
      this.#measured = { key, size };
    }
    return (known(this.#measured).size / FEW) * this.count;
  }

  /** @param {Page.Output} output */
  body(output) {
    return batchOf(this.store.state.document, this.#settings, output);
  }

  get media() {
    return FILES[this.file].media;
  }

  /**
   * The file, streamed; the rows show its progress.
   * @param {Page.Output} output
   * @param {AbortSignal} signal
   */
  async fetch(output, signal) {
    const { media, mark } = FILES[this.file];
    this.#progress(0, this.count, 0);
    find("export-progress-row").hidden = false;
    if (document.activeElement === find("export-save")) find("export-cancel").focus();
    find("export-save").disabled = true;
    try {
      const response = await this.sync.ask((id) => api.batch(id, this.body(output), media, signal));
      const total = Number(response.headers.get("Warp-Frames")) || this.count;
      const begun = counter(mark);
      /** @type {Uint8Array<ArrayBuffer>[]} */
      const parts = [];
      let size = 0;
      for await (const part of api.stream(response)) {
        parts.push(part);
        size += part.length;
        this.#progress(Math.min(total, Math.max(0, begun(part) - 1)), total, size);
      }
      return new Blob(parts, { type: media });
    } finally {
      const hasFocus = document.activeElement === find("export-cancel");
      find("export-progress-row").hidden = true;
      find("export-save").disabled = false;
      if (hasFocus) find("export-save").focus();
    }
  }

  /**
   * @param {number} value
   * @param {number} max
   * @param {number} size
   */
  #progress(value, max, size) {
    Object.assign(find("export-progress"), { max, value });
    find("export-progress-text").textContent = `${value} of ${max} frames, ${bytes(size)}`;
  }
}

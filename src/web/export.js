// The export dialog: format, size, quality, compression and background of the file. The file is
// prepared while the dialog is open, so that its size is known; "Download" and "Copy curl" give
// these bytes. An animation is made when it is downloaded (animationexport.js).

import { AnimationExport } from "./animationexport.js";
import * as api from "./api.js";
import { find, known, listen, text } from "./dom.js";
import { kindOfOutside, outsideOf } from "./edits.js";
import { keepSetting, setting } from "./keep.js";
import {
  animationName,
  batchLine,
  warpedPicture,
  copy,
  curlLine,
  pictureName,
  save,
  saveRegion,
} from "./share.js";
import { ANIMATION, EXPORT, REGION, bytes, problemWords } from "./words.js";

/**
 * @typedef {{
 *   format: "png" | "jpeg" | "webp" | "animation",
 *   scale: number,
 *   quality: number,
 *   compression: keyof typeof EXPORT.compressions,
 *   background: string,
 * }} Settings
 */

/** Time without a change, ms, after which the file is prepared. */
const REST = 250;
/**
 * Largest side of a file by format, px; the limits of the server apply too.
 * @type {Record<Settings["format"], number>}
 */
const SIDES = { png: Infinity, jpeg: 65535, webp: 16383, animation: Infinity };
/** @type {Settings} */
const DEFAULTS = {
  format: "png",
  scale: 100,
  quality: 85,
  compression: "fast",
  background: "#ffffff",
};
const FORMATS = /** @type {const} */ (["png", "jpeg", "webp", "animation"]);

/**
 * The stored settings; invalid ones are replaced by the defaults.
 * @returns {Settings}
 */
function storedSettings() {
  /** @type {Page.Json} */
  let told = {};
  try {
    told = JSON.parse(setting("export") ?? "null") ?? {};
  } catch {
    // Damaged: the defaults apply.
  }
  /** @type {Record<keyof Settings, (value: Page.Json) => boolean>} */
  const valid = {
    format: (v) => v in SIDES,
    scale: (v) => v > 0 && v <= 10_000,
    quality: (v) => Number.isInteger(v) && v >= 1 && v <= 100,
    compression: (v) => ["none", "fast", "best"].includes(v),
    background: (v) => /^#[0-9a-f]{6}$/.test(v),
  };
  const names = /** @type {(keyof Settings)[]} */ (Object.keys(DEFAULTS));
  const kept = names.filter((name) => valid[name](told[name])).map((name) => [name, told[name]]);
  return { ...DEFAULTS, ...Object.fromEntries(kept) };
}

/**
 * The height that the server gives to a width: the proportions of the picture, rounded.
 * @type {(width: number, size: Page.Size) => number}
 */
const heightOf = (width, [w, h]) => Math.max(1, Math.floor((2 * h * width + w) / (2 * w)));

/**
 * The largest width within the limits; the width of the picture itself is always permitted by the
 * server's pixel limit.
 * @param {Page.Size} size
 * @param {Settings["format"]} format
 * @param {Page.Limits} limits
 */
function widestOf(size, format, { side, pixels }) {
  const longest = Math.min(side, SIDES[format]);
  let width =
    Math.floor(
      Math.min(longest, (longest * size[0]) / size[1], Math.sqrt((pixels * size[0]) / size[1])),
    ) + 1;
  while (
    width > 1 &&
    (Math.max(width, heightOf(width, size)) > longest || width * heightOf(width, size) > pixels)
  )
    width -= 1;
  return width;
}

export class ExportDialog {
  #settings = storedSettings();
  #width = 0;
  /** The width of the picture that `#width` was chosen for, px. */
  #chosenFor = 0;
  /** Whether the user typed the width, which stays when the size of the picture changes. */
  #isTyped = false;
  /** @type {{ key: string, blob: Blob } | null} */
  #prepared = null; // { key, blob }
  /** @type {AbortController | null} */
  #cancel = null;
  #timer = 0;

  /**
   * @param {Page.Store} store
   * @param {Page.Sync} sync
   * @param {Page.Limits} limits
   * @param {(words: string) => void} toast
   */
  constructor(store, sync, limits, toast) {
    this.store = store;
    this.sync = sync;
    this.limits = limits;
    this.toast = toast;
    this.dialog = find("export");
    const cancel = () => {
      this.#stop();
      text("export-result", EXPORT.cancelled);
    };
    this.animation = new AnimationExport(store, sync, () => this.#changed(), cancel);
    find("export-close").addEventListener("click", () => this.dialog.close());
    this.dialog.addEventListener(
      "click",
      (event) => event.target === this.dialog && this.dialog.close(),
    );
    // The event arrives late: the dialog may be open again.
    this.dialog.addEventListener("close", () => this.dialog.open || this.#stop());
    find("export-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.#attempt(() => this.#download());
    });
    find("export-curl").addEventListener(
      "click",
      () => find("export-form").reportValidity() && this.#attempt(() => this.#copy()),
    );
    for (const format of FORMATS) listen(`export-${format}`, "change", () => this.#set({ format }));
    listen("export-quality", "input", ({ value }) => this.#set({ quality: Number(value) }));
    listen("export-compression", "change", ({ value }) =>
      this.#set({ compression: /** @type {keyof typeof EXPORT.compressions} */ (value) }),
    );
    listen("export-background", "input", ({ value }) => this.#set({ background: value }));
    listen("export-width", "input", (input) => this.#resize(input.valueAsNumber, input));
    listen("export-scale", "input", (input) =>
      this.#resize(Math.round((input.valueAsNumber * this.#size[0]) / 100), input),
    );
  }

  /** @returns {Page.Size} */
  get #size() {
    const { picture, revision } = this.store.state;
    const { png } = this.sync;
    const { width, height } = known(picture);
    if (png?.revision !== revision || !png.canvas) return [width, height];
    return [png.canvas[2], png.canvas[3]];
  }

  show() {
    if (this.store.state.phase !== "open" || this.dialog.open) return;
    this.#isTyped = false;
    this.#fit();
    this.#prepared = null;
    this.dialog.showModal();
    this.#changed();
  }

  /** The width by the scale, or the scale of the width that was typed. */
  #fit() {
    const [width] = this.#size;
    this.#chosenFor = width;
    if (this.#isTyped) {
      this.#settings = { ...this.#settings, scale: (100 * this.#width) / width };
      return;
    }
    const widest = widestOf(this.#size, this.#settings.format, this.limits);
    this.#width = Math.min(widest, Math.max(1, Math.round((this.#settings.scale * width) / 100)));
  }

  /**
   * Resolves when the picture of the newest pose is here, which may have another size than the one
   * that was shown when the dialog opened.
   */
  async #settled() {
    await this.sync.settled();
    if (this.#size[0] === this.#chosenFor) return;
    this.#fit();
    this.#draw(null);
  }

  /** Stops what is under way. */
  async #begin() {
    this.#stop();
    const cancel = new AbortController();
    this.#cancel = cancel;
    await this.#settled();
    cancel.signal.throwIfAborted();
    return cancel.signal;
  }

  /** @param {Partial<Settings>} change */
  #set(change) {
    this.#settings = { ...this.#settings, ...change };
    keepSetting("export", JSON.stringify(this.#settings));
    this.#changed();
  }

  /**
   * `typed`: the field that the user is typing in; it is not overwritten.
   * @param {number} width
   * @param {HTMLElement} typed
   */
  #resize(width, typed) {
    this.#width = width;
    this.#isTyped = typed === find("export-width");
    if (width >= 1) this.#settings = { ...this.#settings, scale: (100 * width) / this.#size[0] };
    keepSetting("export", JSON.stringify(this.#settings));
    this.#changed(typed);
  }

  /**
   * The fields of `output` that differ from those of "Download PNG".
   * @returns {Page.Output}
   */
  get #output() {
    const { format, quality, compression, background } = this.#settings;
    return {
      ...((format === "jpeg" || format === "webp") && { format }),
      ...(format === "jpeg" && { quality }),
      ...(format === "png" && compression !== "fast" && { compression }),
      ...(this.#width !== this.#size[0] && { width: this.#width }),
      ...(this.#hasBackground && background !== "#ffffff" && { outside: `${background}ff` }),
    };
  }

  /**
   * A JPEG has no transparency: its background is the colour outside, or white. It can be chosen
   * unless the panel sets another outside.
   */
  get #hasBackground() {
    return (
      this.#settings.format === "jpeg" && outsideOf(this.store.state.document) === "transparent"
    );
  }

  /** @param {HTMLElement | null} [typed] */
  #changed(typed = null) {
    this.#stop();
    this.#draw(typed);
    if (
      !find("export-width").checkValidity() ||
      (this.#isAnimation && !find("export-frames").checkValidity())
    )
      return;
    this.#timer = setTimeout(
      () => this.#attempt(() => (this.#isAnimation ? this.#estimate() : this.#prepare())),
      REST,
    );
  }

  get #isAnimation() {
    return this.#settings.format === "animation";
  }

  #stop() {
    clearTimeout(this.#timer);
    this.#cancel?.abort();
    this.#cancel = null;
  }

  /** @param {HTMLElement | null} typed */
  #draw(typed) {
    const { format, quality, compression, background, scale } = this.#settings;
    const [width, height] = this.#size;
    const widest = widestOf(this.#size, format, this.limits);
    find(`export-${format}`).checked = true;
    text("export-format-note", EXPORT.formats[format]);
    find("export-width").max = String(widest);
    if (typed !== find("export-width")) find("export-width").value = String(this.#width);
    if (typed !== find("export-scale"))
      find("export-scale").value = String(Math.round(10 * scale) / 10);
    const valid = find("export-width").checkValidity();
    find("export-width").setAttribute("aria-invalid", String(!valid));
    text("export-height", valid ? `× ${heightOf(this.#width, this.#size)} px` : "px");
    text(
      "export-size-note",
      `The picture has ${width} × ${height} px. The width can be 1 to ${widest} px.`,
    );
    find("export-quality-row").hidden = format !== "jpeg";
    find("export-quality").value = String(quality);
    text("export-quality-value", String(quality));
    find("export-compression-row").hidden = format !== "png";
    find("export-compression").value = compression;
    text("export-compression-note", EXPORT.compressions[compression]);
    find("export-background-row").hidden = format !== "jpeg";
    find("export-background").hidden = !this.#hasBackground;
    find("export-background").value = background;
    const outside = outsideOf(this.store.state.document);
    text("export-background-note", EXPORT.backgrounds[kindOfOutside(outside)]);
    text("export-save", `Download ${EXPORT.names[format]}`);
    this.animation.draw(this.#isAnimation);
    const hasFrames = !this.#isAnimation || find("export-frames").checkValidity();
    find("export-problem").hidden = valid && hasFrames;
    if (!hasFrames) text("export-problem", `Enter 2 to ${this.animation.most} frames.`);
    if (!valid) text("export-problem", `Enter a width of 1 to ${widest} px.`);
    text(
      "export-result",
      !valid || !hasFrames ? "" : this.#isAnimation ? this.#frames : "Preparing the file",
    );
    text("export-said", "");
  }

  /** The file, from the server unless it is prepared already. */
  async #prepare() {
    const signal = await this.#begin();
    const output = this.#output;
    const key = JSON.stringify(output);
    if (this.#prepared?.key !== key) {
      const blob = await warpedPicture(this.sync, this.store, output, signal);
      signal.throwIfAborted();
      this.#prepared = { key, blob };
    }
    text(
      "export-result",
      `${this.#width} × ${heightOf(this.#width, this.#size)} px, ${bytes(this.#prepared.blob.size)}`,
    );
    return this.#prepared.blob;
  }

  get #frames() {
    return `${this.animation.count} frames, ${this.#width} × ${heightOf(this.#width, this.#size)} px`;
  }

  async #estimate() {
    const signal = await this.#begin();
    const size = await this.animation.estimate(this.#output, signal);
    if (!signal.aborted) text("export-result", `${this.#frames}, about ${bytes(size)}`);
  }

  /** The animation, unless it is cancelled. */
  async #animate() {
    const signal = await this.#begin();
    find("export-problem").hidden = true;
    text("export-result", "");
    return this.animation.fetch(this.#output, signal);
  }

  get #name() {
    const { name } = known(this.store.state.picture);
    return this.#isAnimation
      ? animationName(name, this.animation.file)
      : pictureName(name, this.#settings.format);
  }

  async #download() {
    const name = this.#name;
    save(await (this.#isAnimation ? this.#animate() : this.#prepare()), name);
    this.dialog.close();
    this.toast(`${name} downloaded`);
  }

  async #copy() {
    await this.#settled();
    const line = this.#isAnimation
      ? batchLine(this.sync, this.#name, this.animation.media, this.animation.body(this.#output))
      : curlLine(this.sync, this.store.state, this.#output);
    const copied = await copy(line, find("export-copied"));
    const mask = this.#isAnimation ? null : await saveRegion(this.store.state);
    const more = this.#isAnimation
      ? ANIMATION.session(this.limits.idle)
      : mask
        ? REGION.needs(mask)
        : "";
    text(
      "export-said",
      `${copied ? "Command copied" : "Press Ctrl+C to copy the command"}${more && `. ${more}`}`,
    );
  }

  /**
   * Shows a problem in the dialog: the page behind it cannot be reached.
   * @param {() => unknown} act
   */
  async #attempt(act) {
    try {
      await act();
    } catch (error) {
      if (api.wasAborted(error)) return;
      const problem = api.asProblem(error);
      // Nothing that the dialog requests is repeated automatically.
      const { title, detail, advice } = problemWords(
        Object.assign(Object.create(problem), { opening: true }),
      );
      find("export-problem").hidden = false;
      text("export-problem", [`${title}.`, detail, advice].filter(Boolean).join(" "));
      text("export-result", "");
    }
  }
}

// The export dialog: format, size, quality, compression and background of the file. The file is
// prepared while the dialog is open, so that its size is known; "Download" and "Copy curl" give
// these bytes. An animation is made when it is downloaded (animationexport.js).

import { AnimationExport } from "./animationexport.js";
import * as api from "./api.js";
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

const find = (id) => document.getElementById(`export-${id}`);
const text = (id, words) => (find(id).textContent = words);

/** Time without a change, ms, after which the file is prepared. */
const REST = 250;
/** Largest side of a file by format, px; the limits of the server apply too. */
const SIDES = { png: Infinity, jpeg: 65535, webp: 16383, animation: Infinity };
const DEFAULTS = {
  format: "png",
  scale: 100,
  quality: 85,
  compression: "fast",
  background: "#ffffff",
};

/** The stored settings; invalid ones are replaced by the defaults. */
function storedSettings() {
  let told = {};
  try {
    told = JSON.parse(setting("export")) ?? {};
  } catch {
    // Damaged: the defaults apply.
  }
  const valid = {
    format: (v) => v in SIDES,
    scale: (v) => v > 0 && v <= 10_000,
    quality: (v) => Number.isInteger(v) && v >= 1 && v <= 100,
    compression: (v) => ["none", "fast", "best"].includes(v),
    background: (v) => /^#[0-9a-f]{6}$/.test(v),
  };
  return Object.fromEntries(
    Object.entries(DEFAULTS).map(([name, usual]) => [
      name,
      valid[name](told[name]) ? told[name] : usual,
    ]),
  );
}

/** The height that the server gives to a width: the proportions of the picture, rounded. */
const heightOf = (width, [w, h]) => Math.max(1, Math.floor((2 * h * width + w) / (2 * w)));

/**
 * The largest width within the limits; the width of the picture itself is always permitted by the
 * server's pixel limit.
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
  #prepared = null; // { key, blob }
  #cancel = null;
  #timer = 0;

  constructor(store, sync, limits, toast) {
    Object.assign(this, { store, sync, limits, toast, dialog: document.getElementById("export") });
    const cancel = () => {
      this.#stop();
      text("result", EXPORT.cancelled);
    };
    this.animation = new AnimationExport(store, sync, () => this.#changed(), cancel);
    find("close").addEventListener("click", () => this.dialog.close());
    this.dialog.addEventListener(
      "click",
      (event) => event.target === this.dialog && this.dialog.close(),
    );
    // The event arrives late: the dialog may be open again.
    this.dialog.addEventListener("close", () => this.dialog.open || this.#stop());
    find("form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.#attempt(() => this.#download());
    });
    find("curl").addEventListener(
      "click",
      () => find("form").reportValidity() && this.#attempt(() => this.#copy()),
    );
    for (const format of Object.keys(SIDES))
      find(format).addEventListener("change", () => this.#set({ format }));
    find("quality").addEventListener("input", ({ target }) =>
      this.#set({ quality: Number(target.value) }),
    );
    find("compression").addEventListener("change", ({ target }) =>
      this.#set({ compression: target.value }),
    );
    find("background").addEventListener("input", ({ target }) =>
      this.#set({ background: target.value }),
    );
    find("width").addEventListener("input", ({ target }) =>
      this.#resize(target.valueAsNumber, target),
    );
    find("scale").addEventListener("input", ({ target }) =>
      this.#resize(Math.round((target.valueAsNumber * this.#size[0]) / 100), target),
    );
  }

  get #size() {
    const {
      picture: { width, height },
      revision,
    } = this.store.state;
    const { png } = this.sync;
    return png?.revision === revision && png.canvas ? png.canvas.slice(2) : [width, height];
  }

  show() {
    if (this.store.state.phase !== "open" || this.dialog.open) return;
    const widest = widestOf(this.#size, this.#settings.format, this.limits);
    this.#width = Math.min(
      widest,
      Math.max(1, Math.round((this.#settings.scale * this.#size[0]) / 100)),
    );
    this.#prepared = null;
    this.dialog.showModal();
    this.#changed();
  }

  #set(change) {
    this.#settings = { ...this.#settings, ...change };
    keepSetting("export", JSON.stringify(this.#settings));
    this.#changed();
  }

  /** `typed`: the field that the user is typing in; it is not overwritten. */
  #resize(width, typed) {
    this.#width = width;
    if (width >= 1) this.#settings = { ...this.#settings, scale: (100 * width) / this.#size[0] };
    keepSetting("export", JSON.stringify(this.#settings));
    this.#changed(typed);
  }

  /** The fields of `output` that differ from those of "Download PNG". */
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

  #changed(typed = null) {
    this.#stop();
    this.#draw(typed);
    if (!find("width").checkValidity() || (this.#isAnimation && !find("frames").checkValidity()))
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

  #draw(typed) {
    const { format, quality, compression, background, scale } = this.#settings;
    const [width, height] = this.#size;
    const widest = widestOf(this.#size, format, this.limits);
    find(format).checked = true;
    text("format-note", EXPORT.formats[format]);
    find("width").max = widest;
    if (typed !== find("width")) find("width").value = this.#width;
    if (typed !== find("scale")) find("scale").value = Math.round(10 * scale) / 10;
    const valid = find("width").checkValidity();
    find("width").setAttribute("aria-invalid", !valid);
    text("height", valid ? `× ${heightOf(this.#width, this.#size)} px` : "px");
    text(
      "size-note",
      `The picture has ${width} × ${height} px. The width can be 1 to ${widest} px.`,
    );
    find("quality-row").hidden = format !== "jpeg";
    find("quality").value = quality;
    text("quality-value", quality);
    find("compression-row").hidden = format !== "png";
    find("compression").value = compression;
    text("compression-note", EXPORT.compressions[compression]);
    find("background-row").hidden = format !== "jpeg";
    find("background").hidden = !this.#hasBackground;
    find("background").value = background;
    const outside = outsideOf(this.store.state.document);
    text("background-note", EXPORT.backgrounds[kindOfOutside(outside)]);
    text("save", `Download ${EXPORT.names[format]}`);
    this.animation.draw(this.#isAnimation);
    const hasFrames = !this.#isAnimation || find("frames").checkValidity();
    find("problem").hidden = valid && hasFrames;
    if (!hasFrames) text("problem", `Enter 2 to ${this.animation.most} frames.`);
    if (!valid) text("problem", `Enter a width of 1 to ${widest} px.`);
    text(
      "result",
      !valid || !hasFrames ? "" : this.#isAnimation ? this.#frames : "Preparing the file",
    );
    text("said", "");
  }

  /** The file, from the server unless it is prepared already. */
  async #prepare() {
    const output = this.#output;
    const key = JSON.stringify(output);
    if (this.#prepared?.key !== key) {
      this.#stop();
      const cancel = new AbortController();
      this.#cancel = cancel;
      const blob = await warpedPicture(this.sync, this.store, output, cancel.signal);
      cancel.signal.throwIfAborted();
      this.#prepared = { key, blob };
    }
    text(
      "result",
      `${this.#width} × ${heightOf(this.#width, this.#size)} px, ${bytes(this.#prepared.blob.size)}`,
    );
    return this.#prepared.blob;
  }

  get #frames() {
    return `${this.animation.count} frames, ${this.#width} × ${heightOf(this.#width, this.#size)} px`;
  }

  async #estimate() {
    this.#stop();
    const cancel = new AbortController();
    this.#cancel = cancel;
    const size = await this.animation.estimate(this.#output, cancel.signal);
    if (!cancel.signal.aborted) text("result", `${this.#frames}, about ${bytes(size)}`);
  }

  /** The animation, unless it is cancelled. */
  async #animate() {
    this.#stop();
    const cancel = new AbortController();
    this.#cancel = cancel;
    find("problem").hidden = true;
    text("result", "");
    return this.animation.fetch(this.#output, cancel.signal);
  }

  get #name() {
    const { name } = this.store.state.picture;
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
    await this.sync.settled();
    const line = this.#isAnimation
      ? batchLine(this.sync, this.#name, this.animation.media, this.animation.body(this.#output))
      : curlLine(this.sync, this.store.state, this.#output);
    const copied = await copy(line, find("copied"));
    const mask = this.#isAnimation ? null : await saveRegion(this.store.state);
    const more = this.#isAnimation
      ? ANIMATION.session(this.limits.idle)
      : mask
        ? REGION.needs(mask)
        : "";
    text(
      "said",
      `${copied ? "Command copied" : "Press Ctrl+C to copy the command"}${more && `. ${more}`}`,
    );
  }

  /** Shows a problem in the dialog: the page behind it cannot be reached. */
  async #attempt(act) {
    try {
      await act();
    } catch (error) {
      if (api.wasAborted(error)) return;
      if (!(error instanceof api.Problem)) throw error;
      // Nothing that the dialog requests is repeated automatically.
      const { title, detail, advice } = problemWords(
        Object.assign(Object.create(error), { opening: true }),
      );
      find("problem").hidden = false;
      text("problem", [`${title}.`, detail, advice].filter(Boolean).join(" "));
      text("result", "");
    }
  }
}

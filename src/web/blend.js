// The dialog "Average or morph": pictures with their landmark files, each uploaded once as a
// session; a slider for the shape, one for the colours; the blended picture, and its export.

import * as api from "./api.js";
import { find, known, listen, text } from "./dom.js";
import { restOf } from "./edits.js";
import { inMemory, paired } from "./files.js";
import { chooseItem, indexOfItem, landmarksOf } from "./landmarks.js";
import { METHODS } from "./methods.js";
import { blendLine, copy, save, stem } from "./share.js";
import { emptyDocument } from "./state.js";
import { BLEND, bytes, problemWords } from "./words.js";

/** Width of the picture in the dialog, px. */
const PREVIEW = 640;
/** Most pictures, as the server has it. */
const MOST = 200;
const MOST_FRAMES = 1000;
/**
 * Landmarks are close together, and pictures differ in size: what is smooth then, and scales; and
 * the focus of methods that have one.
 */
const METHOD = "affine";
const ALPHA = 2;
/**
 * The files that can be saved: their media types, and what of them is no picture.
 * @type {Record<string, { media: string, end: string, format?: "jpeg", frames?: boolean }>}
 */
const FILES = {
  png: { media: "image/png", end: "png" },
  jpeg: { media: "image/jpeg", end: "jpg", format: "jpeg" },
  apng: { media: "image/apng", end: "png", frames: true },
  gif: { media: "image/gif", end: "gif", frames: true },
  zip: { media: "application/zip", end: "zip", frames: true },
};

/**
 * A picture. `p` in px, once it is uploaded; `chosen`: which item of the landmark file, if it has
 * several; `wrong`: why it is not used.
 *
 * @typedef {{
 *   file: File,
 *   landmarks: File | null,
 *   session: string | null,
 *   size: Page.Size,
 *   p: Page.WireHandle[],
 *   names: string[] | null,
 *   chosen?: import("./landmarks.js").Item,
 *   wrong: string,
 *   address: string,
 * }} Item
 */

/** What is wrong with a picture or its landmarks. */
const FAULTS = new Set([
  "bad_image",
  "bad_landmarks",
  "bad_value",
  "not_finite",
  "too_large",
  "unreadable_file",
  "unsupported_format",
]);

/** @type {(item: Item) => boolean} */
const isUsed = (item) => item.session !== null && !item.wrong;

/**
 * The shares of the pictures: 0 is the first one, 1 the mean of the others.
 * @type {(share: number, count: number) => number[]}
 */
const shares = (share, count) =>
  count === 1 ? [1] : [1 - share, ...Array.from({ length: count - 1 }, () => share / (count - 1))];

export class BlendDialog {
  /** @type {Item[]} */
  #items = [];
  /** Shares of the shape and of the colours. */
  #shape = 0.5;
  #colour = 0.5;
  /** Whether the sliders were moved: until then they show the average. */
  #isMoved = false;
  #isUploading = false;
  #isDrawing = false;
  /** What the shown picture was made of, as JSON. */
  #shown = "";
  /**
   * The names of the files that were added last and are not used.
   * @type {string[]}
   */
  #unused = [];
  /** The pictures as they are listed, as JSON. */
  #listed = "";

  /**
   * @param {Page.Limits} limits
   * @param {() => void} told called when the observable state changes
   */
  constructor(limits, told) {
    this.limits = limits;
    this.told = told;
    this.dialog = find("blend");
    find("blend-open").addEventListener("click", () => this.show());
    find("blend-close").addEventListener("click", () => this.dialog.close());
    this.dialog.addEventListener(
      "click",
      (event) => event.target === this.dialog && this.dialog.close(),
    );
    this.dialog.addEventListener("close", () => told());
    find("blend-pick").addEventListener("click", () => find("blend-files").click());
    listen("blend-files", "change", (input) => {
      this.add([...(input.files ?? [])]);
      input.value = "";
    });
    listen("blend-shape", "input", ({ value }) => this.#slide({ shape: Number(value) / 100 }));
    listen("blend-colour", "input", ({ value }) => this.#slide({ colour: Number(value) / 100 }));
    // A mesh is of one picture.
    const methods = METHODS.filter(({ mesh }) => !mesh);
    find("blend-method").append(...methods.map(({ name, title }) => new Option(title, name)));
    find("blend-method").value = METHOD;
    listen("blend-together", "change", () => this.#slide({ shape: this.#shape }));
    find("blend-average").addEventListener("click", () => {
      this.#isMoved = false;
      this.#changed();
    });
    for (const id of /** @type {const} */ ([
      "blend-mirror",
      "blend-linear",
      "blend-file",
      "blend-method",
    ]))
      find(id).addEventListener("change", () => this.#changed());
    find("blend-frames").addEventListener("input", () => this.#changed());
    find("blend-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.#attempt(() => this.#download());
    });
    find("blend-curl").addEventListener(
      "click",
      () => find("blend-form").reportValidity() && this.#attempt(() => this.#copy()),
    );
    find("blend-again").addEventListener("click", () => {
      this.#shown = "";
      this.#changed();
      this.#upload();
    });
  }

  /** What the page says of itself: README.md. */
  get condition() {
    if (!this.dialog.open) return "closed";
    if (!find("blend-problem").hidden) return "error";
    if (this.#isUploading) return "uploading";
    if (this.#isDrawing) return "busy";
    return this.#canBlend && this.#shown ? "ready" : "empty";
  }

  show() {
    if (this.dialog.open) return;
    this.dialog.showModal();
    this.#changed();
  }

  /**
   * Whether files that were brought to the page are for this dialog: it is open, or they are two or
   * more pictures with a landmark file for each.
   * @param {Iterable<File>} files
   */
  takes(files) {
    if (this.dialog.open) return true;
    const { pictures, landmarks } = paired(files);
    const stems = new Set(landmarks.map(({ name }) => stem(name)));
    return pictures.length > 1 && pictures.every(({ name }) => stems.has(stem(name)));
  }

  /**
   * Adds pictures and landmark files; a landmark file belongs to the picture of its name, otherwise
   * to the first one without.
   * @param {Iterable<File>} files
   */
  add(files) {
    this.show();
    const { pictures, landmarks, others } = paired(files);
    for (const file of pictures)
      this.#items.push({
        file,
        landmarks: null,
        session: null,
        size: [0, 0],
        p: [],
        names: null,
        wrong: "",
        address: URL.createObjectURL(file),
      });
    const left = landmarks.filter((file) => {
      const own = this.#items.find(({ file: picture }) => stem(picture.name) === stem(file.name));
      if (own) this.#give(own, file);
      return !own;
    });
    for (const file of left) {
      const next = this.#items.find((item) => !item.landmarks);
      if (next) this.#give(next, file);
      else others.push(file);
    }
    this.#items.splice(MOST).forEach(({ file }) => others.push(file));
    this.#unused = others.map(({ name }) => name);
    this.#changed();
    this.#upload();
  }

  /**
   * @param {Item} item
   * @param {File} landmarks
   */
  #give(item, landmarks) {
    this.#forget(item);
    Object.assign(item, { landmarks, wrong: "" });
  }

  /** @param {Item} item */
  #forget(item) {
    if (item.session) api.deleteSession(item.session);
    item.session = null;
  }

  /** @param {number} index */
  #remove(index) {
    const [item] = this.#items.splice(index, 1);
    this.#forget(item);
    URL.revokeObjectURL(item.address);
    this.#changed();
    const buttons = find("blend-list").querySelectorAll("button");
    (buttons[Math.min(index, buttons.length - 1)] ?? find("blend-pick")).focus();
  }

  /** @param {{ shape?: number, colour?: number }} moved */
  #slide(moved) {
    const { shape = this.#shape, colour = this.#colour } = moved;
    const both = find("blend-together").checked ? (moved.shape ?? moved.colour) : undefined;
    [this.#shape, this.#colour] = [both ?? shape, both ?? colour];
    this.#isMoved = true;
    this.#changed();
  }

  get #used() {
    return this.#items.filter(isUsed);
  }

  get #canBlend() {
    return this.#used.length > (find("blend-mirror").checked ? 0 : 1);
  }

  get #file() {
    return FILES[find("blend-file").value];
  }

  /**
   * Whether a method takes the landmarks of the pictures.
   * @param {Page.MethodInfo} method
   */
  #takes({ handles }) {
    const isLine = this.#used.flatMap(({ p }) => p).map((handle) => Array.isArray(handle?.[0]));
    return handles === "all" || isLine.every((line) => line === (handles === "lines"));
  }

  get #method() {
    return known(METHODS.find(({ name }) => name === find("blend-method").value));
  }

  /** Uploads what is not uploaded yet, one after the other. */
  async #upload() {
    if (this.#isUploading) return;
    this.#isUploading = true;
    const next = () => this.#items.find((one) => one.landmarks && !one.session && !one.wrong);
    for (let item = next(); item; item = next()) {
      this.#draw();
      try {
        await this.#open(item, known(item.landmarks));
      } catch (error) {
        if (api.wasAborted(error)) {
          item.landmarks = null;
          continue;
        }
        const problem = api.asProblem(error);
        // Neither the picture nor its landmarks are at fault.
        if (!FAULTS.has(problem.code)) {
          this.#isUploading = false;
          this.#draw();
          return this.#tell(problem);
        }
        const { title, detail } = problemWords(Object.assign(problem, { opening: true }));
        item.wrong = detail || `${title}.`;
      }
    }
    this.#isUploading = false;
    this.#changed();
  }

  /**
   * @param {Item} item
   * @param {File} landmarks
   */
  async #open(item, landmarks) {
    if ([item.file, landmarks].some(({ size }) => size > this.limits.body))
      throw new api.Problem({ code: "too_large", detail: BLEND.large(this.limits.body) }, 0);
    const [picture, rows] = await Promise.all([item.file, landmarks].map(inMemory));
    /** @type {Page.SessionObject[]} */
    const sized = []; // one without handles, where a file needs the size of its picture
    /** @type {import("./landmarks.js").Item | undefined} */
    let chosen;
    const { p, q, names, units } = await landmarksOf(
      rows,
      {
        name: picture.name,
        size: async () => {
          const rest = restOf(emptyDocument());
          sized.push(await api.openSession(picture, picture.name, rest, {}));
          return [sized[0].image.width, sized[0].image.height];
        },
      },
      async (...asked) => (chosen = await this.#choose(landmarks, ...asked)),
    );
    if (q) throw new api.Problem({ code: "bad_landmarks", detail: BLEND.bothSides }, 0);
    const rest = /** @type {Page.Json} */ ({ p, units });
    const { id, image } = sized.length
      ? await api.putHandles(sized[0].id, rest)
      : await api.openSession(picture, picture.name, rest, {});
    const scale = units === "normalized" ? [image.width, image.height] : [1, 1];
    /** @type {(place: Page.Place) => Page.Place} */
    const px = ([x, y]) => [x * scale[0], y * scale[1]];
    // It may have been removed, or given other landmarks, meanwhile.
    if (item.landmarks !== landmarks || !this.#items.includes(item)) return api.deleteSession(id);
    item.size = [image.width, image.height];
    // A handle without a position is null.
    item.p = p.map((/** @type {Page.Json} */ handle) =>
      typeof handle?.[0] === "number" ? px(handle) : (handle?.map(px) ?? null),
    );
    item.names = names ?? null;
    item.chosen = chosen;
    item.session = id;
  }

  /**
   * Which item of a landmark file belongs to a picture: that of its name, otherwise the user's
   * choice. Other pictures without landmarks that the file names have theirs in it too.
   * @param {File} landmarks
   * @param {string} file
   * @param {import("./landmarks.js").Items} items
   * @param {string} picture
   */
  #choose(landmarks, file, items, picture) {
    for (const other of this.#items)
      if (!other.landmarks && indexOfItem(items.names, other.file.name) >= 0)
        this.#give(other, landmarks);
    const own = indexOfItem(items.names, picture);
    return own < 0 ? chooseItem(file, items, picture) : own;
  }

  /**
   * The object of the request. `frames`: how many lead from the first picture to what is shown.
   * @param {{ frames?: number, ofFiles?: boolean, output: object }} wish `ofFiles`: the images are
   * parts of the request
   */
  #object({ frames = 1, ofFiles = false, output }) {
    const used = this.#used;
    const isMirrored = find("blend-mirror").checked;
    /** @type {(share: number) => number[][]} shares of each picture, one for each frame */
    const ways = (share) =>
      Array.from({ length: frames }, (_, k) =>
        shares(frames > 1 ? (share * k) / (frames - 1) : share, used.length),
      );
    const [shape, colour] = [ways(this.#shape), ways(this.#colour)];
    /** @type {(all: number[][], k: number) => number | number[]} */
    const of = (all, k) => {
      const list = all.map((frame) => (isMirrored ? frame[k] / 2 : frame[k]));
      return frames > 1 ? list : list[0];
    };
    // A session has no names: they are needed where orders differ, and to find mirror images.
    const [first] = used;
    const isNamed =
      used.every(({ names }) => names) &&
      (isMirrored || used.some(({ names }) => String(names) !== String(first.names)));
    const images = used.flatMap((item, k) => {
      const source = ofFiles
        ? { image: k, ...(item.chosen !== undefined && { item: item.chosen }) }
        : { session: item.session, ...(isNamed && { p: item.p, names: item.names }) };
      const entry = { ...source, shape: of(shape, k), colour: of(colour, k) };
      return isMirrored ? [entry, { ...entry, mirror: true }] : [entry];
    });
    return {
      images,
      method: this.#method.name,
      ...(this.#method.parameters.some(({ name }) => name === "alpha") && { alpha: ALPHA }),
      ...(find("blend-linear").checked && { space: "linear" }),
      ...(Object.keys(output).length && { output }),
    };
  }

  get #frames() {
    return this.#file.frames ? find("blend-frames").valueAsNumber : 1;
  }

  #changed() {
    const count = this.#used.length;
    if (!this.#isMoved) this.#shape = this.#colour = count > 1 ? (count - 1) / count : 0.5;
    find("blend-problem").hidden = true;
    this.#draw();
    this.#show();
  }

  /** Shows the newest picture: while one is made, later ones replace each other. */
  async #show() {
    if (this.#isDrawing || this.#isUploading || !this.dialog.open) return;
    this.#isDrawing = true;
    this.told();
    const wanted = () => {
      const width = Math.min(PREVIEW, this.#used[0]?.size[0] ?? 1);
      return this.#canBlend ? JSON.stringify(this.#object({ output: { width } })) : "";
    };
    for (let body = wanted(); body && body !== this.#shown; body = wanted()) {
      this.#shown = body;
      await this.#attempt(async () => {
        const blob = await this.#ask(JSON.parse(body), "image/png");
        const picture = find("blend-picture");
        URL.revokeObjectURL(picture.src);
        picture.src = URL.createObjectURL(blob);
        picture.alt = this.#words;
        // Only what is drawn is shown.
        await picture.decode().catch(() => {});
      });
    }
    this.#isDrawing = false;
    this.#draw();
  }

  /**
   * @param {object} body
   * @param {string} media
   * @returns {Promise<Blob>}
   */
  async #ask(body, media) {
    try {
      return await api.blend(body, media);
    } catch (error) {
      const { code } = api.asProblem(error);
      if (code !== "no_such_session" && code !== "session_expired") throw error;
      // The server forgets pictures that are not in use: this page has the files.
      this.#items.forEach((item) => (item.session = null));
      this.#shown = "";
      setTimeout(() => this.#upload());
      throw new DOMException("uploaded again", "AbortError");
    }
  }

  get #words() {
    const used = this.#used;
    return BLEND.picture(
      used.map(({ file }) => file.name),
      [this.#shape, this.#colour],
      find("blend-mirror").checked,
    );
  }

  #draw() {
    const used = this.#used;
    this.#list();
    const landmarks = used.length ? used[0].p.length : 0;
    const words = this.#isUploading
      ? BLEND.uploading
      : BLEND.count(used.length, this.#items.length, landmarks);
    text("blend-said-of", [words, BLEND.unused(this.#unused)].filter(Boolean).join(" "));
    const can = this.#canBlend;
    find("blend-figure").hidden = !can;
    find("blend-controls").hidden = !can;
    const hasOthers = used.length > 1;
    for (const [name, share] of /** @type {const} */ ([
      ["blend-shape", this.#shape],
      ["blend-colour", this.#colour],
    ])) {
      find(name).value = String(Math.round(100 * share));
      find(name).disabled = !hasOthers;
      text(`${name}-value`, `${Math.round(100 * share)} %`);
    }
    find("blend-average").disabled = !hasOthers;
    text("blend-note", can ? BLEND.note(used.map(({ file }) => file.name)) : "");
    for (const option of find("blend-method").options) {
      const method = known(METHODS.find(({ name }) => name === option.value));
      option.disabled = !this.#takes(method);
      if (option.disabled && option.selected) find("blend-method").value = METHOD;
    }
    text("blend-method-note", this.#method.sentence);
    const hasFrames = Boolean(this.#file.frames);
    find("blend-frames-row").hidden = !hasFrames;
    find("blend-frames").max = String(MOST_FRAMES);
    find("blend-frames").disabled = !hasFrames;
    text("blend-save-words", `Download ${BLEND.files[find("blend-file").value]}`);
    this.told();
  }

  #list() {
    const list = find("blend-list");
    const listed = JSON.stringify(
      this.#items.map(({ landmarks, session, wrong, address }) => [
        landmarks?.name,
        session !== null,
        wrong,
        address,
      ]),
    );
    if (listed === this.#listed) return;
    this.#listed = listed;
    const buttons = () => [...list.querySelectorAll("button")];
    const at = buttons().findIndex((button) => button === document.activeElement);
    list.replaceChildren(...this.#items.map((item, index) => this.#row(item, index)));
    list.hidden = !this.#items.length;
    buttons()[at]?.focus();
  }

  /**
   * @param {Item} item
   * @param {number} index
   */
  #row(item, index) {
    const row = document.createElement("li");
    const image = Object.assign(document.createElement("img"), { src: item.address, alt: "" });
    const name = Object.assign(document.createElement("span"), { textContent: item.file.name });
    const words = item.wrong
      ? item.wrong
      : !item.landmarks
        ? BLEND.needs(stem(item.file.name))
        : item.session
          ? BLEND.landmarks(item.landmarks.name, item.p.length)
          : BLEND.waits;
    const note = Object.assign(document.createElement("small"), { textContent: words });
    note.classList.toggle("wrong", Boolean(item.wrong));
    const remove = Object.assign(document.createElement("button"), {
      type: "button",
      className: "icon",
      title: `Remove ${item.file.name}`,
      innerHTML: '<svg><use href="#i-close" /></svg>',
    });
    remove.setAttribute("aria-label", `Remove ${item.file.name}`);
    remove.addEventListener("click", () => this.#remove(this.#items.indexOf(item)));
    row.dataset.picture = String(index);
    row.append(image, name, note, remove);
    return row;
  }

  get #name() {
    const [first] = this.#used;
    return `${stem(first.file.name)}-blend.${this.#file.end}`;
  }

  /** @param {boolean} ofFiles */
  #export(ofFiles) {
    const { format } = this.#file;
    const output = format ? { format } : {};
    return this.#object({ frames: this.#frames, ofFiles, output });
  }

  async #download() {
    const [name, media] = [this.#name, this.#file.media];
    find("blend-save").disabled = true;
    text("blend-said", BLEND.preparing);
    try {
      const blob = await this.#ask(this.#export(false), media);
      save(blob, name);
      text("blend-said", `${name}, ${bytes(blob.size)}`);
    } catch (error) {
      text("blend-said", "");
      throw error;
    } finally {
      find("blend-save").disabled = false;
    }
  }

  async #copy() {
    const files = this.#used.map(({ file, landmarks }) => ({
      image: file.name,
      landmarks: known(landmarks).name,
    }));
    const line = blendLine(files, this.#export(true), this.#name, this.#file.media);
    const isCopied = await copy(line, find("blend-copied"));
    text("blend-said", isCopied ? "Command copied" : "Press Ctrl+C to copy the command");
  }

  /**
   * Shows a problem in the dialog: the page behind it cannot be reached.
   * @param {() => unknown} act
   */
  async #attempt(act) {
    try {
      await act();
    } catch (error) {
      if (!api.wasAborted(error)) this.#tell(api.asProblem(error));
    }
  }

  /** @param {Page.Problem} problem */
  #tell(problem) {
    const { title, detail, advice } = problemWords(
      Object.assign(Object.create(problem), { opening: true }),
    );
    find("blend-problem").hidden = false;
    text("blend-problem-text", [`${title}.`, detail, advice].filter(Boolean).join(" "));
    this.told();
  }
}

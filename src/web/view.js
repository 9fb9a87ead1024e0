// The view: zoom, pan and the layers of the stage. The server's PNG is an <img>; the live preview
// is a canvas of the part of the picture that is visible. Its pixels are those of the picture, or
// of the screen where these are larger: neither a large picture nor a large zoom costs more.

import { boxOf, boxOfPicture } from "./canvas.js";
import { contextOf, inStage, known } from "./dom.js";
import { drawGrid } from "./grid.js";
import { Painter } from "./paint.js";

const LEAST_ZOOM = 0.02;
const MOST_ZOOM = 32;
/** Zoom from which pixels are shown as squares. */
const CRISP = 6;
/** Sides of the small copy that tells whether a picture is a cut-out, px. */
const SAMPLE = 64;
/** Margins for the tools, CSS px, that Fit and Tab keep free; small on a narrow stage. */
const MARGINS = { wide: [92, 64], narrow: [16, 16], from: [640, 420] };

export class View {
  margins = MARGINS;
  zoom = 1;
  /** @type {Page.Place} */
  pan = [0, 0];
  /** @type {Page.Size} */
  stageSize = [0, 0]; // CSS px, cached: reading it from the DOM would force a layout in every move
  /** @type {Page.Size | null} */
  size = null; // size of the picture, px
  /** @type {"none" | "source" | "mesh" | "frame" | "png"} */
  source = "none"; // source of the shown layer
  /** @type {Page.Mesh | null} */
  mesh = null;
  folds = 0;
  /**
   * Whether meshes are cut along an outline: then a place of the grid may have several vertices, and
   * where they fold is known to the server alone.
   */
  isCut = false;

  /** @type {Page.Outside} */
  #outside = "transparent";
  /** @type {Page.Holes} */
  #holes = "keep";
  #region = false; // whether only a region moves
  /** @type {Page.Filter} */
  #filter = "bilinear";
  /** @type {Page.Canvas} */
  #canvas = "same";
  /** @type {Page.Mesh | null} */
  #played = null; // mesh of the frame of an animation, shown in place of the picture
  #refit = false; // the canvas has changed
  /** @type {Page.Box | null} */
  #drawn = null; // box of the shown picture of the server; null: that of the source
  /** @type {Page.Place[]} */
  #folded = [];
  #fitted = true;
  /** @type {Map<Element, string>} */
  #urls = new Map();
  /** @type {ImageBitmap | null} */
  #frame = null; // ImageBitmap of the server's preview
  /** @type {Page.Box | null} */
  #liveBox = null; // part of the picture that the live canvas shows, as a box
  /** @type {(() => void)[]} */
  #afterPaint = [];
  #due = false;
  #end = new AbortController();
  #sizes = new ResizeObserver(() => this.resized());
  /** @type {Set<() => void>} */
  #views = new Set();
  /** @type {Set<() => void>} */
  #drawnViews = new Set();
  #show = { lines: false, compare: false, at: 50, peek: false };

  /**
   * @param {HTMLElement} stage
   * @param {boolean} allowWebgl
   */
  constructor(stage, allowWebgl) {
    this.stage = stage;
    this.live = inStage(this.stage, "live");
    // Many short lines are faster without the GPU.
    this.lines = contextOf(inStage(this.stage, "grid"), { willReadFrequently: true });
    this.painter = allowWebgl ? new Painter(this.live) : null;
    this.webgl = this.painter?.kind ?? "none";
    this.plain = this.webgl === "none" ? contextOf(this.live) : null;
    this.#sizes.observe(stage);
    matchMedia("(prefers-color-scheme: dark)").addEventListener(
      "change",
      () => this.invalidate(),
      this.#end,
    );
  }

  /** Ends it: nothing outside of the stage refers to it any more, and the GPU has its memory back. */
  release() {
    this.#end.abort();
    this.#sizes.disconnect();
    this.clear();
    this.painter?.release();
  }

  /**
   * Called when zoom, pan or the size of the stage have changed.
   * @param {() => void} view
   */
  subscribe(view) {
    this.#views.add(view);
  }

  /**
   * Called after each frame, while the canvas has its content.
   * @param {() => void} view
   */
  afterDraw(view) {
    this.#drawnViews.add(view);
  }

  get scale() {
    return devicePixelRatio || 1;
  }

  /** The posed grid of what is shown. */
  get shownMesh() {
    return this.#played ?? this.mesh;
  }

  /**
   * The box that is shown: of the server's picture, or of the canvas around the mesh.
   * @returns {Page.Box}
   */
  get box() {
    const size = known(this.size);
    if (this.source === "mesh" || this.source === "source")
      return boxOf(this.#canvas, size, this.mesh, this.#region);
    return this.#drawn ?? boxOfPicture(size);
  }

  /**
   * @param {Page.Place} place
   * @returns {Page.Place}
   */
  toStage([x, y]) {
    return [this.pan[0] + this.zoom * x, this.pan[1] + this.zoom * y];
  }

  /**
   * @param {Page.Place} place
   * @returns {Page.Place}
   */
  toPicture([x, y]) {
    return [(x - this.pan[0]) / this.zoom, (y - this.pan[1]) / this.zoom];
  }

  /**
   * Sets the picture: its file is the texture and the original of the comparison. Whether it is a
   * cut-out: partly transparent.
   * @param {Blob} blob
   * @param {number} width
   * @param {number} height
   * @param {AbortSignal} signal
   */
  async setPicture(blob, width, height, signal) {
    const original = await this.#load("original", blob, "Original picture");
    const picture = await this.#load("picture", blob, "Picture");
    let texture = null;
    if (this.painter && this.webgl !== "none") {
      const most = Math.min(1, this.painter.longestSide / Math.max(width, height));
      /** @type {ImageBitmapOptions} */
      const wish = {
        premultiplyAlpha: "premultiply",
        ...(most < 1 && { resizeWidth: Math.floor(width * most), resizeQuality: "high" }),
      };
      texture = await createImageBitmap(original, wish);
    }
    if (signal.aborted) {
      // Another picture was opened meanwhile and is shown.
      this.#release(original);
      this.#release(picture);
      texture?.close();
      signal.throwIfAborted();
    }
    this.size = [width, height];
    this.#setMesh(null);
    this.#swap(original);
    this.#swap(picture);
    if (texture) this.painter?.setSource(texture, width, height);
    this.#drawn = null;
    this.source = "source";
    this.#fitted = true;
    return isCutout(original);
  }

  /** Shows no picture. */
  clear() {
    for (const id of ["original", "picture"])
      this.#swap(Object.assign(new Image(), { id, alt: "", draggable: false }));
    this.#frame?.close();
    this.#frame = null;
    this.#setMesh(null);
    this.size = null;
    this.source = "none";
    this.invalidate();
  }

  /**
   * Loads a picture into a hidden element.
   * @param {string} id
   * @param {Blob} blob
   * @param {string} alt
   */
  async #load(id, blob, alt) {
    const image = new Image();
    const url = URL.createObjectURL(blob);
    this.#urls.set(image, url);
    Object.assign(image, { id, alt, src: url, draggable: false, decoding: "sync" });
    try {
      await image.decode();
    } catch {
      this.#release(image);
      throw new DOMException("the browser does not read the picture", "EncodingError");
    }
    return image;
  }

  /** @param {HTMLImageElement} image */
  #swap(image) {
    const old = inStage(this.stage, /** @type {"original" | "picture"} */ (image.id));
    old.replaceWith(image);
    this.#release(old);
    this.#place();
  }

  /** @param {Element} image */
  #release(image) {
    URL.revokeObjectURL(this.#urls.get(image) ?? "");
    this.#urls.delete(image);
  }

  /**
   * Shows the server's PNG, which has this box, after decoding; false if a newer one has replaced
   * it.
   * @param {Blob} blob
   * @param {Page.Box | null} box
   * @param {AbortSignal} signal
   */
  async showPng(blob, box, signal) {
    const image = await this.#load("picture", blob, "Warped picture");
    if (signal.aborted) {
      this.#release(image);
      return false;
    }
    this.source = "png";
    this.#drawn = box;
    this.#swap(image);
    // Not after every pose: the picture would move under the pointer.
    if (this.#refit && this.#fitted) this.fit();
    this.#refit = false;
    this.invalidate();
    return true;
  }

  /**
   * @param {Page.Mesh} mesh
   * @param {() => void} done
   */
  showMesh(mesh, done) {
    this.#setMesh(mesh);
    this.source = "mesh";
    this.#afterPaint.push(done);
    this.invalidate();
  }

  /**
   * Shows a preview from the server, for browsers without WebGL.
   * @param {Blob} blob
   * @param {Page.Box | null} box
   */
  async showFrame(blob, box) {
    const frame = await createImageBitmap(blob).catch(() => null);
    if (!frame) return false;
    this.#frame?.close();
    this.#frame = frame;
    this.#drawn = box;
    this.source = "frame";
    this.invalidate();
    return true;
  }

  /**
   * Sets the posed grid of the shown picture, for mesh lines and folds.
   * @param {Page.Mesh} mesh
   */
  setMesh(mesh) {
    this.#setMesh(mesh);
    this.invalidate();
  }

  /** @param {Page.Mesh | null} mesh */
  #setMesh(mesh) {
    if (mesh === this.mesh) return;
    this.mesh = mesh;
    this.#folded = mesh && !this.isCut ? mesh.folded() : [];
    this.folds = this.#folded.length;
  }

  /**
   * Sets the content outside of a mesh; pictures from the server include it.
   * @param {Page.Outside} outside
   */
  setOutside(outside) {
    if (outside === this.#outside) return;
    this.#outside = outside;
    this.invalidate();
  }

  /**
   * Sets how a mesh shows enlarged pixels.
   * @param {Page.Filter} filter
   */
  setFilter(filter) {
    if (filter === this.#filter) return;
    this.#filter = filter;
    this.invalidate();
  }

  /**
   * Sets the mask of the region that moves in a mesh (a canvas; null: the whole picture), and what
   * its holes show.
   * @param {HTMLCanvasElement | null} mask
   * @param {Page.Holes} holes
   */
  setRegion(mask, holes) {
    this.#region = mask !== null;
    this.#holes = holes;
    if (this.webgl !== "none") this.painter?.setMask(mask);
    this.invalidate();
  }

  /**
   * Shows a mesh in place of the picture, within its box; null shows the picture again.
   * @param {Page.Mesh | null} mesh
   */
  play(mesh) {
    this.#played = mesh;
    this.invalidate();
  }

  /**
   * Sets the canvas of a mesh; pictures from the server say theirs.
   * @param {Page.Canvas} canvas
   */
  setCanvas(canvas) {
    if (canvas === this.#canvas) return;
    this.#canvas = canvas;
    this.#refit = true;
    this.invalidate();
  }

  /**
   * Sets mesh lines, comparison, and the original while a key is held.
   * @param {{ lines: boolean, compare: boolean, at: number, peek: boolean }} what
   */
  show(what) {
    this.#show = { ...this.#show, ...what };
    this.#place();
    this.invalidate();
  }

  // Zoom and pan

  get #margins() {
    const { wide, narrow, from } = this.margins;
    return this.stageSize.some((side, axis) => side < from[axis]) ? narrow : wide;
  }

  fit() {
    if (!this.size) return;
    const [width, height] = this.stageSize;
    const [aside, above] = this.#margins;
    const room = [width - 2 * aside, height - 2 * above];
    const [x, y, wide, high] = this.box;
    this.zoom = clampZoom(Math.min(room[0] / wide, room[1] / high, 4));
    this.pan = [
      (width - this.zoom * wide) / 2 - this.zoom * x,
      (height - this.zoom * high) / 2 - this.zoom * y,
    ];
    this.#fitted = true;
    this.#moved();
  }

  /**
   * @param {number} zoom
   * @param {Page.Place} [at] stays where it is; otherwise the middle of the stage
   */
  zoomTo(zoom, [x, y] = this.stageSize.map((side) => side / 2)) {
    const next = clampZoom(zoom);
    const factor = next / this.zoom;
    this.pan = [x - (x - this.pan[0]) * factor, y - (y - this.pan[1]) * factor];
    this.zoom = next;
    this.#fitted = false;
    this.#moved();
  }

  /**
   * @param {number} dx
   * @param {number} dy
   */
  panBy(dx, dy) {
    this.pan = [this.pan[0] + dx, this.pan[1] + dy];
    this.#fitted = false;
    this.#moved();
  }

  /**
   * Pans until a position of the picture is visible.
   * @param {Page.Place} place
   */
  reveal(place) {
    const at = this.toStage(place);
    const inset = this.#margins;
    const shift = at.map(
      (c, axis) =>
        Math.max(0, inset[axis] - c) - Math.max(0, c - (this.stageSize[axis] - inset[axis])),
    );
    if (shift[0] || shift[1]) this.panBy(...shift);
  }

  /**
   * The sides on which the picture extends beyond the stage.
   * @returns {Partial<Record<"left" | "right" | "up" | "down", boolean>>}
   */
  get beyond() {
    if (!this.size) return {};
    const [x, y, wide, high] = this.box;
    const [left, top] = this.toStage([x, y]);
    const [right, bottom] = this.toStage([x + wide, y + high]);
    const [width, height] = this.stageSize;
    return { left: left < -1, up: top < -1, right: right > width + 1, down: bottom > height + 1 };
  }

  /** Call when the stage has a new size or has become visible. */
  resized() {
    this.stageSize = [this.stage.clientWidth, this.stage.clientHeight];
    if (this.#fitted) this.fit();
    else this.#moved();
  }

  #moved() {
    // Keep a part of the picture in the stage.
    if (this.size) {
      const { box } = this;
      /** @type {(at: number, axis: number) => number} */
      const within = (at, axis) =>
        Math.min(
          this.stageSize[axis] - 40 - this.zoom * box[axis],
          Math.max(40 - this.zoom * (box[axis] + box[axis + 2]), at),
        );
      this.pan = this.pan.map(within);
    }
    this.#place();
    this.invalidate();
    for (const view of this.#views) view();
  }

  // Drawing

  invalidate() {
    if (this.#due) return;
    this.#due = true;
    requestAnimationFrame(() => {
      this.#due = false;
      this.#draw();
    });
  }

  /** The box of the picture element: the server's picture, or the source. */
  get #pictureBox() {
    return this.source === "png" && this.#drawn ? this.#drawn : boxOfPicture(known(this.size));
  }

  /** Layers that the browser transforms. */
  #place() {
    const [width, height] = this.size ?? [0, 0];
    const { compare, at, peek } = this.#show;
    for (const id of /** @type {const} */ (["board", "picture", "original", "region"])) {
      const { style } = inStage(this.stage, id);
      const [x, y, across, down] =
        this.size && id !== "original" && id !== "region"
          ? id === "board"
            ? this.box
            : this.#pictureBox
          : [0, 0, width, height];
      const [wide, high] = id === "board" ? [across * this.zoom, down * this.zoom] : [across, down];
      style.width = `${wide}px`;
      style.height = `${high}px`;
      style.transform = `translate(${this.pan[0] + this.zoom * x}px, ${this.pan[1] + this.zoom * y}px)${id === "board" ? "" : ` scale(${this.zoom})`}`;
      style.imageRendering = this.zoom >= CRISP ? "pixelated" : "auto";
      if (id === "picture" || id === "original") style.visibility = "visible";
    }
    const original = inStage(this.stage, "original");
    original.style.visibility = this.size && (compare || peek) ? "visible" : "hidden";
    original.style.clipPath = peek ? "none" : `inset(0 ${100 - at}% 0 0)`;
    const divider = inStage(this.stage, "divider");
    divider.hidden = !(this.size && compare && !peek);
    divider.style.transform = `translate(${this.pan[0] + (this.zoom * width * at) / 100}px, ${this.pan[1]}px)`;
    divider.style.height = `${height * this.zoom}px`;
    // Mesh lines and folds belong to the warped picture: in a comparison they are drawn right of
    // the divider.
    this.lines.canvas.style.clipPath = compare
      ? `inset(0 0 0 ${Math.max(0, this.pan[0] + (this.zoom * width * at) / 100)}px)`
      : "none";
    inStage(this.stage, "picture").style.visibility =
      !this.#played && (this.source === "png" || this.source === "source") ? "visible" : "hidden";
  }

  /**
   * Sizes the live canvas to the visible part of the box; returns where the picture is in it, in
   * its px.
   */
  #placeLive() {
    const { zoom, scale, pan, live } = this;
    // CSS px of a pixel of the canvas, and where its pixels begin.
    const [unit, origin] = zoom * scale > 1 ? [zoom, pan] : [1 / scale, [0, 0]];
    /** @type {Page.Place} */
    const low = [0, 0];
    /** @type {Page.Size} */
    const size = [1, 1];
    for (const axis of [0, 1]) {
      /** @type {(place: number) => number} */
      const at = (place) =>
        Math.min(this.stageSize[axis], Math.max(0, pan[axis] + zoom * place)) - origin[axis];
      const [first, side] = [this.box[axis], this.box[axis + 2]];
      low[axis] = Math.floor(at(first) / unit);
      size[axis] = Math.max(1, Math.ceil(at(first + side) / unit) - low[axis]);
    }
    resize(live, size[0], size[1]);
    const { style } = live;
    [style.width, style.height] = size.map((side) => `${side}px`);
    const [left, top] = low.map((at, axis) => origin[axis] + unit * at);
    style.transform = `translate(${left}px, ${top}px) scale(${unit})`;
    style.imageRendering = zoom >= CRISP ? "pixelated" : "auto";
    this.#liveBox = [
      (left - pan[0]) / zoom,
      (top - pan[1]) / zoom,
      (size[0] * unit) / zoom,
      (size[1] * unit) / zoom,
    ];
    return { zoom: zoom / unit, x: (pan[0] - left) / unit, y: (pan[1] - top) / unit };
  }

  #draw() {
    const { scale } = this;
    const [width, height] = this.stageSize.map((side) => Math.max(1, Math.round(side * scale)));
    resize(this.lines.canvas, width, height);
    const mesh = this.shownMesh;
    const following = this.#played !== null || this.source === "mesh" || this.source === "frame";
    const crisp = this.zoom >= CRISP || this.#filter === "nearest";
    const inLive = following ? this.#placeLive() : null;
    if (inLive && mesh && this.painter && (this.#played || this.source === "mesh"))
      this.painter.paint(mesh, inLive, {
        crisp,
        outside: this.#outside,
        holes: this.#holes,
        box: this.box,
      });
    else if (inLive && this.source === "frame") this.#drawFrame(inLive);
    this.live.style.visibility = following ? "visible" : "hidden";
    this.#place();
    const folded = this.#played && !this.isCut ? this.#played.folded() : this.#folded;
    const drawn = mesh && !this.#show.peek && (this.#show.lines || folded.length > 0);
    const place = { zoom: this.zoom * scale, x: this.pan[0] * scale, y: this.pan[1] * scale };
    if (mesh && drawn)
      drawGrid(this.lines, mesh, folded, place, scale, this.#show.lines, following);
    this.lines.canvas.style.visibility = drawn ? "visible" : "hidden";
    for (const view of this.#drawnViews) view();
    const done = this.#afterPaint;
    this.#afterPaint = [];
    for (const tell of done) tell();
  }

  /**
   * Copies a rectangle of the stage (x, y, width, height; CSS px) as shown to a square canvas.
   * @param {CanvasRenderingContext2D} context
   * @param {Page.Box} rectangle
   * @param {number} side
   */
  copyTo(context, [x, y, width, height], side) {
    context.imageSmoothingEnabled = this.zoom < CRISP;
    const isLive = this.source === "mesh" || this.source === "frame";
    const factor = side / width;
    const [atX, atY, wide, high] = isLive ? known(this.#liveBox) : this.#pictureBox;
    const [left, top] = [this.pan[0] + this.zoom * atX - x, this.pan[1] + this.zoom * atY - y];
    const shown = isLive ? this.live : inStage(this.stage, "picture");
    context.drawImage(
      shown,
      left * factor,
      top * factor,
      this.zoom * wide * factor,
      this.zoom * high * factor,
    );
  }

  /** @param {Page.Placed} place */
  #drawFrame({ zoom, x, y }) {
    const context = known(this.plain);
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, context.canvas.width, context.canvas.height);
    context.imageSmoothingEnabled = this.zoom < CRISP;
    const [left, top, wide, high] = this.box;
    if (this.#frame)
      context.drawImage(this.#frame, x + zoom * left, y + zoom * top, zoom * wide, zoom * high);
  }
}

/**
 * Whether a part of a picture is transparent: more than the rounded corners of a screenshot.
 * @param {HTMLImageElement} image
 */
function isCutout(image) {
  const canvas = document.createElement("canvas");
  resize(canvas, SAMPLE, SAMPLE);
  const context = contextOf(canvas, { willReadFrequently: true });
  context.drawImage(image, 0, 0, SAMPLE, SAMPLE);
  const { data } = context.getImageData(0, 0, SAMPLE, SAMPLE);
  let clear = 0;
  for (let k = 3; k < data.length; k += 4) if (data[k] < 128) clear += 1;
  return clear > 0.02 * SAMPLE * SAMPLE;
}

/**
 * @param {HTMLCanvasElement} canvas
 * @param {number} width
 * @param {number} height
 */
function resize(canvas, width, height) {
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
}

/** @type {(zoom: number) => number} */
const clampZoom = (zoom) => Math.min(MOST_ZOOM, Math.max(LEAST_ZOOM, zoom));

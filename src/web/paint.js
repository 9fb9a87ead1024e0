// Renders the source through the posed grid with WebGL 2 or 1. Each cell is a bilinear patch of 1,
// 4 or 16 pairs of triangles. Cells are drawn in row order without blending: where cells overlap,
// the later one is visible, as in the server's picture. The outside is drawn first. Alpha is
// premultiplied.

import { known } from "./dom.js";
import { Mesh } from "./mesh.js";
import { STRIDE, edgeTriangles } from "./outside.js";
import { RegionPainter } from "./regionpaint.js";

const VERTEX = `
attribute vec3 place; attribute vec2 texture;
uniform vec4 view; varying vec2 at;
void main() { at = texture; gl_Position = vec4(place.xy * view.xy + view.zw, place.z, 1.0); }`;
const FRAGMENT = `
precision mediump float; uniform sampler2D source; varying vec2 at;
void main() { gl_FragColor = texture2D(source, at); }`;

/**
 * Target size of the parts of a patch, picture px, and the maximum number of vertices. Without a
 * graphics card, vertices are slow.
 */
const FINE = 8;
const MOST_VERTICES = 300_000;

/**
 * `transparent`, a colour `#rrggbbaa`, or a value, with premultiplied alpha. The browser does not
 * tell the picture's depth: a value above 255 has 16 bits.
 * @param {Page.Outside} outside
 * @returns {[r: number, g: number, b: number, a: number]}
 */
function premultiplied(outside) {
  if (typeof outside === "object") {
    const samples = [outside.value, outside.value, outside.value].flat().slice(0, 3);
    const largest = samples.some((sample) => sample > 255) ? 65535 : 255;
    const [r, g, b] = samples.map((sample) => sample / largest);
    return [r, g, b, 1];
  }
  if (!outside.startsWith("#")) return [0, 0, 0, 0];
  const [r, g, b, a] = [1, 3, 5, 7].map((at) => parseInt(outside.slice(at, at + 2), 16) / 255);
  return [r * a, g * a, b * a, a];
}

/**
 * The refined vertices of a mesh with their depths: x, y, and z, which is less in front.
 * @param {Page.Mesh} mesh
 * @param {Float32Array} depths
 * @param {number} n
 */
function inDepth(mesh, depths, n) {
  const places = mesh.refined(n);
  const pairs = new Float32Array(2 * depths.length);
  depths.forEach((depth, k) => (pairs[2 * k] = -depth));
  const carried = new Mesh(mesh.grid, pairs).refined(n);
  const both = new Float32Array((places.length / 2) * 3);
  for (let from = 0, to = 0; from < places.length; from += 2, to += 3)
    both.set([places[from], places[from + 1], carried[from]], to);
  return both;
}

/** @typedef {WebGL2RenderingContext | WebGLRenderingContext} Gl */

/**
 * The GPU's context and what is prepared in it; `whole` draws without a region, `part` with one.
 *
 * @typedef {{
 *   gl: Gl,
 *   whole: import("./regionpaint.js").Program,
 *   part: RegionPainter,
 *   buffers: Record<"places" | "rest" | "cells" | "edge", WebGLBuffer>,
 * }} Gpu
 */

/**
 * The function that sets a uniform, by the count of its numbers.
 *
 * @type {Record<number, "uniform1fv" | "uniform2fv" | "uniform4fv">}
 */
const SETTERS = { 1: "uniform1fv", 2: "uniform2fv", 4: "uniform4fv" };

export class Painter {
  /**
   * null without WebGL: then nothing is called.
   *
   * @type {Gpu | null}
   */
  #gpu = null;
  /** @type {WebGLTexture | null} */
  #texture = null;
  /** @type {ImageBitmap | null} */
  #source = null;
  /** @type {Page.Size} */
  #size = [1, 1];
  #shape = "";
  #count = 0;
  /** @type {HTMLCanvasElement | null} */
  #mask = null;
  #wide = false;
  #mipmaps = false;

  /**
   * `kind`: webgl2, webgl or none.
   * @param {HTMLCanvasElement} canvas
   */
  constructor(canvas) {
    /** @type {WebGLContextAttributes} */
    const wish = { alpha: true, premultipliedAlpha: true, antialias: false, depth: true };
    const second = canvas.getContext("webgl2", wish);
    const gl = second ?? canvas.getContext("webgl", wish);
    this.kind = second ? "webgl2" : gl ? "webgl" : "none";
    if (!gl) return;
    this.#mipmaps = Boolean(second);
    this.#wide = Boolean(second ?? gl.getExtension("OES_element_index_uint"));
    this.#build(gl);
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.#build(gl);
      if (this.#source) this.setSource(this.#source, ...this.#size);
      if (this.#mask) this.setMask(this.#mask);
    });
  }

  /** @param {Gl} gl */
  #build(gl) {
    /** @type {(kind: number, text: string) => WebGLShader} */
    const shader = (kind, text) => {
      const made = known(gl.createShader(kind));
      gl.shaderSource(made, text);
      gl.compileShader(made);
      return made;
    };
    /**
     * Compiles a fragment shader; its samplers read the texture units in this order.
     * @param {string} fragment
     * @param {string[]} samplers
     * @returns {import("./regionpaint.js").Program}
     */
    const compile = (fragment, samplers) => {
      const program = gl.createProgram();
      gl.attachShader(program, shader(gl.VERTEX_SHADER, VERTEX));
      gl.attachShader(program, shader(gl.FRAGMENT_SHADER, fragment));
      gl.bindAttribLocation(program, 0, "place");
      gl.bindAttribLocation(program, 1, "texture");
      gl.linkProgram(program);
      /** @type {(name: string) => WebGLUniformLocation | null} */
      const uniform = (name) => gl.getUniformLocation(program, name);
      gl.useProgram(program);
      samplers.forEach((name, unit) => gl.uniform1i(uniform(name), unit));
      return {
        use: () => gl.useProgram(program),
        set: (name, ...numbers) => gl[SETTERS[numbers.length]](uniform(name), numbers),
      };
    };
    this.#gpu = {
      gl,
      whole: compile(FRAGMENT, ["source"]),
      part: new RegionPainter(gl, compile),
      buffers: {
        places: gl.createBuffer(),
        rest: gl.createBuffer(),
        cells: gl.createBuffer(),
        edge: gl.createBuffer(),
      },
    };
    gl.enableVertexAttribArray(0);
    gl.enableVertexAttribArray(1);
    this.#shape = "";
    this.#texture = null;
  }

  /** Gives the memory of the GPU back. */
  release() {
    this.#gpu?.gl.getExtension("WEBGL_lose_context")?.loseContext();
    this.#gpu = this.#texture = this.#source = this.#mask = null;
  }

  /** The largest side of a picture that fits into a texture. */
  get longestSide() {
    const { gl } = known(this.#gpu);
    return gl.getParameter(gl.MAX_TEXTURE_SIZE);
  }

  /**
   * Sets the picture: an upright ImageBitmap with premultiplied alpha, and its size in picture px,
   * which may exceed that of the bitmap.
   * @param {ImageBitmap} bitmap
   * @param {number} width
   * @param {number} height
   */
  setSource(bitmap, width, height) {
    const { gl } = known(this.#gpu);
    this.#source = bitmap;
    this.#size = [width, height];
    if (this.#texture) gl.deleteTexture(this.#texture);
    this.#texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.#texture);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, true);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    if (this.#mipmaps) gl.generateMipmap(gl.TEXTURE_2D);
    this.#shape = "";
  }

  /**
   * Sets the mask of the region that moves: a canvas; null: the whole picture.
   * @param {HTMLCanvasElement | null} canvas
   */
  setMask(canvas) {
    this.#mask = canvas;
    if (canvas) this.#gpu?.part.setMask(canvas);
  }

  /**
   * Draws a mesh; `place`: { zoom, x, y } in device px, `crisp`: no smoothing of enlarged pixels,
   * `outside`, `holes`: as in the document, `box`: of the canvas.
   * @param {Page.Mesh} mesh
   * @param {Page.Placed} place
   * @param {{ crisp: boolean, outside: Page.Outside, holes: Page.Holes, box: Page.Box }} how
   */
  paint(mesh, { zoom, x, y }, { crisp, outside, holes, box }) {
    const { gl, whole, part } = known(this.#gpu);
    if (!this.#texture || gl.isContextLost()) return;
    const { width, height } = gl.canvas;
    const n = this.#parts(mesh);
    this.#arrange(mesh, n);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, crisp ? gl.NEAREST : gl.LINEAR);
    // One level is faster without a GPU. In a picture that is not reduced, a second one makes no
    // visible difference.
    const reduced = zoom < 1 ? gl.LINEAR_MIPMAP_LINEAR : gl.LINEAR_MIPMAP_NEAREST;
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, this.#mipmaps ? reduced : gl.LINEAR);
    gl.viewport(0, 0, width, height);
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    // Clip to the canvas, like the server.
    const [boxX, boxY] = [x + zoom * box[0], y + zoom * box[1]];
    const [left, bottom] = [Math.round(boxX), Math.round(height - boxY - zoom * box[3])];
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(
      left,
      bottom,
      Math.round(boxX + zoom * box[2]) - left,
      Math.round(height - boxY) - bottom,
    );
    const view = [
      (2 * zoom) / width,
      (-2 * zoom) / height,
      (2 * x) / width - 1,
      1 - (2 * y) / height,
    ];
    const cells = () => this.#paintCells(mesh, n);
    if (this.#mask)
      return part.paint(view, { outside, beyond: premultiplied(outside), holes }, cells, () =>
        this.#paintBox(box, 2 / zoom),
      );
    whole.use();
    whole.set("view", ...view);
    if (outside === "edge" || outside === "reflect") this.#paintEdge(mesh);
    else this.#paintColour(outside);
    cells();
  }

  /**
   * @param {Page.Mesh} mesh
   * @param {number} n
   */
  #paintCells(mesh, n) {
    const { gl, buffers } = known(this.#gpu);
    const places = mesh.depths ? inDepth(mesh, mesh.depths, n) : mesh.refined(n);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers.places);
    gl.bufferData(gl.ARRAY_BUFFER, places, gl.DYNAMIC_DRAW);
    gl.vertexAttribPointer(0, mesh.depths ? 3 : 2, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers.rest);
    gl.vertexAttribPointer(1, 2, gl.FLOAT, false, 0, 0);
    if (mesh.depths) {
      gl.clear(gl.DEPTH_BUFFER_BIT);
      gl.enable(gl.DEPTH_TEST);
      // Where depths are equal, the later cell is visible.
      gl.depthFunc(gl.LEQUAL);
    }
    gl.drawElements(gl.TRIANGLES, this.#count, this.#wide ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT, 0);
    if (mesh.depths) {
      gl.disable(gl.DEPTH_TEST);
      gl.depthFunc(gl.LESS);
    }
  }

  /** @param {Page.Outside} outside */
  #paintColour(outside) {
    const { gl } = known(this.#gpu);
    gl.clearColor(...premultiplied(outside));
    gl.clear(gl.COLOR_BUFFER_BIT);
  }

  /**
   * Draws a box and `more` px around it at rest, also outside of the picture.
   * @param {Page.Box} box
   * @param {number} more
   */
  #paintBox([x, y, wide, high], more) {
    const { gl, buffers } = known(this.#gpu);
    const [width, height] = this.#size;
    const [left, top, right, bottom] = [x - more, y - more, x + wide + more, y + high + more];
    const corners = [
      [left, top],
      [right, top],
      [left, bottom],
      [right, bottom],
    ].flatMap(([a, b]) => [a, b, 0, a / width, b / height]);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers.edge);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(corners), gl.DYNAMIC_DRAW);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 4 * STRIDE, 0);
    gl.vertexAttribPointer(1, 2, gl.FLOAT, false, 4 * STRIDE, 12);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  /**
   * Draws the extended edge, also in place of a mirrored one, which only the server draws; depth is
   * the distance from the border.
   * @param {Page.Mesh} mesh
   */
  #paintEdge(mesh) {
    const { gl, buffers } = known(this.#gpu);
    const vertices = edgeTriangles(mesh);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers.edge);
    gl.bufferData(gl.ARRAY_BUFFER, vertices, gl.DYNAMIC_DRAW);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 4 * STRIDE, 0);
    gl.vertexAttribPointer(1, 2, gl.FLOAT, false, 4 * STRIDE, 12);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.drawArrays(gl.TRIANGLES, 0, vertices.length / STRIDE);
    gl.disable(gl.DEPTH_TEST);
  }

  /** @param {Page.Mesh} mesh */
  #parts({ grid }) {
    const most = this.#wide ? MOST_VERTICES : 1 << 16;
    /** @type {(n: number) => number} */
    const vertices = (n) => (n * (grid.columns - 1) + 1) * (n * (grid.rows - 1) + 1);
    return [4, 2].find((n) => Math.max(...grid.cell) > (FINE * n) / 2 && vertices(n) <= most) ?? 1;
  }

  /**
   * Triangles and texture coordinates in cell order; they depend on the grid only.
   * @param {Page.Mesh} mesh
   * @param {number} n
   */
  #arrange(mesh, n) {
    const { columns, rows, cell, width, height } = mesh.grid;
    const shape = [columns, rows, ...cell, n].join();
    if (shape === this.#shape) return;
    const { gl, buffers } = known(this.#gpu);
    const [xs, ys] = [mesh.refinedLines(n, 0), mesh.refinedLines(n, 1)];
    const rest = new Float32Array(2 * xs.length * ys.length);
    let at = 0;
    for (const y of ys) {
      for (const x of xs) {
        rest[at++] = x / width;
        rest[at++] = y / height;
      }
    }
    const cells = new (this.#wide ? Uint32Array : Uint16Array)(
      6 * (xs.length - 1) * (ys.length - 1),
    );
    let end = 0;
    for (let j = 0; j < rows - 1; j++) {
      for (let i = 0; i < columns - 1; i++) {
        for (let part = 0; part < n * n; part++) {
          const a = (n * j + Math.floor(part / n)) * xs.length + n * i + (part % n);
          const d = a + xs.length;
          cells.set([a, a + 1, d + 1, a, d + 1, d], end);
          end += 6;
        }
      }
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers.rest);
    gl.bufferData(gl.ARRAY_BUFFER, rest, gl.STATIC_DRAW);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.cells);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, cells, gl.STATIC_DRAW);
    this.#count = end;
    this.#shape = shape;
  }
}

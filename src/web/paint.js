// Renders the source through the posed grid with WebGL 2 or 1. Each cell is a bilinear patch of 1,
// 4 or 16 pairs of triangles. Cells are drawn in row order without blending: where cells overlap,
// the later one is visible, as in the server's picture. The outside is drawn first. Alpha is
// premultiplied.

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
 */
function premultiplied(outside) {
  if (typeof outside === "object") {
    const samples = [outside.value, outside.value, outside.value].flat().slice(0, 3);
    const largest = samples.some((sample) => sample > 255) ? 65535 : 255;
    return [...samples.map((sample) => sample / largest), 1];
  }
  if (!outside.startsWith("#")) return [0, 0, 0, 0];
  const [r, g, b, a] = [1, 3, 5, 7].map((at) => parseInt(outside.slice(at, at + 2), 16) / 255);
  return [r * a, g * a, b * a, a];
}

export class Painter {
  #gl;
  #texture = null;
  #source = null;
  #size = [1, 1];
  #buffers = null;
  #shape = "";
  #count = 0;
  #whole; // the program without a region
  #part; // RegionPainter
  #mask = null;
  #wide;
  #mipmaps;

  /** `kind`: webgl2, webgl or none. */
  constructor(canvas) {
    const wish = { alpha: true, premultipliedAlpha: true, antialias: false, depth: true };
    const second = canvas.getContext("webgl2", wish);
    this.#gl = second ?? canvas.getContext("webgl", wish);
    this.kind = second ? "webgl2" : this.#gl ? "webgl" : "none";
    if (!this.#gl) return;
    this.#mipmaps = Boolean(second);
    this.#wide = Boolean(second ?? this.#gl.getExtension("OES_element_index_uint"));
    this.#build();
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.#build();
      if (this.#source) this.setSource(this.#source, ...this.#size);
      if (this.#mask) this.#part.setMask(this.#mask);
    });
  }

  #build() {
    const gl = this.#gl;
    const shader = (kind, text) => {
      const made = gl.createShader(kind);
      gl.shaderSource(made, text);
      gl.compileShader(made);
      return made;
    };
    /** Compiles a fragment shader; its samplers read the texture units in this order. */
    const compile = (fragment, samplers) => {
      const program = gl.createProgram();
      gl.attachShader(program, shader(gl.VERTEX_SHADER, VERTEX));
      gl.attachShader(program, shader(gl.FRAGMENT_SHADER, fragment));
      gl.bindAttribLocation(program, 0, "place");
      gl.bindAttribLocation(program, 1, "texture");
      gl.linkProgram(program);
      const uniform = (name) => gl.getUniformLocation(program, name);
      gl.useProgram(program);
      samplers.forEach((name, unit) => gl.uniform1i(uniform(name), unit));
      return {
        use: () => gl.useProgram(program),
        set: (name, ...numbers) => gl[`uniform${numbers.length}f`](uniform(name), ...numbers),
      };
    };
    this.#whole = compile(FRAGMENT, ["source"]);
    this.#part = new RegionPainter(gl, compile);
    this.#buffers = {
      places: gl.createBuffer(),
      rest: gl.createBuffer(),
      cells: gl.createBuffer(),
      edge: gl.createBuffer(),
    };
    gl.enableVertexAttribArray(0);
    gl.enableVertexAttribArray(1);
    this.#shape = "";
    this.#texture = null;
  }

  /** The largest side of a picture that fits into a texture. */
  get longestSide() {
    return this.#gl.getParameter(this.#gl.MAX_TEXTURE_SIZE);
  }

  /**
   * Sets the picture: an upright ImageBitmap with premultiplied alpha, and its size in picture px,
   * which may exceed that of the bitmap.
   */
  setSource(bitmap, width, height) {
    const gl = this.#gl;
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

  /** Sets the mask of the region that moves: a canvas; null: the whole picture. */
  setMask(canvas) {
    this.#mask = canvas;
    if (canvas && this.#gl) this.#part.setMask(canvas);
  }

  /**
   * Draws a mesh; `place`: { zoom, x, y } in device px, `crisp`: no smoothing of enlarged pixels,
   * `outside`, `holes`: as in the document, `box`: of the canvas.
   */
  paint(mesh, { zoom, x, y }, { crisp, outside, holes, box }) {
    const gl = this.#gl;
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
      return this.#part.paint(view, { outside, beyond: premultiplied(outside), holes }, cells, () =>
        this.#paintBox(box, 2 / zoom),
      );
    this.#whole.use();
    this.#whole.set("view", ...view);
    if (outside === "edge" || outside === "reflect") this.#paintEdge(mesh);
    else this.#paintColour(outside);
    cells();
  }

  #paintCells(mesh, n) {
    const gl = this.#gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#buffers.places);
    gl.bufferData(gl.ARRAY_BUFFER, mesh.refined(n), gl.DYNAMIC_DRAW);
    gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#buffers.rest);
    gl.vertexAttribPointer(1, 2, gl.FLOAT, false, 0, 0);
    gl.drawElements(gl.TRIANGLES, this.#count, this.#wide ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT, 0);
  }

  #paintColour(outside) {
    const gl = this.#gl;
    gl.clearColor(...premultiplied(outside));
    gl.clear(gl.COLOR_BUFFER_BIT);
  }

  /** Draws a box and `more` px around it at rest, also outside of the picture. */
  #paintBox([x, y, wide, high], more) {
    const gl = this.#gl;
    const [width, height] = this.#size;
    const [left, top, right, bottom] = [x - more, y - more, x + wide + more, y + high + more];
    const corners = [
      [left, top],
      [right, top],
      [left, bottom],
      [right, bottom],
    ].flatMap(([a, b]) => [a, b, 0, a / width, b / height]);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#buffers.edge);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(corners), gl.DYNAMIC_DRAW);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 4 * STRIDE, 0);
    gl.vertexAttribPointer(1, 2, gl.FLOAT, false, 4 * STRIDE, 12);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  /**
   * Draws the extended edge, also in place of a mirrored one, which only the server draws; depth is
   * the distance from the border.
   */
  #paintEdge(mesh) {
    const gl = this.#gl;
    const vertices = edgeTriangles(mesh);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#buffers.edge);
    gl.bufferData(gl.ARRAY_BUFFER, vertices, gl.DYNAMIC_DRAW);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 4 * STRIDE, 0);
    gl.vertexAttribPointer(1, 2, gl.FLOAT, false, 4 * STRIDE, 12);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.drawArrays(gl.TRIANGLES, 0, vertices.length / STRIDE);
    gl.disable(gl.DEPTH_TEST);
  }

  #parts({ grid }) {
    const most = this.#wide ? MOST_VERTICES : 1 << 16;
    const vertices = (n) => (n * (grid.columns - 1) + 1) * (n * (grid.rows - 1) + 1);
    return [4, 2].find((n) => Math.max(...grid.cell) > (FINE * n) / 2 && vertices(n) <= most) ?? 1;
  }

  /** Triangles and texture coordinates in cell order; they depend on the grid only. */
  #arrange(mesh, n) {
    const { columns, rows, cell, width, height } = mesh.grid;
    const shape = [columns, rows, ...cell, n].join();
    if (shape === this.#shape) return;
    const gl = this.#gl;
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
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#buffers.rest);
    gl.bufferData(gl.ARRAY_BUFFER, rest, gl.STATIC_DRAW);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.#buffers.cells);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, cells, gl.STATIC_DRAW);
    this.#count = end;
    this.#shape = shape;
  }
}

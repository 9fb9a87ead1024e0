// The live preview of a region, as the server draws it: m M + k S, where M is the source and m the
// mask through the posed grid, S the source at rest with what is outside, and k = 1 - m. With
// transparent holes k is at most 1 - r, where r is the mask at rest.

const MOVED = `
precision mediump float; uniform sampler2D source, mask; uniform float alone; varying vec2 at;
void main() { gl_FragColor = mix(texture2D(source, at), vec4(1.0), alone) * texture2D(mask, at).a; }`;
const REST = `
#ifdef GL_FRAGMENT_PRECISION_HIGH
precision highp float;
#else
precision mediump float;
#endif
uniform sampler2D source, mask, moved; uniform vec2 size; uniform vec4 beyond; uniform float extended, holes;
varying vec2 at;
void main() {
  bool inside = at.x >= 0.0 && at.y >= 0.0 && at.x <= 1.0 && at.y <= 1.0;
  vec4 colour = inside || extended > 0.5 ? texture2D(source, at) : beyond;
  float taken = inside ? holes * texture2D(mask, at).a : 0.0;
  gl_FragColor = colour * (1.0 - max(texture2D(moved, gl_FragCoord.xy / size).a, taken));
}`;

/**
 * A compiled program of the GPU.
 *
 * @typedef {{ use: () => void, set: (name: string, ...numbers: number[]) => void }} Program
 */

export class RegionPainter {
  #size = "";

  /**
   * `program`: compiles a fragment shader; returns { use(), set(name, ...numbers) }.
   * @param {WebGLRenderingContext | WebGL2RenderingContext} gl
   * @param {(fragment: string, samplers: string[]) => Program} program
   */
  constructor(gl, program) {
    this.gl = gl;
    this.moved = program(MOVED, ["source", "mask"]);
    this.rest = program(REST, ["source", "mask", "moved"]);
    this.texture = gl.createTexture();
    this.target = gl.createTexture();
    this.buffer = gl.createFramebuffer();
  }

  /**
   * Sets the mask, a canvas with alpha.
   * @param {HTMLCanvasElement} canvas
   */
  setMask(canvas) {
    this.#upload(1, this.texture, () =>
      this.gl.texImage2D(
        this.gl.TEXTURE_2D,
        0,
        this.gl.RGBA,
        this.gl.RGBA,
        this.gl.UNSIGNED_BYTE,
        canvas,
      ),
    );
  }

  /**
   * Fills the texture of a unit.
   * @param {number} unit
   * @param {WebGLTexture} texture
   * @param {() => void} fill
   */
  #upload(unit, texture, fill) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, true);
    fill();
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T])
      gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
      gl.texParameteri(gl.TEXTURE_2D, name, gl.LINEAR);
    gl.activeTexture(gl.TEXTURE0);
  }

  /** The texture for m, as large as the canvas. */
  #resize() {
    const { gl } = this;
    const { width, height } = gl.canvas;
    if (this.#size === `${width} ${height}`) return;
    this.#size = `${width} ${height}`;
    this.#upload(2, this.target, () =>
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, null),
    );
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.buffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.target, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  /**
   * `drawMesh` draws the posed cells, later ones over earlier ones; `drawBox` a rectangle that
   * covers the canvas; both with `view`.
   * @param {number[]} view
   * @param {{ outside: Page.Outside, beyond: number[], holes: Page.Holes }} how
   * @param {() => void} drawMesh
   * @param {() => void} drawBox
   */
  paint(view, { outside, beyond, holes }, drawMesh, drawBox) {
    const { gl, moved, rest } = this;
    this.#resize();
    moved.use();
    moved.set("view", ...view);
    moved.set("alone", 1);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.buffer);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    drawMesh();
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    moved.set("alone", 0);
    drawMesh();
    rest.use();
    rest.set("view", ...view);
    rest.set("size", gl.canvas.width, gl.canvas.height);
    rest.set("beyond", ...beyond);
    rest.set("extended", outside === "edge" || outside === "reflect" ? 1 : 0);
    rest.set("holes", holes === "transparent" ? 1 : 0);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE);
    drawBox();
    gl.disable(gl.BLEND);
  }
}

// Mesh lines and folded cells, on a 2D canvas over the picture.

/** Minimum distance between drawn lines, CSS px; lines in between are left out. */
const APART = 16;

/** Visible on any picture: light lines with a dark edge; a red that differs from skin. */
const COLOURS = {
  line: "rgb(255 255 255 / 0.8)",
  under: "rgb(10 20 40 / 0.22)",
  fold: "rgb(235 10 50 / 0.6)",
};

/**
 * `place`: { zoom, x, y } in device px; `scale`: device px per CSS px; `quick`: during a drag,
 * without the dark edge.
 * @param {CanvasRenderingContext2D} context
 * @param {Page.Mesh} mesh
 * @param {Page.Place[]} folded
 * @param {Page.Placed} place
 * @param {number} scale
 * @param {boolean} lines
 * @param {boolean} quick
 */
export function drawGrid(context, mesh, folded, { zoom, x, y }, scale, lines, quick) {
  const { width, height } = context.canvas;
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.clearRect(0, 0, width, height);
  // Clip to the picture.
  context.beginPath();
  context.rect(x, y, zoom * mesh.grid.width, zoom * mesh.grid.height);
  context.save();
  context.clip();
  /** @type {(place: Page.Place) => Page.Place} */
  const to = ([px, py]) => [x + zoom * px, y + zoom * py];
  if (lines) {
    if (!quick) drawLines(context, mesh, to, zoom, scale, COLOURS.under, 2.5 * scale);
    drawLines(context, mesh, to, zoom, scale, COLOURS.line, scale);
  }
  context.beginPath();
  for (const [i, j] of folded) {
    mesh
      .corners(i, j)
      .forEach((corner, k) => (k ? context.lineTo(...to(corner)) : context.moveTo(...to(corner))));
    context.closePath();
  }
  context.fillStyle = COLOURS.fold;
  context.fill("nonzero");
  context.restore();
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {Page.Mesh} mesh
 * @param {(place: Page.Place) => Page.Place} to
 * @param {number} zoom
 * @param {number} scale
 * @param {string} colour
 * @param {number} thick
 */
function drawLines(context, mesh, to, zoom, scale, colour, thick) {
  const { columns, rows, cell } = mesh.grid;
  /** @type {(size: number) => number} */
  const every = (size) => Math.max(1, Math.round((APART * scale) / (zoom * size)));
  const [acrossStep, downStep] = [every(cell[0]), every(cell[1])];
  /** @type {(count: number, step: number) => number[]} */
  const chosen = (count, step) =>
    Array.from({ length: count }, (_, k) => k).filter((k) => k % step === 0 || k === count - 1);
  // Skip vertices along a line where the difference is not visible.
  const [alongX, alongY] = [acrossStep, downStep].map((step) => Math.max(1, Math.floor(step / 2)));
  /** @type {(places: Page.Place[]) => void} */
  const line = (places) =>
    places.forEach((place, k) => (k ? context.lineTo(...to(place)) : context.moveTo(...to(place))));
  context.beginPath();
  for (const i of chosen(columns, acrossStep))
    line(chosen(rows, alongY).map((j) => mesh.posed(i, j)));
  for (const j of chosen(rows, downStep))
    line(chosen(columns, alongX).map((i) => mesh.posed(i, j)));
  context.strokeStyle = colour;
  context.lineWidth = thick;
  context.stroke();
}

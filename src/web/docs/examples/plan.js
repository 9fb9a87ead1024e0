import { headers, server, show } from "./here.js";

/** The posed vertices, [x, y] each, row by row. */
function pose(file, p, q) {
  const header = new DataView(file);
  const integer = (at) => header.getUint32(at, true);
  const [family, , columns, rows, count, members, width, height] =
    [8, 12, 16, 20, 24, 28, 32, 36].map(integer);
  const [P, Q] = [p, q].map(() => Array.from({ length: count }, () => [0, 0]));
  for (let at = 64; at < 64 + 16 * members; at += 16) {
    const [column, handle, place] = [at, at + 4, at + 8].map(integer);
    const share = header.getFloat32(at + 12, true);
    for (const [sum, handles] of [[P, p], [Q, q]]) {
      const position = Array.isArray(handles[handle][0]) ? handles[handle][place] : handles[handle];
      position.forEach((x, axis) => (sum[column][axis] += share * x));
    }
  }
  const table = new Float32Array(file, 64 + 16 * members);
  if (family === 3) return poseLines(P, Q, table, columns, rows, width, height);
  const coefficient = (column, plane, vertex) =>
    table[((family + 1) * column + plane) * columns * rows + vertex];
  return Array.from({ length: columns * rows }, (_, vertex) => {
    const [i, j] = [vertex % columns, Math.floor(vertex / columns)];
    const v = [(i * width) / (columns - 1), (j * height) / (rows - 1)];
    const [moved, pStar, qStar] = [[0, 0], [0, 0], [0, 0]];
    for (let c = 0; c < count; c++) {
      const [re, im, w] = [0, 1, 2].map((k) => (k > family ? 0 : coefficient(c, k, vertex)));
      const [dx, dy] = [Q[c][0] - P[c][0], Q[c][1] - P[c][1]];
      [re * dx - im * dy, re * dy + im * dx].forEach((x, axis) => (moved[axis] += x));
      [0, 1].forEach((axis) => ((pStar[axis] += w * P[c][axis]), (qStar[axis] += w * Q[c][axis])));
    }
    if (family < 2) return v.map((x, axis) => x + moved[axis]); // affine, similarity
    const e = v.map((x, axis) => x - pStar[axis]);
    const F = e.map((x, axis) => x + moved[axis]);
    const turned = Math.hypot(...F) > 1e-5 * Math.hypot(...e); // without a direction, nothing turns
    const scale = Math.hypot(...e) / Math.hypot(...F);
    return qStar.map((x, axis) => x + (turned ? F[axis] * scale : e[axis]));
  });
}

/** The same with the method beier_neely: three numbers for each segment. */
function poseLines(P, Q, table, columns, rows, width, height) {
  const minus = ([x, y], [u, v]) => [x - u, y - v];
  const normal = ([x, y]) => [-y / Math.hypot(x, y), x / Math.hypot(x, y)];
  const vectors = Array.from({ length: P.length / 2 }, (_, segment) => {
    const [from, to] = [P, Q].map((ends) => ends.slice(2 * segment, 2 * segment + 2));
    const [d, posed] = [minus(from[1], from[0]), minus(to[1], to[0])];
    return [minus(to[0], from[0]), minus(posed, d), minus(normal(posed), normal(d))];
  }).flat();
  return Array.from({ length: columns * rows }, (_, vertex) => {
    const [i, j] = [vertex % columns, Math.floor(vertex / columns)];
    const v = [(i * width) / (columns - 1), (j * height) / (rows - 1)];
    return v.map((x, axis) =>
      vectors.reduce((sum, d, k) => sum + table[k * columns * rows + vertex] * d[axis], x),
    );
  });
}

const ask = async (path, options) => {
  const all = { ...headers(), ...options?.headers };
  const response = await fetch(`${server}sessions${path}`, { ...options, headers: all });
  if (!response.ok) throw new Error((await response.json()).detail);
  return response;
};
const p = [[168, 112], [316, 136], [[60, 250], [390, 260]]];
const form = new FormData();
form.set("image", await (await fetch(`${server}page/cat.jpg`)).blob());
form.set("warp", JSON.stringify({ p, grid: { columns: 50, rows: 50 } }));
const { id } = await (await ask("", { method: "POST", body: form })).json();
const file = await (await ask(`/${id}/plan`)).arrayBuffer();
await show({ bytes: file.byteLength });

const q = [[150, 104], [338, 126], [[60, 270], [390, 240]]];
const json = { "Content-Type": "application/json" };
const body = JSON.stringify({ q });
const mesh = await ask(`/${id}/mesh`, { method: "POST", headers: json, body });
const { vertices } = await mesh.json();
const difference = pose(file, p, q).map(([x, y], k) => {
  const [u, v] = vertices[k];
  return Math.hypot(x - u, y - v);
});
await show({ pixelsFromTheMeshOfTheServer: Math.max(...difference) });
await ask(`/${id}`, { method: "DELETE" });

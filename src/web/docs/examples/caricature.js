import { headers, server, show } from "./here.js";

const image = await (await fetch(`${server}page/cat.jpg`)).blob();

const face = [[168, 112], [316, 136], [262, 240], [270, 196]]; // landmarks of this face: eyes, mouth, nose
const average = [[174, 112], [308, 132], [258, 232], [266, 192]]; // the same landmarks of the average face, aligned to this one
const corners = [[0, 0], [451, 0], [451, 300], [0, 300]]; // keep the background in place

for (const k of [0, 1.5]) { // 0: the average shape; 1: this face; above 1: a caricature
  const moved = face.map((position, i) => position.map((c, axis) => average[i][axis] + k * (c - average[i][axis])));
  const form = new FormData();
  form.set("image", image);
  form.set("warp", JSON.stringify({ p: [...face, ...corners], q: [...moved, ...corners] }));
  await show(await fetch(`${server}warp`, { method: "POST", headers: headers(), body: form }), `k = ${k}`);
}

import { headers, server, show } from "./here.js";

const image = await (await fetch(`${server}page/cat.jpg`)).blob();

// Landmarks of this face: eyes, mouth, nose; the same of the average face, aligned to this one.
const face = [[168, 112], [316, 136], [262, 240], [270, 196]];
const average = [[174, 112], [308, 132], [258, 232], [266, 192]];
const corners = [[0, 0], [451, 0], [451, 300], [0, 300]]; // keep the background in place

for (const k of [0, 1.5]) { // 0: the average shape; 1: this face; above 1: a caricature
  const moved = face.map(([x, y], i) => {
    const [ax, ay] = average[i];
    return [ax + k * (x - ax), ay + k * (y - ay)];
  });
  const form = new FormData();
  form.set("image", image);
  form.set("warp", JSON.stringify({ p: [...face, ...corners], q: [...moved, ...corners] }));
  const options = { method: "POST", headers: headers(), body: form };
  await show(await fetch(`${server}warp`, options), `k = ${k}`);
}

import { headers, server, show } from "./here.js";

const image = await (await fetch(`${server}page/cat.jpg`)).blob();
const form = new FormData();
form.set("image", image);
form.set("warp", JSON.stringify({ p: [[168, 112], [316, 136], [262, 240]] }));
const created = await fetch(`${server}sessions`, {
  method: "POST",
  headers: headers(),
  body: form,
});
const { id, image: size, detail } = await created.json();
if (!created.ok) throw new Error(detail);

// A mask of the face: white inside, black outside.
const mask = new OffscreenCanvas(size.width, size.height);
const brush = mask.getContext("2d");
brush.fillRect(0, 0, size.width, size.height);
brush.fillStyle = "white";
brush.ellipse(250, 175, 130, 115, 0, 0, 7);
brush.fill();
const body = await mask.convertToBlob();

// As labels, which follow the warp, and as the region, outside of which nothing moves.
for (const layer of ["face?kind=labels", "region"]) {
  const address = `${server}sessions/${id}/layers/${layer}`;
  const stored = await fetch(address, { method: "PUT", headers: headers(), body });
  if (!stored.ok) throw new Error((await stored.json()).detail);
}

for (const layer of [null, "face", "@holes"]) {
  const body = JSON.stringify({ q: [[128, 112], [276, 136], [222, 240]], layer });
  const json = { ...headers(), "Content-Type": "application/json" };
  const options = { method: "POST", headers: json, body };
  await show(await fetch(`${server}sessions/${id}/warp`, options), layer ?? "the image");
}
await fetch(`${server}sessions/${id}`, { method: "DELETE", headers: headers() });

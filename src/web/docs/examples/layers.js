import { headers, server, show } from "./here.js";

const image = await (await fetch(`${server}page/cat.jpg`)).blob();
const form = new FormData();
form.set("image", image);
form.set("warp", JSON.stringify({ p: [[168, 112], [316, 136], [262, 240]] }));
const created = await fetch(`${server}sessions`, { method: "POST", headers: headers(), body: form });
const { id, image: size, detail } = await created.json();
if (!created.ok) throw new Error(detail);

const mask = new OffscreenCanvas(size.width, size.height);
const brush = mask.getContext("2d");
brush.fillRect(0, 0, size.width, size.height);
brush.fillStyle = "white";
brush.arc(250, 190, 130, 0, 7);
brush.fill();
const body = await mask.convertToBlob();
const stored = await fetch(`${server}sessions/${id}/layers/face`, { method: "PUT", headers: headers(), body });
if (!stored.ok) throw new Error((await stored.json()).detail);

for (const layer of ["face", "@coverage"]) {
  const body = JSON.stringify({ q: [[150, 104], [338, 126], [262, 262]], layer });
  const options = { method: "POST", headers: { ...headers(), "Content-Type": "application/json" }, body };
  await show(await fetch(`${server}sessions/${id}/warp`, options), layer);
}
await fetch(`${server}sessions/${id}`, { method: "DELETE", headers: headers() });

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
const { id, detail } = await created.json();
if (!created.ok) throw new Error(detail);

const q = [[150, 104], [338, 126], [262, 262]];
const body = JSON.stringify({ q, steps: 8, and_back: true, output: { width: 300 } });
const accept = { ...headers(), "Content-Type": "application/json", Accept: "image/gif" };
await show(await fetch(`${server}sessions/${id}/batch`, { method: "POST", headers: accept, body }));
await fetch(`${server}sessions/${id}`, { method: "DELETE", headers: headers() });

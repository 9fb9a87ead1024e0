import { headers, server, show } from "./here.js";

const form = new FormData();
form.set("image", await (await fetch(`${server}page/cat.jpg`)).blob());
form.set("warp", JSON.stringify({ p: [[168, 112], [316, 136], [262, 240]] }));
const created = await fetch(`${server}sessions`, {
  method: "POST",
  headers: headers(),
  body: form,
});
const { id, detail } = await created.json();
if (!created.ok) throw new Error(detail);

for (const [seq, x] of [150, 140, 130].entries()) {
  const body = JSON.stringify({ seq, q: [[x, 104], [338, 126], [262, 262]] });
  const json = { ...headers(), "Content-Type": "application/json" };
  const options = { method: "POST", headers: json, body };
  await show(await fetch(`${server}sessions/${id}/warp`, options), `x = ${x}`);
}
await fetch(`${server}sessions/${id}`, { method: "DELETE", headers: headers() });

import { headers, server, show } from "./here.js";

const image = await (await fetch(`${server}page/cat.jpg`)).blob();

const form = new FormData();
form.set("image", image);
form.set("warp", JSON.stringify({
  p: [[168, 112], [316, 136], [262, 240]],
  q: [[150, 104], [338, 126], [262, 262]],
}));
await show(await fetch(`${server}warp`, { method: "POST", headers: headers(), body: form }));

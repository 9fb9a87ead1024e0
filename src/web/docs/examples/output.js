import { headers, server, show } from "./here.js";

const form = new FormData();
form.set("image", await (await fetch(`${server}page/cat.jpg`)).blob());
form.set("warp", JSON.stringify({
  p: [[168, 112], [316, 136]],
  q: [[120, 112], [316, 136]],
  output: { format: "jpeg", quality: 80, width: 225, outside: "edge" },
}));
await show(await fetch(`${server}warp`, { method: "POST", headers: headers(), body: form }));

import { headers, server, show } from "./here.js";

const form = new FormData();
form.set("image", await (await fetch(`${server}page/cat.jpg`)).blob());
const ground = [[0, 290], [225, 280], [451, 290]]; // a polyline: it stays where it is
const warp = { p: [[242, 185], ground], q: [[242, 160], ground], weights: [2, 1] };
form.set("warp", JSON.stringify(warp));
await show(await fetch(`${server}warp`, { method: "POST", headers: headers(), body: form }));

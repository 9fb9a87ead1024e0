import { headers, server, show } from "./here.js";

const form = new FormData();
form.set("image", await (await fetch(`${server}page/cat.jpg`)).blob());
form.set("warp", JSON.stringify({ p: [[168, 112]], q: [[150, 104]], metod: "rigid" }));
const answer = await fetch(`${server}warp`, { method: "POST", headers: headers(), body: form });
if (!answer.ok) show(await answer.json());

import { headers, server, show } from "./here.js";

const image = await (await fetch(`${server}page/cat.jpg`)).blob();
for (const method of ["rigid", "similarity", "affine"]) {
  const form = new FormData();
  form.set("image", image);
  form.set("warp", JSON.stringify({
    p: [[168, 112], [316, 136], [262, 240]],
    q: [[140, 90], [345, 130], [262, 270]],
    method,
    alpha: 1.5,
    output: { format: "jpeg" },
  }));
  const options = { method: "POST", headers: headers(), body: form };
  await show(await fetch(`${server}warp`, options), method);
}

import { headers, server, show } from "./here.js";

const body = JSON.stringify({
  extent: [451, 300],
  p: [[168, 112], [316, 136], [262, 240]],
  q: [[150, 104], [338, 126], [262, 262]],
  points: [[168, 112], [240, 180]],
});
const json = { ...headers(), "Content-Type": "application/json" };
const options = { method: "POST", headers: json, body };
await show(await fetch(`${server}points`, options));

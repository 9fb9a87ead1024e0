import { headers, protocols, server, show } from "./here.js";

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

const address = `${server.replace("http", "ws")}sessions/${id}/drag?frames=jpeg`;
const socket = new WebSocket(address, protocols());
socket.binaryType = "arraybuffer";
socket.onopen = () => {
  for (let seq = 0; seq < 10; seq++) {
    socket.send(JSON.stringify({ seq, q: [[168 - 3 * seq, 112], [316, 136], [262, 240]] }));
  }
};
await new Promise((done) => {
  socket.onclose = done;
  socket.onmessage = async ({ data }) => {
    if (typeof data === "string") return show(JSON.parse(data)); // the grid, or a problem document
    const seq = Number(new DataView(data).getBigUint64(0, true));
    socket.send(JSON.stringify({ ack: seq }));
    if (seq < 9) return;
    await show(new Blob([data.slice(8)], { type: "image/jpeg" }), "the last frame");
    socket.close();
  };
});
await fetch(`${server}sessions/${id}`, { method: "DELETE", headers: headers() });

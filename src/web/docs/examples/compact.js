import { headers, protocols, server, show } from "./here.js";

/** The posed vertices, [x, y] each, row by row, px. */
function read(frame, { columns, rows, width, height, cell }) {
  const data = new DataView(frame);
  const scale = data.getFloat32(8, true);
  const line = (k, count, side, distance) => (k === count - 1 ? side : k * distance);
  return Array.from({ length: columns * rows }, (_, k) => [
    line(k % columns, columns, width, cell[0]) + scale * data.getInt16(12 + 4 * k, true),
    line(Math.floor(k / columns), rows, height, cell[1]) + scale * data.getInt16(14 + 4 * k, true),
  ]);
}

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

const query = "frames=mesh&mesh=compact&tolerance=1";
const address = `${server.replace("http", "ws")}sessions/${id}/drag?${query}`;
const socket = new WebSocket(address, protocols());
socket.binaryType = "arraybuffer";
await new Promise((done) => {
  let grid;
  socket.onclose = done;
  socket.onmessage = async ({ data }) => {
    if (typeof data === "string") {
      grid = JSON.parse(data); // or a problem document
      await show(grid);
      if (!grid.columns) return socket.close();
      return socket.send(JSON.stringify({ seq: 1, q: [[150, 104], [338, 126], [262, 240]] }));
    }
    const vertices = read(data, grid);
    await show({ bytes: data.byteLength, vertices: vertices.length, first: vertices[0] });
    socket.send(JSON.stringify({ ack: 1 })); // the next frame is sent after this
    socket.close();
  };
});
await fetch(`${server}sessions/${id}`, { method: "DELETE", headers: headers() });

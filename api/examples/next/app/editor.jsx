// The browser warps while the cat is dragged. The file is drawn by the same engine in Node, which
// can read a larger original than the one that the page shows.

import "mlswarp/element/define";
import { useState } from "react";
import { p } from "./handles.js";

export default function Editor() {
  const [q, setQ] = useState(p);
  const [told, setTold] = useState("");

  async function save() {
    const answer = await fetch("/warp", { method: "POST", body: JSON.stringify({ q }) });
    if (!answer.ok) return setTold(await answer.text());
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await answer.blob());
    link.download = "cat.png";
    link.click();
    URL.revokeObjectURL(link.href);
  }

  return (
    <main>
      <h1>Bend the cat</h1>
      <mls-warp
        src="/cat.jpg"
        p={p}
        q={q}
        onwarpinput={({ detail }) => setQ(detail.q)}
        onwarpchange={({ detail }) => setQ(detail.q)}
        onwarperror={({ detail }) => setTold(detail.message)}
      />
      <button onClick={() => setQ(p)}>Put back</button>
      <button onClick={save}>Save</button>
      <output>{told || JSON.stringify(q)}</output>
    </main>
  );
}

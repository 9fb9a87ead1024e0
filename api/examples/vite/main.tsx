// <mls-warp> in React 19, which sets properties and hears events of elements by itself.

import type { Handle } from "mlswarp/client";
import "mlswarp/element/define";
import type { WarpElements } from "mlswarp/jsx";
import { useState } from "react";
import { createRoot } from "react-dom/client";

declare module "react" {
  namespace JSX {
    interface IntrinsicElements extends WarpElements {}
  }
}

const p: Handle[] = [
  [168, 112],
  [316, 136],
  [262, 240],
];
// Without a server, the browser warps.
const server = new URLSearchParams(location.search).get("server") ?? "";

function Editor() {
  const [q, setQ] = useState(p);
  const [error, setError] = useState("");
  return (
    <main>
      <h1>Bend the cat</h1>
      <mls-warp
        server={server}
        src="cat.jpg"
        p={p}
        q={q}
        onwarpinput={({ detail }) => setQ(detail.q)}
        onwarpchange={({ detail }) => setQ(detail.q)}
        onwarperror={({ detail }) => setError(detail.message)}
      />
      <button onClick={() => setQ(p)}>Put back</button>
      <output>{error || JSON.stringify(q)}</output>
    </main>
  );
}

createRoot(document.body).render(<Editor />);

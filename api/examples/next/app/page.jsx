"use client";

import dynamic from "next/dynamic";

// React sets the properties of elements that it makes, but not of those that came as HTML: so the
// server leaves the editor out.
const Editor = dynamic(() => import("./editor.jsx"), { ssr: false });

export default function Page() {
  return <Editor />;
}

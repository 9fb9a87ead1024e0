// Prints the types of the elements of the page by their ids, from index.html: `find("undo")` is a
// button then, and `find("undoo")` an error.
//
//     node elements.mjs index.html

import { readFileSync } from "node:fs";

const page = readFileSync(process.argv[2], "utf8").replace(/<!--.*?-->/gs, "");
const SVG = /^(svg|symbol|g|path|use|circle|rect|line)$/;
console.log("// Written by tests/lint/run from index.html.\n\ninterface PageElements {");
for (const [, tag, id] of page.matchAll(/<([a-z][a-z0-9]*)\s[^>]*?\bid="([^"]+)"/g)) {
  // What `<use>` refers to.
  if (tag === "symbol") continue;
  const name = /^[a-z_]+$/.test(id) ? id : `"${id}"`;
  console.log(`  ${name}: ${SVG.test(tag) ? "SVG" : "HTML"}ElementTagNameMap["${tag}"];`);
}
console.log("}");

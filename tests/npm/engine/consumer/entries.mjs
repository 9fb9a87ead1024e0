// The modules that the package exports.

import { readFileSync } from "node:fs";

const { exports } = JSON.parse(readFileSync("node_modules/mlswarp/package.json", "utf8"));
for (const [name, entry] of Object.entries(exports))
  if (entry.default) console.log(name.replace(/^\./, "mlswarp"));

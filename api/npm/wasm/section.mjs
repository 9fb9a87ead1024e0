// section.mjs IN TEXT OUT: a WebAssembly file with a text in its section `mlswarp`.

import { readFileSync, writeFileSync } from "node:fs";

const [, , from, text, to] = process.argv;
const name = Buffer.from("mlswarp");
const content = Buffer.concat([Buffer.from([name.length]), name, Buffer.from(text)]);
if (content.length > 127) throw new Error("one byte has the length");
writeFileSync(to, Buffer.concat([readFileSync(from), Buffer.from([0, content.length]), content]));

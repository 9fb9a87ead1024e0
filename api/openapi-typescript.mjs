// Generates the types for openapi-fetch from the OpenAPI document. The command line of
// openapi-typescript types files as strings and fields with a default as required; here files are
// Blobs and such fields are optional.
//
//     npm install openapi-typescript typescript@5
//     node openapi-typescript.mjs http://127.0.0.1:8080/openapi.json mlswarp.ts

import { writeFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [document, out] = process.argv.slice(2);
if (!out) {
  console.error("usage: node openapi-typescript.mjs DOCUMENT OUT.ts");
  process.exit(2);
}
// The packages are those of the folder in which this runs.
const require = createRequire(`${process.cwd()}/`);
const { default: generate, astToString } = require("openapi-typescript");
const ts = require("typescript");

const blob = ts.factory.createTypeReferenceNode("Blob");
const types = await generate(new URL(document, pathToFileURL(`${process.cwd()}/`)), {
  defaultNonNullable: false,
  transform: (schema) => (schema.format === "binary" ? blob : undefined),
});
await writeFile(out, astToString(types));

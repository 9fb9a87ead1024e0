// Checks custom resources against models generated from the definitions of their projects. Reads a
// JSON list of objects, returns a list of lists of messages. The validators of the models check
// values (patterns, enumerations, bounds) but accept unknown fields. Their types list every field,
// and the TypeScript compiler rejects unknown ones in a literal. Each object is therefore checked
// by both.
import { readFileSync, writeFileSync } from "node:fs";
import ts from "typescript";

const PACKAGES = {
  "gateway.networking.k8s.io": "@kubernetes-models/gateway-api",
  "gateway.envoyproxy.io": "@kubernetes-models/envoy-gateway",
  "monitoring.coreos.com": "@kubernetes-models/prometheus-operator",
};

const objects = JSON.parse(readFileSync(0, "utf8"));
const complaints = objects.map(() => []);
const lines = [];
for (const [index, object] of objects.entries()) {
  const [group, version] = object.apiVersion.split("/");
  const module = `${PACKAGES[group]}/${group}/${version}/${object.kind}`;
  let model;
  try {
    model = (await import(module))[object.kind];
  } catch {
    complaints[index].push(`${object.apiVersion} ${object.kind} is no kind that is known here`);
    continue;
  }
  try {
    new model(structuredClone(object)).validate();
  } catch (refusal) {
    complaints[index].push(refusal.message);
  }
  // One line per object, so that the line of a message identifies the object.
  lines.push({
    index,
    text: `export const o${index}: import("${module}").I${object.kind} = ${JSON.stringify(object)};`,
  });
}

writeFileSync("kinds.ts", lines.map((line) => line.text).join("\n"));
const program = ts.createProgram(["kinds.ts"], {
  noEmit: true,
  strict: true,
  skipLibCheck: true,
  types: [],
  module: ts.ModuleKind.NodeNext,
  moduleResolution: ts.ModuleResolutionKind.NodeNext,
});
for (const diagnostic of ts.getPreEmitDiagnostics(program)) {
  const said = ts.flattenDiagnosticMessageText(diagnostic.messageText, " ");
  if (!diagnostic.file?.fileName.endsWith("kinds.ts"))
    throw new Error(`${diagnostic.file?.fileName}: ${said}`);
  const { line } = diagnostic.file.getLineAndCharacterOfPosition(diagnostic.start);
  complaints[lines[line].index].push(said);
}
console.log(JSON.stringify(complaints));

// Manifests of kinds that Kubernetes itself does not have, against the models that are generated from their projects' own definitions. Reads a JSON list of
// objects, answers a list of lists of complaints. The models' validators know values (patterns, enumerations, bounds) and let unknown fields pass; their
// types know every field, and the TypeScript compiler lets no unknown one pass in a literal. So each object is given to both.
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
  // One line an object, so that a complaint's line says whose it is.
  lines.push({ index, text: `export const o${index}: import("${module}").I${object.kind} = ${JSON.stringify(object)};` });
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
  if (!diagnostic.file?.fileName.endsWith("kinds.ts")) throw new Error(`${diagnostic.file?.fileName}: ${said}`);
  const { line } = diagnostic.file.getLineAndCharacterOfPosition(diagnostic.start);
  complaints[lines[line].index].push(said);
}
console.log(JSON.stringify(complaints));

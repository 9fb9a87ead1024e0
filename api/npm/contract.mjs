// Writes client/contract.ts: the types of the objects of api/openapi.json.
//
//     node contract.mjs            writes the file
//     node contract.mjs --check    fails if it would be another one

import { readFileSync, writeFileSync } from "node:fs";

const source = new URL("../openapi.json", import.meta.url);
const target = new URL("client/contract.ts", import.meta.url);

/**
 * The keywords of JSON Schema that the document uses and that make a type.
 *
 * @typedef {{
 *   $ref?: string,
 *   type?: string | string[],
 *   const?: unknown,
 *   enum?: unknown[],
 *   oneOf?: Schema[],
 *   anyOf?: Schema[],
 *   allOf?: Schema[],
 *   items?: Schema,
 *   prefixItems?: Schema[],
 *   minItems?: number,
 *   maxItems?: number,
 *   properties?: Record<string, Schema>,
 *   additionalProperties?: Schema | boolean,
 *   required?: string[],
 *   format?: string,
 *   description?: string,
 * }} Schema
 */

/** @type {{ components: { schemas: Record<string, Schema> } }} */
const { components } = JSON.parse(readFileSync(source, "utf8"));

/** @type {(type: string) => string} */
const inArray = (type) => (/[|&]/.test(type) ? `(${type})` : type);
/** @type {(name: string) => string} */
const property = (name) => (/^[A-Za-z_$][\w$]*$/.test(name) ? name : JSON.stringify(name));

/**
 * A description as a comment, in lines of at most 100 columns.
 *
 * @param {string | undefined} description
 * @param {string} indent
 */
function comment(description, indent) {
  if (!description) return "";
  const lines = description.replaceAll("*/", "* /").split("\n");
  const wrapped = lines.flatMap((line) => line.match(/.{1,90}(?:\s|$)/g) ?? [""]);
  const body = wrapped.map((line) => `${indent} * ${line}`.trimEnd());
  return `${indent}/**\n${body.join("\n")}\n${indent} */\n`;
}

/**
 * @param {Schema} schema
 * @param {string} indent
 * @returns {string}
 */
function typeOf(schema, indent) {
  const { $ref, const: value, enum: values, oneOf, anyOf, allOf } = schema;
  if ($ref) return /** @type {string} */ ($ref.split("/").at(-1));
  if (value !== undefined) return JSON.stringify(value);
  if (values) return values.map((one) => JSON.stringify(one)).join(" | ");
  const choices = oneOf ?? anyOf;
  // Where the choices only say which members are required together, the members are beside them.
  if (
    choices &&
    !schema.properties &&
    choices.every((one) => !one.required || one.type || one.properties)
  )
    return [...new Set(choices.map((one) => typeOf(one, indent)))].join(" | ");
  if (allOf && !schema.properties)
    return allOf.map((one) => inArray(typeOf(one, indent))).join(" & ");
  const types = [schema.type ?? (schema.properties ? "object" : "unknown")].flat();
  return types.map((type) => ofType(type, schema, indent)).join(" | ");
}

/**
 * @param {string} type
 * @param {Schema} schema
 * @param {string} indent
 */
function ofType(type, schema, indent) {
  const { items, prefixItems, minItems, maxItems, properties, additionalProperties } = schema;
  if (type === "integer") return "number";
  if (type === "string" && schema.format === "binary") return "Blob";
  if (type === "array") {
    if (prefixItems) return `[${prefixItems.map((one) => typeOf(one, indent)).join(", ")}]`;
    const item = items ? typeOf(items, indent) : "unknown";
    const isTuple = minItems !== undefined && minItems === maxItems && minItems <= 6;
    return isTuple ? `[${Array(minItems).fill(item).join(", ")}]` : `${inArray(item)}[]`;
  }
  if (type !== "object") return type;
  const rest =
    typeof additionalProperties === "object" ? typeOf(additionalProperties, indent) : "unknown";
  if (!properties) return `Record<string, ${rest}>`;
  const inner = `${indent}  `;
  const members = Object.entries(properties).map(([name, one]) => {
    const optional = schema.required?.includes(name) ? "" : "?";
    return `${comment(one.description, inner)}${inner}${property(name)}${optional}: ${typeOf(one, inner)};\n`;
  });
  return `{\n${members.join("")}${indent}}`;
}

const types = Object.entries(components.schemas).map(
  ([name, schema]) =>
    `${comment(schema.description, "")}export type ${name} = ${typeOf(schema, "")};\n`,
);
const head = `// The objects of api/openapi.json. \`node contract.mjs\` writes this file.\n`;
const text = [head, ...types].join("\n");

if (process.argv[2] === "--check") {
  if (readFileSync(target, "utf8") === text) process.exit();
  console.error(
    "client/contract.ts is not that of api/openapi.json: run `node api/npm/contract.mjs`",
  );
  process.exit(1);
}
writeFileSync(target, text);

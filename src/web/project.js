// A project: one JSON file with the picture, its handles, the region, annotations and settings, as
// the page has them. Every part is checked when it is opened, and what is wrong is named.

import { FORMATS } from "./animationexport.js";
import { Problem } from "./api.js";
import { isAnnotations } from "./annotations.js";
import { warpOf } from "./edits.js";
import { Unsupported, demand, documentFrom, isPlace, named } from "./handlesfile.js";
import { EASINGS, MOST_FRAMES } from "./player.js";
import { decodeParts, regionOf } from "./region.js";
import { atStrength, strengthOf } from "./strength.js";

/** The version of the format. */
const VERSION = 1;
const BASE64 = /^[A-Za-z0-9+/]+={0,2}$/;
/** The start of a file that this page has written, even if the rest is missing. */
const START = /^\s*\{\s*"mlswarp_project"/;

/** @type {(text: string) => boolean} */
export const beginsAsProject = (text) => START.test(text);

/**
 * @param {Blob} blob
 * @returns {Promise<string>}
 */
function base64Of(blob) {
  return new Promise((resolve, reject) => {
    const reader = new FileReader();
    reader.onload = () => resolve(String(reader.result).split(",", 2)[1] ?? "");
    reader.onerror = () => reject(reader.error);
    reader.readAsDataURL(blob);
  });
}

/**
 * The open picture with everything about it, as JSON. `file`: { blob, name }.
 * @param {Page.State} state
 * @param {Page.Source} file
 */
export async function projectText({ document, annotations, animation }, { blob, name }) {
  const { parts, feather } = regionOf(document);
  return `${JSON.stringify(
    {
      mlswarp_project: VERSION,
      picture: { name, type: blob.type, base64: await base64Of(blob) },
      warp: warpOf(atStrength(document, 1)),
      strength: strengthOf(document),
      ...(parts.length && { region: { parts, feather } }),
      ...(annotations && { annotations: { name: annotations.name, geojson: annotations.geojson } }),
      animation,
    },
    null,
    1,
  )}\n`;
}

/**
 * The parts of a project: { name, blob, document, warp (if its handles are to be aligned),
 * annotations, animation }. Throws a Problem.
 * @param {File} file
 * @param {number} most
 */
export async function readProject(file, most) {
  /** @type {(detail: string) => Problem} */
  const problem = (detail) =>
    new Problem({ code: "bad_project", detail: `In ${file.name}, ${detail}` }, 0);
  if (file.size > most) throw problem("there are more bytes than this server takes.");
  try {
    return await partsOf(JSON.parse(await file.text()));
  } catch (error) {
    if (error instanceof Unsupported)
      throw problem(
        `${error.expected} is expected${error.pointer && ` for ${named(error.pointer)}`}.`,
      );
    if (error instanceof SyntaxError)
      throw problem("the JSON is damaged: the file may not be complete.");
    throw error;
  }
}

/** @param {Page.Json} project */
async function partsOf(project) {
  /** @type {(value: unknown) => boolean} */
  const isObject = (value) => value !== null && typeof value === "object" && !Array.isArray(value);
  const {
    mlswarp_project: version,
    picture,
    warp,
    strength = 1,
    region,
    annotations,
    animation,
  } = project;
  demand(version === VERSION, "/mlswarp_project", `${VERSION}, the version that this page reads,`);
  demand(isObject(picture), "/picture", "the picture, an object with name, type and base64,");
  demand(typeof picture.name === "string" && picture.name, "/picture/name", "a file name");
  demand(
    typeof picture.base64 === "string" && BASE64.test(picture.base64),
    "/picture/base64",
    "the picture's file in base64",
  );
  demand(isObject(warp), "/warp", "a warp object");
  demand((warp.units ?? "px") === "px", "/warp/units", '"px"');
  const read = within("/warp", () => documentFrom(warp));
  demand(
    Number.isFinite(strength) && Math.abs(strength) <= 10,
    "/strength",
    "a number between -10 and 10",
  );
  /** @type {Partial<ReturnType<typeof regionFrom>>} */
  const drawn = region === undefined ? {} : regionFrom(region);
  await decodeParts(drawn.region ?? []).catch(() =>
    demand(false, "/region/parts", "masks that are PNG in base64"),
  );
  demand(
    annotations === undefined || (isObject(annotations) && isAnnotations(annotations.geojson)),
    "/annotations/geojson",
    "GeoJSON",
  );
  const bytes = Uint8Array.from(atob(picture.base64), (character) => character.charCodeAt(0));
  return {
    name: picture.name.slice(0, 200),
    blob: new Blob([bytes], { type: String(picture.type ?? "") }),
    document: { ...read, ...drawn },
    strength,
    annotations: annotations
      ? { name: String(annotations.name ?? "annotations"), geojson: annotations.geojson }
      : null,
    animation: animation === undefined ? {} : animationFrom(animation),
  };
}

/**
 * Reads a part whose messages name members of the whole.
 * @template T
 * @param {string} pointer
 * @param {() => T} read
 */
function within(pointer, read) {
  try {
    return read();
  } catch (error) {
    if (error instanceof Unsupported) error.pointer = pointer + error.pointer;
    throw error;
  }
}

/**
 * @param {Page.Json} told
 * @returns {{ region: Page.RegionPart[], feather: number }}
 */
function regionFrom({ parts, feather }) {
  demand(Array.isArray(parts), "/region/parts", "a list of parts");
  demand(feather >= 0 && feather <= 100, "/region/feather", "a width in px, 0 to 100,");
  /** @param {Page.Json} part */
  parts.forEach((part, k) => {
    const at = `/region/parts/${k}`;
    const kinds = ["lasso", "brush", "invert", "mask"];
    demand(kinds.includes(part?.kind), `${at}/kind`, '"lasso", "brush", "invert" or "mask"');
    if (part.kind === "mask")
      demand(typeof part.png === "string" && BASE64.test(part.png), `${at}/png`, "a PNG in base64");
    if (part.kind !== "lasso" && part.kind !== "brush") return;
    demand(
      Array.isArray(part.places) && part.places.length > 0 && part.places.every(isPlace),
      `${at}/places`,
      "a list of positions [x, y]",
    );
    demand(part.kind === "lasso" || part.size > 0, `${at}/size`, "a size in px, above 0,");
  });
  return { region: parts, feather };
}

/**
 * @param {Page.Json} told
 * @returns {Page.Animation}
 */
function animationFrom({ easing, back, frames, file }) {
  demand(
    easing in EASINGS,
    "/animation/easing",
    Object.keys(EASINGS)
      .map((name) => `"${name}"`)
      .join(" or "),
  );
  demand(typeof back === "boolean", "/animation/back", "true or false");
  demand(
    Number.isInteger(frames) && frames >= 2 && frames <= MOST_FRAMES,
    "/animation/frames",
    `a number of frames, 2 to ${MOST_FRAMES},`,
  );
  demand(
    FORMATS.includes(file),
    "/animation/file",
    FORMATS.map((name) => `"${name}"`).join(" or "),
  );
  return { easing, back, frames, file };
}

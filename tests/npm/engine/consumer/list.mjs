// The warp objects, each with its picture. `list.mjs`: one a line, with the ending of its result.

import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

export const PICTURES = {
  cat: "chelsea.png",
  face: "astronaut.png",
  lines: "rocket.jpg",
  auto: "chelsea.png",
  morphing: "chelsea.png",
  cutout: "horse-cutout.png",
  unfolded: "chelsea.png",
};
const ENDINGS = { jpeg: "jpg", webp: "webp", tiff: "tif" };

/** @param {string} name */
export function ending(name) {
  const { output } = JSON.parse(readFileSync(`${name}.json`, "utf8"));
  return ENDINGS[output?.format] ?? "png";
}

if (import.meta.url === pathToFileURL(process.argv[1]).href)
  for (const [name, picture] of Object.entries(PICTURES)) console.log(name, picture, ending(name));
